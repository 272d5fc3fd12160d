"""The files of a model in a report: what was written, how it was proven, what it leaves out, and what was refused."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from hashlib import sha256
from typing import TYPE_CHECKING, Any

from dynident.report.page import Column, PageBlock, PageSection, PageTable, number, relative
from dynident.report.words import count, percent, tiny

if TYPE_CHECKING:
    from dynident.export import Export, FileError

__all__ = ["export_links", "export_notes", "export_results", "export_section"]

_LEAD = (
    "Each file was loaded again before it was written, and its torque compared with that of the identified model, "
    "without what the format cannot hold: the largest difference of a joint, relative to the norm of its torque."
)


def export_section(exports: Sequence[Export]) -> Iterator[PageSection]:
    """Yield the section on the files, where there are any."""
    if not exports:
        return
    rows = tuple(
        (one.file, tiny(one.proof.agreement) if one.proof else "-", _readers(one), "yes" if one.ready else "no")
        for one in exports
    )
    words = (Column("file", numeric=False), Column("difference"))
    columns = (*words, Column("loaded by", numeric=False), Column("written", numeric=False))
    links = tuple(relative(one.file) if one.ready else "" for one in exports)
    blocks: list[PageBlock] = [_LEAD, PageTable(columns, rows, "Files of the identified model", links)]
    for one in exports:
        notes = [*([f"Not written: {one.refusal}"] if one.refusal else []), *(one.written.notes if one.written else ())]
        notes += [f"Not in the file: {words}." for words in (one.written.left_out if one.written else ())]
        notes += one.proof.skipped if one.proof else ()
        if notes:
            blocks.append(PageSection(one.file, (tuple(notes),)))
    if costs := [(one.file, error.log, error.model, error.file) for one in exports for error in _costs(one)]:
        blocks.append(_table_of(costs))
    yield PageSection("Files of the model", tuple(blocks))


def export_links(exports: Sequence[Export]) -> tuple[str, ...]:
    """Return links to the files that lie beside the report, as one paragraph of HTML; nothing where there are none."""
    from markupsafe import Markup

    files = [one.file for one in exports if one.ready]
    if not files:
        return ()
    link = Markup('<a href="{}">{}</a>')
    return (
        Markup('<p class="files">Files: {}</p>').format(
            Markup(", ").join(link.format(relative(name), name) for name in ("result.json", *files))
        ),
    )


def _table_of(costs: Sequence[tuple[str, str, float, float]]) -> PageTable:
    """Return what the parameters that a file cannot hold cost."""
    columns = (Column("file", numeric=False), Column("log", numeric=False), Column("model (%)"), Column("file (%)"))
    rows = tuple((file, log, number(model, 4), number(own, 4)) for file, log, model, own in costs)
    return PageTable(columns, rows, "Relative torque error of the model, and of files that leave something of it out")


def _costs(one: Export) -> Sequence[FileError]:
    """Return the errors of a file that leaves something out, on held-out logs, or on all where none is held out."""
    if one.written is None or not one.written.left_out:
        return ()
    return [error for error in one.errors if error.role == "validation"] or one.errors


def export_notes(exports: Sequence[Export], place: str = "listed in the report") -> list[str]:
    """Return for a terminal what is said of the files: refusals, and how much a file leaves out, listed in a place."""
    notes = [f"{one.file} is not written: {one.refusal}" for one in exports if one.refusal]
    for one in exports:
        if one.ready and one.written and one.written.left_out:
            notes.append(f"{one.file} cannot hold {count(len(one.written.left_out), 'item')}, {place}.{_cost(one)}")
        notes += [f"{one.file}: {note}." for note in (one.written.notes if one.ready and one.written else ())]
    return notes


def _cost(one: Export) -> str:
    """Return a sentence on the log on which the file loses most."""
    worst = max(_costs(one), key=lambda error: error.file - error.model, default=None)
    if worst is None:
        return ""
    file, model = percent(worst.file, 4), percent(worst.model, 4)
    return f" By itself it has a torque error of {file} on {worst.log!r}, the model {model}."


def export_results(exports: Sequence[Export]) -> list[dict[str, Any]]:
    """Return the files as plain values: file, sha256, format, agreement, proven, readers, left_out, notes,
    refusal, and errors: the torque error (%) of model and file on each log.
    """
    return [
        {
            "file": one.file,
            "sha256": sha256(one.written.text.encode(errors="backslashreplace")).hexdigest() if one.written else None,
            "format": one.format,
            "agreement": one.proof.agreement if one.proof else None,
            "proven": one.ready,
            "readers": dict(one.proof.readers) if one.proof else {},
            "left_out": list(one.written.left_out) if one.written else [],
            "notes": [*(one.written.notes if one.written else ()), *(one.proof.skipped if one.proof else ())],
            "refusal": one.refusal,
            "errors": [asdict(error) for error in one.errors],
        }
        for one in exports
    ]


def _readers(one: Export) -> str:
    return ", ".join(one.proof.readers) if one.proof else "-"
