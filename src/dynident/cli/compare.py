"""``dynident compare``: smoothers and estimators on the same logs, ranked on held-out motion."""

from __future__ import annotations

from pathlib import Path

import click

from dynident.cli.options import CONFIG, DIRECTORY, FILE
from dynident.cli.terminal import console, status, tell
from dynident.cli.workers import Spread, spread

__all__ = ["compare"]

PRELOADED = ("dynident.ranking.fit", "dynident.estimators", "dynident.smoothers")


def _listed(ctx: click.Context, option: click.Parameter, value: str | None) -> list[str] | None:
    """Return the kinds of a list with commas."""
    if value is None:
        return None
    kinds = [one.strip() for one in value.split(",") if one.strip()]
    if not kinds:
        raise click.BadParameter("no kind is given; name some, separated by commas.", ctx, option)
    return kinds


@click.command(short_help="Rank smoothers and estimators on held-out motion.")
@click.argument("config", type=CONFIG)
@click.option("--smoothers", metavar="KIND,...", callback=_listed, help="Smoothers to try.  [default: all]")
@click.option(
    "--estimators", metavar="KIND,...", callback=_listed,
    help="Estimators to try; consistent+KIND makes a linear one consistent with physics.  [default: all that apply]",
)  # fmt: skip
@click.option(
    "--truth", type=FILE,
    help="File of true parameters: YAML of values by name, a robot file, or a result.json.",
)  # fmt: skip
@click.option(
    "--folds", type=click.IntRange(0), default=5, show_default=True,
    help="Stretches of the cross-validation, which ranks where no log is held out; 0 for none.",
)  # fmt: skip
@spread
@click.option(
    "--out",
    type=DIRECTORY,
    help="Folder for report.html, compare.json and compare.parquet; rows in it are not repeated.",
)
@click.option("--rerun", is_flag=True, help="Compute all rows anew.")
@click.option("--json", "json_file", type=FILE, help="JSON file for all numbers.")
def compare(
    config: Path,
    smoothers: list[str] | None,
    estimators: list[str] | None,
    truth: Path | None,
    folds: int,
    spread: Spread,
    out: Path | None,
    rerun: bool,
    json_file: Path | None,
) -> None:
    """Fit the logs of CONFIG (YAML) by each smoother with each estimator, rank them by the torque error on held-out
    logs, and say which differences are more than chance. Smoother and estimator of CONFIG are always among them."""
    from dynident.io.opener import keep, refuse_inputs
    from dynident.io.results import check_json, probe_folder, write_json
    from dynident.report.compare_run import compare as compared
    from dynident.report.ranking import ranking_dict, ranking_findings, ranking_heading, ranking_tables

    for path in (config, *((truth,) if truth else ())):
        keep(path)
    if json_file:
        refuse_inputs(json_file)
        check_json(json_file)
        probe_folder(json_file.parent)
    with status() as say, spread.executor(*PRELOADED) as executor:
        found = compared(
            config, out, smoothers=smoothers, estimators=estimators, truth=truth, folds=folds, executor=executor,
            limits=spread.limits, rerun=rerun, progress=say,
        )  # fmt: skip
    screen = console()
    screen.say(f"{found.name}: {ranking_heading(found)}.", "bold")
    for table in ranking_tables(found):
        screen.show(table)
    for line in ranking_findings(found):
        screen.say(f"* {line}")
    if json_file:
        tell(screen, "Numbers", write_json(json_file, ranking_dict(found)))
    if out:
        from dynident.ranking import FILES

        for what, name in zip(("Table", "Numbers", "Report"), FILES, strict=True):
            tell(screen, what, out / name)
    if not found.ranked:
        raise click.ClickException("no combination has an estimate; see the reasons above")
