"""``dynident identify``: from a configuration to parameters."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dynident.cli.terminal import DIRECTORY, FILE, console, status, tell

if TYPE_CHECKING:
    from dynident.identify import Identification

__all__ = ["identify", "run_config"]

MOST_STEPS = 6  # in a terminal; the report has all


@click.command(short_help="Identify parameters from recordings.")
@click.argument("config", type=FILE)
@click.option("--out", type=DIRECTORY, help="Folder for result.json and report.html.")
def identify(config: Path, out: Path | None) -> None:
    """Identify the parameters named in CONFIG (YAML) from its logs, and judge them on held-out logs."""
    from dynident.io.results import probe_folder, write_json, write_text
    from dynident.report import identification_notes, identification_page, identification_tables, result_dict
    from dynident.report.verdict import verdict_text

    if out:
        probe_folder(out)
    with status() as say:
        found = run_config(config, say)
    screen = console()
    verdict, steps = verdict_text(found)
    screen.print(verdict, style="bold", soft_wrap=True, highlight=False, markup=False)
    for table in identification_tables(found):
        screen.print(table)
    for note in identification_notes(found):
        style = "yellow" if note.startswith("Warning") else None
        screen.print(note, style=style, soft_wrap=True, highlight=False, markup=False)
    for step in steps[:MOST_STEPS]:
        screen.print(f"Next: {step}", soft_wrap=True, highlight=False, markup=False)
    if out:
        result, page = result_dict(found), identification_page(found)
        tell(screen, "Result", write_json(out / "result.json", result))
        tell(screen, "Report", write_text(out / "report.html", page))


def run_config(path: Path, say: Callable[[str], None]) -> Identification:
    """Run the identification that a configuration file describes; ``say`` is told each step."""
    from dataclasses import replace

    from dynident.identify import identify as run
    from dynident.io.config import config_warnings, load_model, read_config
    from dynident.io.logs import read_roles
    from dynident.io.recipe import build_recipe

    config = read_config(path)
    say("building the model")
    model = load_model(config.model, path.parent)
    recipe = build_recipe(config)
    warnings = [*config_warnings(config), *(note for term in model.terms for note in getattr(term, "notes", ()))]
    logs, remarks = read_roles(config, model.joints, say)
    found = run(model, logs["train"], logs["validation"], recipe, progress=say)
    settings = {"configuration": path.read_text(encoding="utf-8"), **found.settings}
    return replace(found, warnings=(*warnings, *remarks, *found.warnings), settings=settings)
