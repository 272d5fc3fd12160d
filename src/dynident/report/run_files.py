"""The files of one run: its result and its report."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from dynident.io.meshes import result_geometry
from dynident.io.result_write import result_data
from dynident.io.results import json_text
from dynident.report.identification import identification_page, result_words

if TYPE_CHECKING:
    from dynident.export import Export
    from dynident.identification import Identification

__all__ = ["run_files"]


def run_files(identification: Identification, exports: Sequence[Export] = ()) -> dict[str, str]:
    """Return the texts of result.json and report.html."""
    return {
        "result.json": json_text(result_data(identification, result_words(identification, exports))),
        "report.html": identification_page(identification, exports, result_geometry(identification)),
    }
