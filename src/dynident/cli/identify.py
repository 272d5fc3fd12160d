"""``dynident identify``: from a configuration to parameters."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dynident.cli.terminal import DIRECTORY, FILE, console, say_line, status, tell

if TYPE_CHECKING:
    from dynident.export import Export
    from dynident.identification import Identification

__all__ = ["identify"]

MOST_STEPS = 6  # in a terminal; the report has all


@click.command(short_help="Identify parameters from recordings.")
@click.argument("config", type=FILE)
@click.option("--out", type=DIRECTORY, help="Folder for result.json, report.html, and the model's files.")
def identify(config: Path, out: Path | None) -> None:
    """Identify the parameters named in CONFIG (YAML) from its logs, and judge them on held-out logs."""
    from dynident.export import export_files, exports
    from dynident.io.opener import refuse_inputs
    from dynident.io.project import read_project
    from dynident.io.results import probe_folder
    from dynident.report import identification_notes, identification_tables
    from dynident.report.exports import export_notes
    from dynident.report.verdict import verdict_text
    from dynident.report.wording import Line

    if out:
        probe_folder(out)
    with status() as say:
        project = read_project(config, say)
        if out:
            names = ("result.json", "report.html", *export_files(project.model))
            refuse_inputs(*(out / name for name in names))
        found = project.identify(say)
        say("writing and verifying the model")
        made = exports(found) if out else ()
    # written before anything is printed: the reader of a pipe may close it early
    written = _write(out, found, made) if out else []
    screen = console()
    verdict, steps = verdict_text(found)
    screen.print(verdict, style="bold", soft_wrap=True, highlight=False, markup=False)
    for table in identification_tables(found):
        screen.print(table)
    for note in (*identification_notes(found), *map(Line, export_notes(made))):
        say_line(screen, note)
    for step in steps[:MOST_STEPS]:
        screen.print(f"Next: {step}", soft_wrap=True, highlight=False, markup=False)
    for what, path in written:
        tell(screen, what, path)


def _write(out: Path, found: Identification, made: Sequence[Export]) -> list[tuple[str, Path]]:
    """Write the model's files, result.json and report.html; return what was written where."""
    from dynident.io.result_write import result_data
    from dynident.io.results import remove, write_json, write_text
    from dynident.report import identification_page, result_words

    result, page = result_data(found, result_words(found, made)), identification_page(found, made)
    written = []
    for one in made:
        if one.ready and one.written is not None:
            written.append(("Model", write_text(out / one.file, one.written.text)))
        else:
            remove(out / one.file)  # of an earlier run: it would pass for this one's
    written.append(("Result", write_json(out / "result.json", result)))
    return [*written, ("Report", write_text(out / "report.html", page))]
