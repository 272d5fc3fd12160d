"""What repeats a run, in a report: the configuration, the hashes of what was read, versions and settings."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dynident.report.calibration_words import settings_of
from dynident.report.page import Code, Column, Fold, PageBlock, PageSection, PageTable, pairs
from dynident.report.typography import said
from dynident.report.words import day

if TYPE_CHECKING:
    from dynident.identification import Identification

__all__ = ["repeat_section"]

_LEAD = (
    "The same files, configuration and versions give the same result but for its date: apart from the seed below, "
    "nothing is drawn."
)


def repeat_section(identification: Identification) -> PageSection:
    """Return the section with everything needed to repeat the run."""
    sources, blocks = identification.provenance, list[PageBlock]([_LEAD])
    if sources.configuration is not None:
        blocks.append(Fold(f"Configuration: {sources.configuration.path}", (Code(sources.configuration.text),)))
    files = [(one.path, day(one.modified), one.sha256) for one in (sources.model, *sources.logs) if one is not None]
    if files:
        columns = tuple(Column(title, numeric=False) for title in ("file", "of", "SHA-256"))
        blocks.append(PageTable(columns, tuple(files), "Files that were read, with the dates of the recordings' files"))
    blocks.append(pairs("package", list(sources.versions.items()), "Versions"))
    settings = [(name, said(text)) for name, text in settings_of(identification).items()]
    blocks.append(Fold("All settings", (pairs("setting", settings),)))
    return PageSection("To repeat the run", tuple(blocks))
