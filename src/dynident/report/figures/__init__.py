"""Figures of a study, an identification and a fleet: nouns in, drawings out; no file is opened or written.

Backgrounds are transparent and fonts inherited. Lines with ``meta`` "ink" and all text are drawn in a grey that is
readable on white and on black; a page may repaint them in its own text colour.
"""

from dynident.report.figures.bound import CHANGE_NAMES, bound_figure, efficiency_figure
from dynident.report.figures.canvas import Array, Drawing, clock, share, thin
from dynident.report.figures.comparison import difference_figure
from dynident.report.figures.excitation import Quantity, designed_figure, distance_figure, expected_figure
from dynident.report.figures.fleet import Course, Mark, course_figure, pooled_figure, robots_figure
from dynident.report.figures.identification import (
    error_figure,
    glance_figure,
    motion_figure,
    run_figure,
    smoothing_figure,
    torque_figure,
)
from dynident.report.figures.parameters import interval_figure, only_nominal, relative_std, singular_figure
from dynident.report.figures.payload import payload_figure
from dynident.report.figures.pieces import pieces_figure
from dynident.report.figures.ranking import cost_figure, ranking_figure
from dynident.report.figures.robot import (
    Ellipsoid,
    centres,
    ellipsoids,
    key,
    lighter,
    outlined,
    path_of,
    standing,
    surface,
)
from dynident.report.figures.scene import (
    METAL,
    STILL,
    Layer,
    Mesh,
    Moving,
    Replay,
    box,
    cylinder,
    plate,
    scene_figure,
    solid,
)
from dynident.report.figures.study import method_name, scientific, spread_figure, trace_figure
from dynident.report.figures.terms import trial_figure

__all__ = [
    "CHANGE_NAMES",
    "METAL",
    "STILL",
    "Array",
    "Course",
    "Drawing",
    "Ellipsoid",
    "Layer",
    "Mark",
    "Mesh",
    "Moving",
    "Quantity",
    "Replay",
    "bound_figure",
    "box",
    "centres",
    "clock",
    "cost_figure",
    "course_figure",
    "cylinder",
    "designed_figure",
    "difference_figure",
    "distance_figure",
    "efficiency_figure",
    "ellipsoids",
    "error_figure",
    "expected_figure",
    "glance_figure",
    "interval_figure",
    "key",
    "lighter",
    "method_name",
    "motion_figure",
    "only_nominal",
    "outlined",
    "path_of",
    "payload_figure",
    "pieces_figure",
    "plate",
    "pooled_figure",
    "ranking_figure",
    "relative_std",
    "robots_figure",
    "run_figure",
    "scene_figure",
    "scientific",
    "share",
    "singular_figure",
    "smoothing_figure",
    "solid",
    "spread_figure",
    "standing",
    "surface",
    "thin",
    "torque_figure",
    "trace_figure",
    "trial_figure",
]
