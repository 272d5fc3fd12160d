"""``dynident fleet``: many logs of many robots with one recipe."""

from __future__ import annotations

from pathlib import Path

import click

from dynident.cli.escapes import one_line
from dynident.cli.options import CONFIG, DIRECTORY
from dynident.cli.terminal import console, status, tell
from dynident.cli.voice import complain
from dynident.cli.workers import Spread, spread

__all__ = ["fleet"]

PRELOADED = ("dynident.fleets.fit", "dynident.report.run_files")


@click.command(short_help="Identify many logs of many robots, and find what changes.")
@click.argument("config", type=CONFIG)
@click.option(
    "--out", type=DIRECTORY, required=True,
    help="Folder for report.html, fleet.parquet, recipe.yaml and the runs; what is known there stays.",
)  # fmt: skip
@click.option("--rerun", is_flag=True, help="Identify all logs anew.")
@spread
def fleet(config: Path, out: Path, rerun: bool, spread: Spread) -> None:
    """Identify the logs that CONFIG (YAML) lists of many robots, each with the same recipe, and report how parameters
    change over time, which changes are beyond their uncertainty, and what robots of one type share."""
    from dynident.fleets.folders import REPORT, TABLE
    from dynident.report.fleet import fleet_findings, fleet_heading, fleet_tables
    from dynident.report.fleet_run import fleet as run

    with status() as say, spread.executor(*PRELOADED) as executor:
        found = run(config, out, executor=executor, limits=spread.limits, rerun=rerun, progress=say)
    for words in found.warnings:
        complain(one_line(f"Warning: {words}"))
    screen = console()
    screen.say(f"{found.name}: {fleet_heading(found)}", "bold")
    for table in fleet_tables(found):
        screen.show(table)
    for line in fleet_findings(found):
        screen.say(f"* {line}")
    if known := len(found.rows) - found.fitted:
        screen.remark(f"Logs identified now: {found.fitted}; known before: {known}.")
    for what, name in (("Table", TABLE), ("Report", REPORT)):
        tell(screen, what, out / name)
    if not found.histories:
        first = next((f": {reason}" for reason in found.rows["reason"] if reason), "")
        raise click.ClickException(f"no log has a result{first}")
