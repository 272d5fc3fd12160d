"""``dynident compare-results``: saved results side by side, for eyes and as a gate."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dynident.cli.options import DIRECTORY, FILE, RESULT, Range
from dynident.cli.terminal import console, status, tell

if TYPE_CHECKING:
    from dynident.identification import ResultComparison

__all__ = ["compare_results"]

DIFFERENT = 3  # exit code
NUMBERS, PAGE = "comparison.json", "report.html"


@click.command("compare-results", short_help="Compare saved results: parameters, errors and files.")
@click.argument("reference", type=RESULT)
@click.argument("results", nargs=-1, required=True, metavar="RESULT...", type=RESULT)
@click.option(
    "--level", type=Range(0, 1, min_open=True, max_open=True), default=0.01, show_default=True,
    help="Level of significance: how often parameters that are the same may be said to differ.",
)  # fmt: skip
@click.option(
    "--tolerance", type=Range(0, 1000), default=5.0, show_default=True, metavar="PERCENT",
    help="How much larger the torque error on a log may be, in % of that of REFERENCE.",
)  # fmt: skip
@click.option("--only-worse", is_flag=True, help="Exit code 3 only where a RESULT is worse, not where it differs.")
@click.option("--json", "json_file", type=FILE, help="JSON file for all numbers.")
@click.option("--out", type=DIRECTORY, help="Folder for report.html and comparison.json.")
def compare_results(
    reference: Path, results: tuple[Path, ...], level: float, tolerance: float, only_worse: bool,
    json_file: Path | None, out: Path | None,
) -> None:  # fmt: skip
    """Compare each RESULT with REFERENCE, all of them a result.json of identify: base parameters with significance,
    torque errors on logs of the same name, verdicts, and the files of the model. No model file is needed.

    The exit code is 3 where parameters differ significantly, or a RESULT is worse: its torque error on the same
    recording is larger than REFERENCE's by more than the tolerance, its verdict is lower, or a file of the model could
    be proven before and cannot now. It is 3 as well where a RESULT has nothing that can be compared.
    """
    from dynident.identification import compare_results as compared
    from dynident.io.compared import compared_names, read_compared
    from dynident.io.folder import refuse_other_report, result_folder
    from dynident.io.opener import keep, refuse_inputs
    from dynident.io.results import check_json, json_text, probe_folder, write_json
    from dynident.report.comparison import comparison_dict, comparison_page

    paths = (reference, *results)
    for path in paths:
        keep(path)
    if json_file:
        refuse_inputs(json_file)
        check_json(json_file)
        probe_folder(json_file.parent)
    if out:
        refuse_inputs(out / NUMBERS, out / PAGE)
        refuse_other_report(out, NUMBERS)
    with result_folder(out) if out else nullcontext() as folder:
        with status() as say:
            say("reading the results")
            first, *others = [
                read_compared(path, name) for path, name in zip(paths, compared_names(paths), strict=True)
            ]
            found = [compared(first, one, level, tolerance) for one in others]
        numbers = comparison_dict(found)
        written = folder.replace({NUMBERS: json_text(numbers), PAGE: comparison_page(found)}) if folder else ()
    _show(found)
    screen = console()
    if json_file:
        tell(screen, "Numbers", write_json(json_file, numbers))
    for what, path in zip(("Numbers", "Report"), written, strict=False):
        tell(screen, what, path)
    if any(one.worse or not one.comparable or (one.differs and not only_worse) for one in found):
        raise SystemExit(DIFFERENT)


def _show(found: list[ResultComparison]) -> None:
    """Print all comparisons."""
    from dynident.report.comparison import comparison_lines, comparison_tables, headline, overview_table

    screen = console()
    screen.show(overview_table([found[0].first, *(one.second for one in found)]))
    for one in found:
        screen.say(headline(one), "bold")
        for line in comparison_lines(one):
            screen.say(line)
        screen.say("")
        for table in comparison_tables(one):
            screen.show(table)
