"""Pages, tables, figures and words that all reports share, and the report of an identification."""

from dynident.report.figures import Array, Drawing, clock, method_name, points_per_curve, scientific, thin
from dynident.report.scene import (
    METAL,
    STILL,
    Ellipsoid,
    Layer,
    MovingTrace,
    Replay,
    centre_marks,
    ellipsoid_circles,
    legend_key,
    lighten_colour,
    path_trace,
    root_surface,
    scene_figure,
    solid,
    solid_ellipsoids,
    surface,
)
