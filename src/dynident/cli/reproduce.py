"""``dynident reproduce``: run the article's study again."""

from __future__ import annotations

import signal
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dynident.cli.terminal import DIRECTORY, FILE, bar, console, one_line, tell

if TYPE_CHECKING:
    from concurrent.futures import Executor

__all__ = ["reproduce"]


@click.command(short_help="Run the article's study again.")
@click.option("--scenario", default="tabulated", show_default=True, help="tabulated, stated or weak.")
@click.option("--runs", default=30, show_default=True, help="Recordings per noise level.")
@click.option("--seed", default=0, show_default=True, help="Seed of the noise.")
@click.option(
    "--methods", default="raw,filtered,spline", show_default=True,
    help="Methods, separated by commas; also spline-early (the transient dropped before smoothing) and ml (maximum "
    "likelihood).",
)  # fmt: skip
@click.option("--workers", default=1, show_default=True, type=click.IntRange(1), help="Number of worker processes.")
@click.option("--out", type=DIRECTORY, help="Folder for report.html and study.parquet; a study in it is resumed.")
@click.option("--json", "json_file", type=FILE, help="File for the sample means and variances.")
def reproduce(
    scenario: str, runs: int, seed: int, methods: str, workers: int, out: Path | None, json_file: Path | None
) -> None:
    """Run the article's study (sec. 3) again and print its tables 2-7 beside the published numbers and the bound."""
    from dynident.io.results import check_json, probe_folder, write_json, write_text
    from dynident.report import study_page, study_text
    from dynident.studies import article

    if json_file:
        check_json(json_file)
    for folder in filter(None, (out, json_file and json_file.parent)):
        probe_folder(folder)
    names = [name.strip() for name in methods.split(",") if name.strip()]
    table = out / "study.parquet" if out else None
    try:
        with bar(f"{scenario}, {runs} runs") as progress, _pool(workers) as executor:
            found = article.reproduce(scenario, runs, seed, names, path=table, executor=executor, progress=progress)
    except KeyboardInterrupt:
        if table:
            click.echo(
                one_line(f"Finished runs are kept in {table}: run the same command again to continue."), err=True
            )
        raise
    screen = console()
    screen.print(study_text(found))
    page = study_page(found) if out else ""
    if json_file:
        write_json(json_file, found.summary())
    if out:
        tell(screen, "Report", write_text(out / "report.html", page))


def _pool(workers: int) -> AbstractContextManager[Executor | None]:
    """Return the processes to work in; None where this one does it alone."""
    if workers == 1:
        return nullcontext()
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import get_context

    # an interrupt is for this process, which tells the others
    return ProcessPoolExecutor(workers, get_context("spawn"), signal.signal, (signal.SIGINT, signal.SIG_IGN))
