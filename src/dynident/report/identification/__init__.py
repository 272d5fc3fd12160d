"""The report of an identification, one file for each part of its page."""

from dynident.report.identification.figures import (
    error_figure,
    glance_figure,
    has_nominal_values,
    interval_figure,
    motion_figure,
    pieces_figure,
    relative_std,
    run_figure,
    singular_figure,
    smoothing_figure,
    torque_figure,
    trial_figure,
)
from dynident.report.identification.report import (
    identification_notes,
    identification_page,
    identification_tables,
    result_words,
)
