"""``dynident reproduce``: run the article's study again."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Collection, Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dynident.cli.options import DIRECTORY, FILE
from dynident.cli.terminal import console, status, tell
from dynident.cli.workers import Spread, spread

if TYPE_CHECKING:
    from concurrent.futures import Executor
    from multiprocessing.context import BaseContext
    from multiprocessing.process import BaseProcess

    from dynident.log import Motion
    from dynident.studies.article import ArmScenario, Reproduction

__all__ = ["reproduce"]

STOPPING = (signal.SIGINT, signal.SIGTERM)
GRACE = 2.0  # s for workers to end their fits when a study is stopped


@click.command(short_help="Run the article's study again.")
@click.option("--scenario", default="tabulated", show_default=True, help="tabulated, stated or weak.")
@click.option("--runs", default=30, show_default=True, help="Recordings per noise level.")
@click.option("--seed", default=0, show_default=True, help="Seed of the noise.")
@click.option(
    "--methods", default="raw,filtered,spline", show_default=True,
    help="Methods, separated by commas; also spline-early (the transient dropped before smoothing) and ml (maximum "
    "likelihood).",
)  # fmt: skip
@spread
@click.option("--out", type=DIRECTORY, help="Folder for report.html and study.parquet; a study in it is resumed.")
@click.option("--json", "json_file", type=FILE, help="File for the sample means and variances.")
def reproduce(
    scenario: str, runs: int, seed: int, methods: str, spread: Spread, out: Path | None, json_file: Path | None
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
        found = _study(scenario, runs, seed, names, spread, table)
        written = folder.replace({"report.html": study_page(found)}) if folder else ()
    screen = console()
    screen.put(study_text(found))
    screen.remark(f"Computed by {kernel()}.")
    if json_file:
        write_json(json_file, found.summary())
    for path in written:
        tell(screen, "Report", path)


def _study(scenario: str, runs: int, seed: int, methods: list[str], spread: Spread, table: Path | None) -> Reproduction:
    """Run the study; however it is stopped, what is said then is where the finished runs are."""
    from concurrent.futures import BrokenExecutor

    from dynident.errors import InputError, Step
    from dynident.studies import article

    try:
        pool = spread.executor() if spread.cluster else _pool(spread.workers, scenario)
        with status() as say, pool as executor:

            def progress(done: int, total: int) -> None:
                say(Step(f"{scenario}, {runs} runs", done, total))

            return article.reproduce(scenario, runs, seed, methods, path=table, executor=executor, progress=progress)
    except KeyboardInterrupt as stop:
        stop.add_note(_kept(table))
        raise
    except BrokenExecutor as error:
        raise InputError(
            f"a worker process has died, perhaps for want of memory; {_kept(table)} Take fewer --workers."
        ) from error


def _kept(table: Path | None) -> str:
    if table is None:
        return "no run is kept; give --out to keep them."
    kept = f"finished runs are kept in {table}" if table.exists() else "no run is finished"
    return f"{kept}; run the same command again to go on."


@contextmanager
def _pool(workers: int, scenario: str) -> Iterator[Executor | None]:
    """Give the processes to work in, which end with this one, however it ends; None where this one does it alone.

    Where the system can, they are forked from a server that has imported and compiled what all need, while this process
    simulates the motion that all get.
    """
    if workers == 1:
        yield None
        return
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import active_children, get_all_start_methods, get_context

    others = active_children()
    context: BaseContext = get_context("spawn")
    if "forkserver" in get_all_start_methods():
        from multiprocessing import forkserver, resource_tracker

        resource_tracker.ensure_running()  # or the server would start it, which lets signals through
        context = get_context("forkserver")
        forkserver.set_forkserver_preload(["dynident.studies.warm", "dynident.studies.article"])
        with _held_back():
            forkserver.ensure_running()
    with ProcessPoolExecutor(workers, context, _follow, _shared(scenario)) as executor:
        try:
            with _held_back():
                for _ in range(workers):
                    executor.submit(int)  # starts a worker
            yield executor
        except BaseException:
            executor.shutdown(wait=False, cancel_futures=True)
            _end(set(active_children()) - set(others))
            raise


def _shared(scenario: str) -> tuple[ArmScenario, Motion] | tuple[()]:
    """Return a scenario and its motion; nothing where there is none of the name, which is said later."""
    from dynident.studies.article import SCENARIOS

    return (chosen, chosen.truth()) if (chosen := SCENARIOS.get(scenario)) else ()


def _end(workers: Collection[BaseProcess]) -> None:
    """Wait a little for processes to end, then end them: they have nothing to save."""
    end = time.monotonic() + GRACE
    try:
        for worker in workers:
            worker.join(max(0.0, end - time.monotonic()))
    finally:
        for worker in workers:
            worker.kill()


@contextmanager
def _held_back() -> Iterator[None]:
    """Hold signals back, in processes that are started meanwhile for good: Ctrl-C in a terminal goes to all of them."""
    if not hasattr(signal, "pthread_sigmask"):  # on Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, STOPPING)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _follow(scenario: ArmScenario | None = None, truth: Motion | None = None) -> None:
    """Prepare a worker: signals are for the process that started it, which tells the others, or takes them with it.

    The motion of the scenario is known.
    """
    from multiprocessing import parent_process
    from threading import Thread

    for number in STOPPING:
        signal.signal(number, signal.SIG_IGN)

    def watch() -> None:
        if parent := parent_process():
            parent.join()
        os._exit(1)

    Thread(target=watch, daemon=True).start()
    if scenario is not None and truth is not None:
        scenario.remember(truth)
