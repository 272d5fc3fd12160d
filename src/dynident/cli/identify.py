"""``dynident identify``: from a configuration to parameters."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dynident.cli.terminal import DIRECTORY, FILE, console, say_line, status, tell

if TYPE_CHECKING:
    from dynident.export import Export
    from dynident.identify import Identification

__all__ = ["identify", "run_config"]

MOST_STEPS = 6  # in a terminal; the report has all


@click.command(short_help="Identify parameters from recordings.")
@click.argument("config", type=FILE)
@click.option("--out", type=DIRECTORY, help="Folder for result.json, report.html, and the model's files.")
def identify(config: Path, out: Path | None) -> None:
    """Identify the parameters named in CONFIG (YAML) from its logs, and judge them on held-out logs."""
    from dynident.export import exports
    from dynident.io.results import probe_folder
    from dynident.report import identification_notes, identification_tables
    from dynident.report.exports import export_notes
    from dynident.report.verdict import verdict_text
    from dynident.report.wording import Line

    if out:
        probe_folder(out)
    with status() as say:
        found = run_config(config, say)
        say("writing the model and loading it again")
        made = exports(found) if out else ()
    # written before anything is printed: who reads the terminal may leave early
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
    from dynident.io.results import remove, write_json, write_text
    from dynident.io.saved import check_targets
    from dynident.report import identification_page, result_dict

    check_targets(out, (one.file for one in made), found.settings)
    result, page = result_dict(found, made), identification_page(found, made)
    written = []
    for one in made:
        if one.ready and one.written is not None:
            written.append(("Model", write_text(out / one.file, one.written.text)))
        else:
            remove(out / one.file)  # of an earlier run: it would pass for this one's
    written.append(("Result", write_json(out / "result.json", result)))
    return [*written, ("Report", write_text(out / "report.html", page))]


def run_config(path: Path, say: Callable[[str], None]) -> Identification:
    """Run the identification that a configuration file describes; ``say`` is told each step."""
    from dataclasses import replace

    from dynident.diagnostics import Remark
    from dynident.identify import identify as run
    from dynident.io.config import config_warnings, load_model, read_config
    from dynident.io.logs import read_roles
    from dynident.io.recipe import build_recipe
    from dynident.io.saved import log_hashes, model_settings

    config = read_config(path)
    say("building the model")
    model = load_model(config.model, path.parent)
    recipe = build_recipe(config)
    warnings = [*config_warnings(config), *(note for term in model.terms for note in getattr(term, "notes", ()))]
    logs, remarks = read_roles(config, model.joints, say)
    read = {"configuration": path.read_text(encoding="utf-8-sig"), **model_settings(config, path), **log_hashes(config)}
    found = run(model, logs["train"], logs["validation"], recipe, progress=say)
    return replace(
        found, warnings=(*map(Remark, (*warnings, *remarks)), *found.warnings), settings={**read, **found.settings}
    )
