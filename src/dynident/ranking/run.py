"""Runs a comparison: smoothers, then their combinations with estimators as jobs, and what their rows say together."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import nullcontext
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from dynident.errors import InputError, Step
from dynident.estimators import Estimator
from dynident.io.folder import refuse_other_report, result_folder
from dynident.io.opener import refuse_inputs, watched
from dynident.io.project import Project, read_project
from dynident.io.results import as_path
from dynident.io.row_store import RowStore
from dynident.jobs import Done, Limits, Status, run_jobs
from dynident.ranking.assemble import Rows, assembled
from dynident.ranking.candidates import Candidate, estimators_of, smoothers_of
from dynident.ranking.fit import Fit, Job
from dynident.ranking.ranking import Ranking
from dynident.ranking.rows import KEY, NONE, Outcome, empty_row, masks_of, packed_masks, schema
from dynident.ranking.smoothing import Common, Smoothing, common_of
from dynident.ranking.task import Task, task_of
from dynident.ranking.truth import digest_text, read_truth, truth_of
from dynident.smoothers import Smoother

__all__ = ["FILES", "NUMBERS", "REPORT", "TABLE", "run_comparison"]

TABLE, NUMBERS, REPORT = "compare.parquet", "compare.json", "report.html"
FILES = (TABLE, NUMBERS, REPORT)
FOLDS, MOST = 5, 100
Progress = Callable[[str], None]
Files = Callable[[Ranking], Mapping[str, str]]


def run_comparison(
    config: str | Path,
    out: str | Path | None = None,
    *,
    smoothers: Sequence[str | Smoother] | None = None,
    estimators: Sequence[str | Estimator] | None = None,
    truth: str | Path | Mapping[str, float] | None = None,
    folds: int = FOLDS,
    files: Files | None = None,
    executor: Executor | None = None,
    limits: Limits | None = None,
    rerun: bool = False,
    rng: np.random.Generator | None = None,
    progress: Progress | None = None,
) -> Ranking:
    """Do what ``dynident.compare`` says; ``files`` gives the texts by name that are written beside the table."""
    path, folder, say = as_path(config), None if out is None else as_path(out), progress or (lambda _: None)
    if folds and not 2 <= folds <= MOST:
        raise InputError(f"folds = {folds}: give a number from 2 to {MOST}, or 0 for no cross-validation.")
    with watched(path):
        project = read_project(path, say)
        given = _truth(project, truth)
        if folder is not None:
            refuse_inputs(*(folder / name for name in FILES))
            refuse_other_report(folder, NUMBERS)
        with nullcontext() if folder is None else result_folder(folder) as place:
            task, parts = _prepared(project, given, folds, smoothers, estimators, say)
            table = None if folder is None else folder / TABLE
            rows = _rows(task, parts, table, executor, limits, rerun, say)
            found = assembled(path.stem, task, rows, rng or np.random.default_rng(0))
            if place is not None and files is not None:
                say("writing the report")
                place.replace(files(found))
    return found


Parts = tuple[tuple[Candidate, ...], tuple[Candidate, ...]]


def _truth(project: Project, truth: str | Path | Mapping[str, float] | None) -> dict[str, float] | None:
    """Return the true values that are given, or that the configuration names; a file is read now."""
    section = project.config.compare
    if truth is not None:
        return read_truth(truth, Path(), project.config.model)
    if section is None or section.truth is None:
        return None
    return read_truth(section.truth, project.path.parent, project.config.model)


def _prepared(
    project: Project,
    truth: Mapping[str, float] | None,
    folds: int,
    smoothers: Sequence[str | Smoother] | None,
    estimators: Sequence[str | Estimator] | None,
    say: Progress,
) -> tuple[Task, Parts]:
    """Return the task, and the smoothers and estimators that are compared on it."""
    parts = (smoothers_of(project.config, smoothers), estimators_of(project.config, project.model, estimators))
    task, found = task_of(project, folds, None, say)
    if not task.held_out and not folds:
        raise InputError(
            f"{project.path}: no log is held out, and without cross-validation there is nothing to rank by; name one "
            "as `validation`, or give a number of folds."
        )
    if truth is not None:
        say("computing the bound")
        task = replace(task, truth=truth_of(truth, found, task.logs.recorded["train"]))
    return task, parts


def _rows(
    task: Task,
    parts: Parts,
    table: Path | None,
    executor: Executor | None,
    limits: Limits | None,
    rerun: bool,
    say: Progress,
) -> Rows:
    """Return the rows of all smoothers and combinations; those that are in the table are not computed again."""
    smoothers, estimators = parts
    again = {"status": [one.value for one in NONE]}
    with RowStore(table, schema(), KEY, rerun=rerun, again=again) as store:
        try:
            digests = tuple(_digest(task.digest, one.settings) for one in smoothers)
            smoothing = Smoothing(task, smoothers, digests)
            keys = [(one.name, "", digest) for one, digest in zip(smoothers, digests, strict=True)]
            todo = [k for k, key in enumerate(keys) if key not in store]
            say(Step("smoothing by each method", 0, len(todo)))
            for count, done in enumerate(run_jobs(smoothing, todo, executor, limits=limits), 1):
                store.add([_row(done, keys[done.job])])
                say(Step("smoothing by each method", count, len(todo)))
            smooth = _by_key(store, keys)
            common = _common(task, smoothers, smooth)
            computed, fits = _fitted(task, parts, smooth, common, store, executor, limits, say)
        except KeyboardInterrupt as stop:
            stop.add_note(_left(table))
            raise
        except InputError as error:
            raise InputError(f"{error} {_left(table)}") from error
    return Rows(smoothers, estimators, smooth, fits, common, computed)


def _fitted(
    task: Task,
    parts: Parts,
    smooth: Sequence[Mapping[str, Any]],
    common: Common,
    store: RowStore,
    executor: Executor | None,
    limits: Limits | None,
    say: Progress,
) -> tuple[int, dict[tuple[int, int], Mapping[str, Any]]]:
    """Return how many rows are new, and the rows of all combinations whose smoother takes part, by number."""
    smoothers, estimators = parts
    fit = Fit(task, common, smoothers, estimators)
    base = _digest(task.digest, digest_text(task.truth), packed_masks(common.masks).hex())
    jobs = [
        Job(i, j, int(row["chosen"]), tuple(row["shift"]), _digest(base, one.settings, estimator.settings))
        for i, (one, row) in enumerate(zip(smoothers, smooth, strict=True))
        if row["status"] == Outcome.OK and one.name not in common.apart
        for j, estimator in enumerate(estimators)
    ]
    todo = [job for job in jobs if fit.key(job) not in store]
    say(Step("estimating", 0, len(todo)))
    for count, done in enumerate(run_jobs(fit, todo, executor, limits=limits), 1):
        store.add([_row(done, fit.key(done.job))])
        say(Step("estimating", count, len(todo)))
    rows = _by_key(store, [fit.key(job) for job in jobs])
    return len(todo), {(job.smoother, job.estimator): row for job, row in zip(jobs, rows, strict=True)}


def _row(done: Done[Any, dict[str, Any]], key: tuple[str, str, str]) -> Mapping[str, Any]:
    if done.value is not None:
        return done.value
    status = Outcome(done.status.value) if done.status is not Status.OK else Outcome.FAILED
    return empty_row(key, status, done.reason, done.seconds)


def _by_key(store: RowStore, keys: Sequence[tuple[str, str, str]]) -> list[Mapping[str, Any]]:
    import polars as pl

    wanted = pl.DataFrame(keys, schema=dict.fromkeys(KEY, pl.String), orient="row")
    found = {tuple(row[name] for name in KEY): row for row in store.table(wanted).iter_rows(named=True)}
    return [found[key] for key in keys]


def _common(task: Task, smoothers: Sequence[Candidate], rows: Sequence[Mapping[str, Any]]) -> Common:
    pairs = zip(smoothers, rows, strict=True)
    masks = {one.name: masks_of(row["masks"], task.motions) for one, row in pairs if row["status"] == Outcome.OK}
    if not masks:
        reasons = "; ".join(f"{row['smoother']}: {row['reason']}" for row in rows)
        raise InputError(f"no smoother works on these logs: {reasons.rstrip('.')}.")
    return common_of(task, masks)


def _digest(*texts: str) -> str:
    return sha256("\n".join(texts).encode()).hexdigest()[:16]


def _left(table: Path | None) -> str:
    if table is None:
        return "No row is kept; name a folder for the results to keep them."
    return f"Finished rows are kept in {table}; run the same command again to go on."
