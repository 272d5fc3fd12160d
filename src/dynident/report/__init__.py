"""Pages, tables, figures and words that all reports share, and the report of an identification."""

from dynident.report.figures import Array, Drawing, method_name, scientific, thin
from dynident.report.scene import METAL, STILL, Replay, path_trace, root_surface, scene_figure, solid, surface
