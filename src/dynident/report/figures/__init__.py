"""Figures of a study, an identification and a fleet: nouns in, drawings out; no file is opened or written.

Backgrounds are transparent and fonts inherited. Lines with ``meta`` "ink" and all text are drawn in a grey that is
readable on white and on black; a page may repaint them in its own text colour.
"""

from dynident.report.figures.bound import CHANGE_NAMES, bound_figure, efficiency_figure
from dynident.report.figures.canvas import Array, Drawing, share, thin
from dynident.report.figures.comparison import difference_figure
from dynident.report.figures.excitation import Quantity, designed_figure, distance_figure, expected_figure
from dynident.report.figures.fleet import Course, Mark, course_figure, pooled_figure, robots_figure
from dynident.report.figures.identification import (
    error_figure,
    motion_figure,
    run_figure,
    smoothing_figure,
    torque_figure,
)
from dynident.report.figures.parameters import interval_figure, only_nominal, relative_std, singular_figure
from dynident.report.figures.payload import payload_figure
from dynident.report.figures.pieces import pieces_figure
from dynident.report.figures.scene import Mesh, box, cylinder, plate, scene_figure
from dynident.report.figures.study import method_name, scientific, spread_figure, trace_figure
from dynident.report.figures.terms import trial_figure

__all__ = [
    "CHANGE_NAMES",
    "Array",
    "Course",
    "Drawing",
    "Mark",
    "Mesh",
    "Quantity",
    "bound_figure",
    "box",
    "course_figure",
    "cylinder",
    "designed_figure",
    "difference_figure",
    "distance_figure",
    "efficiency_figure",
    "error_figure",
    "expected_figure",
    "interval_figure",
    "method_name",
    "motion_figure",
    "only_nominal",
    "payload_figure",
    "pieces_figure",
    "plate",
    "pooled_figure",
    "relative_std",
    "robots_figure",
    "run_figure",
    "scene_figure",
    "scientific",
    "share",
    "singular_figure",
    "smoothing_figure",
    "spread_figure",
    "thin",
    "torque_figure",
    "trace_figure",
    "trial_figure",
]
