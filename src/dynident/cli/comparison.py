"""What compares: ``dynident compare`` methods, ``compare-results`` results, and ``fleet`` logs and robots."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dynident.cli.command_log import command_log
from dynident.cli.options import DIRECTORY, FILE, JSON_FILE, FiniteRange, WorkerOptions, add_worker_options
from dynident.cli.terminal import console, print_files, print_path, status
from dynident.runtime import report_progress

if TYPE_CHECKING:
    from dynident.apps.compare_results import ResultComparison

# imported by all workers at once
COMPARE_MODULES = ("dynident.apps.ranking.fit", "dynident.estimators", "dynident.motion.smoothers")
FLEET_MODULES = ("dynident.apps.fleets.fit", "dynident.report.identification.report")
DIFFERENT_EXIT_CODE = 3  # exit code
MAX_VERBOSE_ROWS = 40  # rows of a ranking
NUMBERS, PAGE = "comparison.json", "report.html"


def _split_kinds(ctx: click.Context, option: click.Parameter, value: str | None) -> list[str] | None:
    """Return the kinds in a list separated by commas."""
    if value is None:
        return None
    kinds = [kind.strip() for kind in value.split(",") if kind.strip()]
    if not kinds:
        raise click.BadParameter("no kind is given; name some, separated by commas.", ctx, option)
    return kinds


@click.command(short_help="Rank smoothers and estimators on held-out motion.")
@click.argument("config", type=FILE)
@click.option("--smoothers", metavar="KIND,...", callback=_split_kinds, help="Smoothers to try.  [default: all]")
@click.option(
    "--estimators", metavar="KIND,...", callback=_split_kinds,
    help="Estimators to try; consistent+KIND makes a linear one consistent with physics.  [default: all that apply]",
)  # fmt: skip
@click.option(
    "--truth", type=FILE,
    help="File of true parameters: YAML of values by name, a robot file, or a result.json.",
)  # fmt: skip
@click.option(
    "--folds", type=click.IntRange(0), default=5, show_default=True,
    help="Folds of the cross-validation, which ranks if no log is held out; 0 for none.",
)  # fmt: skip
@add_worker_options
@click.option("--out", type=DIRECTORY, help="Folder for report.html, compare.json and compare.parquet; it is resumed.")
@click.option("--rerun", is_flag=True, help="Compute all rows anew.")
@JSON_FILE
def compare(
    config: Path, smoothers: list[str] | None, estimators: list[str] | None, truth: Path | None, folds: int,
    spread: WorkerOptions, out: Path | None, rerun: bool, json_file: Path | None,
) -> None:  # fmt: skip
    """Fit the logs of CONFIG (YAML) with each smoother and each estimator, and rank them by the torque error on
    held-out logs; a test tells whether differences are due to chance. Smoother and estimator of CONFIG are included."""
    from dynident.apps import ranking as methods
    from dynident.apps.ranking.report import (
        MAX_FINDINGS,
        MAX_ROWS,
        ranking_dict,
        ranking_findings,
        ranking_heading,
        ranking_tables,
    )
    from dynident.files.results import claim_json, write_json

    claim_json(json_file, config, *((truth,) if truth else ()))
    with status(), spread.executor(*COMPARE_MODULES) as executor:
        ranking = methods.compare(
            config, out, smoothers=smoothers, estimators=estimators, truth=truth, folds=folds, executor=executor,
            limits=spread.limits, rerun=rerun)  # fmt: skip
    screen = console()
    rows, findings = (MAX_VERBOSE_ROWS, None) if command_log().verbose else (MAX_ROWS, MAX_FINDINGS)
    for table in ranking_tables(ranking, rows):
        screen.show(table)
    for line in ranking_findings(ranking)[:findings]:
        screen.say(f"* {line}")
    if json_file:
        print_path(screen, "Numbers", write_json(json_file, ranking_dict(ranking)))
    if out:
        from dynident.apps.ranking import FILES

        print_files(screen, [out / name for name in FILES])
    screen.say(f"{ranking.name}: {ranking_heading(ranking)}.", "bold")
    if not ranking.standings:
        raise click.ClickException("no combination has an estimate; see the reasons above")


@click.command("compare-results", short_help="Compare saved results: parameters, errors and files.")
@click.argument("reference", type=FILE)
@click.argument("results", nargs=-1, required=True, metavar="RESULT...", type=FILE)
@click.option(
    "--level", type=FiniteRange(0, 1, min_open=True, max_open=True), default=0.01, show_default=True,
    help="Significance level of the tests of parameters.",
)  # fmt: skip
@click.option(
    "--tolerance", type=FiniteRange(0, 1000), default=5.0, show_default=True, metavar="PERCENT",
    help="Accepted increase of the torque error on a log, in % of that of REFERENCE.",
)  # fmt: skip
@click.option("--only-worse", is_flag=True, help="Exit code 3 only if a RESULT is worse, not if it differs.")
@JSON_FILE
@click.option("--out", type=DIRECTORY, help="Folder for report.html and comparison.json.")
def compare_results(
    reference: Path, results: tuple[Path, ...], level: float, tolerance: float, only_worse: bool,
    json_file: Path | None, out: Path | None,
) -> None:  # fmt: skip
    """Compare each RESULT with REFERENCE (result.json of identify): base parameters with significance, torque errors on
    logs of the same name, verdicts, and the files of the model. No model file is needed.

    The exit code is 3 if parameters differ significantly, if nothing can be compared, or if a RESULT is worse: its
    torque error on the same recording exceeds the tolerance, its verdict is lower, or a file of the model can no longer
    be verified.
    """
    from dynident.apps import compare_results as app
    from dynident.apps.compare_results.config import compared_names, read_compared
    from dynident.apps.compare_results.report import comparison_dict, comparison_page
    from dynident.files.folder import refuse_other_report, result_folder
    from dynident.files.opener import refuse_inputs
    from dynident.files.results import claim_json, json_text, write_json

    paths = (reference, *results)
    claim_json(json_file, *paths)
    if out:
        refuse_inputs(out / NUMBERS, out / PAGE)
        refuse_other_report(out, NUMBERS)
    with result_folder(out) if out else nullcontext() as folder:
        with status():
            report_progress("reading the results")
            first, *others = map(read_compared, paths, compared_names(paths))
            comparisons = [app.compare_results(first, other, level, tolerance) for other in others]
        numbers = comparison_dict(comparisons)
        written = folder.replace({NUMBERS: json_text(numbers), PAGE: comparison_page(comparisons)}) if folder else ()
    _show_comparisons(comparisons)
    screen = console()
    if json_file:
        print_path(screen, "Numbers", write_json(json_file, numbers))
    print_files(screen, written)
    if any(x.worse or not x.comparable or (x.differs and not only_worse) for x in comparisons):
        raise SystemExit(DIFFERENT_EXIT_CODE)


def _show_comparisons(comparisons: list[ResultComparison]) -> None:
    """Print all comparisons."""
    from dynident.apps.compare_results.report import comparison_lines, comparison_tables, headline, overview_table

    screen = console()
    screen.show(overview_table([comparisons[0].first, *(comparison.second for comparison in comparisons)]))
    for comparison in comparisons:
        screen.say(headline(comparison), "bold")
        for line in comparison_lines(comparison):
            screen.say(line)
        for table in comparison_tables(comparison):
            screen.show(table, detail=True)


@click.command(short_help="Identify many logs of many robots, and find changes.")
@click.argument("config", type=FILE)
@click.option(
    "--out", type=DIRECTORY, required=True,
    help="Folder for report.html, fleet.parquet, recipe.yaml and the runs; earlier results in it are kept.",
)  # fmt: skip
@click.option("--rerun", is_flag=True, help="Identify all logs anew.")
@add_worker_options
def fleet(config: Path, out: Path, rerun: bool, spread: WorkerOptions) -> None:
    """Identify the logs of many robots, listed in CONFIG (YAML), with one recipe. Report how parameters change over
    time, which changes are significant, and what robots of one type share."""
    from dynident.apps import fleets
    from dynident.apps.fleets.config import REPORT, TABLE
    from dynident.apps.fleets.report import fleet_findings, fleet_heading, fleet_tables

    with status(), spread.executor(*FLEET_MODULES) as executor:
        fleet_result = fleets.fleet(config, out, executor=executor, limits=spread.limits, rerun=rerun)
    screen = console()
    for words in fleet_result.warnings:
        screen.remark(f"Warning: {words}", "yellow")
    for table in fleet_tables(fleet_result):
        screen.show(table, detail=True)
    for line in fleet_findings(fleet_result):
        screen.say(f"* {line}")
    if known_logs := len(fleet_result.rows) - fleet_result.identified_count:
        screen.remark(f"Logs identified now: {fleet_result.identified_count}; known before: {known_logs}.")
    print_files(screen, [out / TABLE, out / REPORT])
    screen.say(f"{fleet_result.name}: {fleet_heading(fleet_result)}", "bold")
    if not fleet_result.histories:
        first_reason = next((f": {reason}" for reason in fleet_result.rows["reason"] if reason), "")
        raise click.ClickException(f"no log has a result{first_reason}")
