"""Reports: pure functions from a study or an identification to one HTML page that works offline, or terminal tables."""

from __future__ import annotations

from dynident.report import instrument_words, output_error_words  # noqa: F401  # register their words
from dynident.report.identification import (
    identification_notes,
    identification_page,
    identification_tables,
    result_words,
)
from dynident.report.study import findings, study_page, study_tables, study_text

__all__ = [
    "findings",
    "identification_notes",
    "identification_page",
    "identification_tables",
    "result_words",
    "study_page",
    "study_tables",
    "study_text",
]
