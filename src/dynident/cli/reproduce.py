"""``dynident reproduce``: run the article's study again."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dynident.cli.options import DIRECTORY, FILE
from dynident.cli.terminal import console, status, tell
from dynident.cli.workers import Spread, spread

if TYPE_CHECKING:
    from dynident.studies.article import Reproduction

__all__ = ["reproduce"]

PRELOADED = ("dynident.studies.warm", "dynident.studies.article")  # by all workers at once


@click.command(short_help="Run the article's study again.")
@click.option("--scenario", default="tabulated", show_default=True, help="tabulated, stated or weak.")
@click.option("--runs", default=30, show_default=True, help="Recordings per noise level.")
@click.option("--seed", default=0, show_default=True, help="Seed of the noise.")
@click.option(
    "--methods", default="raw,filtered,spline", show_default=True,
    help="Methods, separated by commas; also spline-early (the transient dropped before smoothing), ml (maximum "
    "likelihood), any kind of smoother, and any kind of estimator, on the article's spline.",
)  # fmt: skip
@spread
@click.option("--out", type=DIRECTORY, help="Folder for report.html and study.parquet; a study in it is resumed.")
@click.option("--rerun", is_flag=True, help="Compute all runs anew, also those of an earlier study in the folder.")
@click.option("--json", "json_file", type=FILE, help="File for the sample means and variances.")
def reproduce(
    scenario: str,
    runs: int,
    seed: int,
    methods: str,
    spread: Spread,
    out: Path | None,
    rerun: bool,
    json_file: Path | None,
) -> None:
    """Run the article's study (sec. 3) again and print its tables 2-7 beside the published numbers and the bound."""
    from dynident.io.folder import result_folder
    from dynident.io.results import check_json, probe_folder, write_json
    from dynident.kernel import kernel
    from dynident.report import study_page, study_text

    if json_file:
        check_json(json_file)
        probe_folder(json_file.parent)
    names = [name.strip() for name in methods.split(",") if name.strip()]
    table = out / "study.parquet" if out else None
    with result_folder(out) if out else nullcontext() as folder:
        found = _study(spread, table, scenario=scenario, runs=runs, seed=seed, methods=names, rerun=rerun)
        written = folder.replace({"report.html": study_page(found)}) if folder else ()
    screen = console()
    screen.put(study_text(found))
    screen.remark(f"Computed by {kernel()}.")
    if json_file:
        write_json(json_file, found.summary())
    for path in written:
        tell(screen, "Report", path)


def _study(spread: Spread, table: Path | None, *, scenario: str, runs: int, rerun: bool, **how: Any) -> Reproduction:
    """Run the study; however it is stopped, what is said then is where the finished runs are."""
    from dynident.errors import InputError, Step
    from dynident.studies import article

    begun = False
    try:
        with status() as say, spread.executor(*PRELOADED) as executor:

            def progress(done: int, total: int) -> None:
                nonlocal begun
                begun = True
                say(Step(f"{scenario}, {runs} runs", done, total))

            return article.reproduce(
                scenario, runs, rerun=rerun, path=table, executor=executor, limits=spread.limits, progress=progress,
                **how,
            )  # fmt: skip
    except KeyboardInterrupt as stop:
        stop.add_note(_kept(table, rerun))
        raise
    except InputError as error:
        if not begun:
            raise
        kept = _kept(table, rerun)
        raise InputError(f"{error} {kept[0].upper()}{kept[1:]}") from error


def _kept(table: Path | None, rerun: bool) -> str:
    from dynident.io.row_store import parts_folder

    if table is None:
        return "no run is kept; give --out to keep them."
    place = next((one for one in (table, parts_folder(table)) if one.exists()), None)
    kept = f"finished runs are kept in {place}" if place else "no run is finished"
    return f"{kept}; run the same command again to {'begin anew' if rerun else 'go on'}."
