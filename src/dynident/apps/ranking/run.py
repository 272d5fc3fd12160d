"""Run a comparison: smoothers, then their combinations with estimators as jobs, and the ranking of their rows."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from dynident.apps.ranking.assemble import ComparisonRows, assemble_ranking, held_out_error
from dynident.apps.ranking.config import Candidate, estimator_candidates, smoother_candidates
from dynident.apps.ranking.differences import compute_truth, read_truth, truth_text
from dynident.apps.ranking.fit import Fit, Job
from dynident.apps.ranking.page import ranking_page
from dynident.apps.ranking.ranking import CombinationOutcome, Ranking
from dynident.apps.ranking.report import ranking_dict
from dynident.apps.ranking.task import (
    KEY,
    CommonSamples,
    Smoothing,
    Task,
    create_task,
    empty_row,
    find_common_samples,
    pack_masks,
    row_schema,
    unpack_masks,
)
from dynident.estimators import AugmentedKalman, Estimator, PhysicallyConsistent
from dynident.estimators.maximum_likelihood import MaximumLikelihood
from dynident.estimators.output_error import SimulatingEstimator
from dynident.files.folder import refuse_other_report, result_folder
from dynident.files.opener import refuse_inputs, watch_inputs
from dynident.files.results import as_path, json_text
from dynident.files.row_store import RowStore
from dynident.motion.smoothers import Smoother
from dynident.project.project import Project, read_project
from dynident.runtime import InputError, report_progress
from dynident.runtime.jobs import FAILURES, JobOptions, JobResult, Limits, Status

TABLE, NUMBERS, REPORT = "compare.parquet", "compare.json", "report.html"
FILES = (TABLE, NUMBERS, REPORT)
DEFAULT_FOLDS, MAX_FOLDS = 5, 100
Parts = tuple[tuple[Candidate, ...], tuple[Candidate, ...]]


def compare(
    config: str | Path,
    out: str | Path | None = None,
    *,
    smoothers: Sequence[str | Smoother] | None = None,
    estimators: Sequence[str | Estimator] | None = None,
    truth: str | Path | Mapping[str, float] | None = None,
    folds: int = DEFAULT_FOLDS,
    executor: Executor | None = None,
    limits: Limits | None = None,
    rerun: bool = False,
    rng: np.random.Generator | None = None,
) -> Ranking:
    """Try smoothers with estimators on the same logs, and rank them by the torque error on motion that was held out.

    ``config`` is a configuration; its own recipe chooses once what is the same for all: terms, time offset, tilt of the
    base, and which samples are fitted. ``smoothers`` and ``estimators`` are parts or kinds ("consistent+robust" makes
    one that is linear in the parameters consistent with physics), by default those of the section ``compare``, else
    all; those of the configuration are always among them. Without a held-out log the ranking is by cross-validation in
    so many ``folds`` (0: none). ``truth`` are true values of parameters by name, or a file of them: YAML, a robot file,
    or a result.

    The combinations are spread over ``executor``; ``limits`` hold for each of them. What fails is a row, and the rest
    goes on; what needs something that the logs lack is listed as not applicable. In the folder ``out`` are kept
    ``report.html``, ``compare.json`` and the table ``compare.parquet``: rows that are in it are not computed again,
    unless ``rerun`` or they failed. ``rng`` draws blocks of time, by default the same ones each time, to tell
    differences from chance.

    Raises ConfigError, ModelError and InputError where the configuration cannot be used or no smoother works.

    >>> import numpy as np
    >>> import dynident as dy
    >>> from pathlib import Path
    >>> from tempfile import TemporaryDirectory
    >>> t, rng = np.arange(1501) * 0.01, np.random.default_rng(0)
    >>> def recorded(w):  # 5 kg, 8 N s/m
    ...     x = np.sin(w * t) + 1e-4 * rng.standard_normal(len(t))
    ...     return np.column_stack([t, x, -5 * w**2 * np.sin(w * t) + 8 * w * np.cos(w * t)])
    >>> text = '''
    ... model: gallery:slider
    ... time: { column: t, unit: s }
    ... position: { slider: { column: x, unit: m } }
    ... torque: { slider: { column: f, unit: N } }
    ... train: [{ file: monday.csv }]
    ... validation: [{ file: tuesday.csv }]
    ... smoother: { kind: spline }
    ... '''
    >>> with TemporaryDirectory() as folder:
    ...     for day, w in (("monday", 3), ("tuesday", 4)):
    ...         file = Path(folder, f"{day}.csv")
    ...         np.savetxt(file, recorded(w), delimiter=",", header="t,x,f", comments="")
    ...     _ = Path(folder, "robot.yaml").write_text(text)
    ...     found = dy.compare(Path(folder, "robot.yaml"), smoothers=["difference"], estimators=["least_squares"])
    >>> for row in found.rows:
    ...     print(row.combination.name, row.is_worse)
    spline (rule constraint) / least_squares False
    difference / least_squares True
    """
    path, folder = as_path(config), None if out is None else as_path(out)
    if folds and not 2 <= folds <= MAX_FOLDS:
        raise InputError(f"folds = {folds}: give a number from 2 to {MAX_FOLDS}, or 0 for no cross-validation.")
    with watch_inputs(path):
        project = read_project(path)
        true_values = _read_true_values(project, truth)
        if folder is not None:
            refuse_inputs(*(folder / name for name in FILES))
            refuse_other_report(folder, NUMBERS)
        with nullcontext() if folder is None else result_folder(folder) as results_folder:
            task, parts = _prepare_task(project, true_values, folds, smoothers, estimators)
            table = None if folder is None else folder / TABLE
            rows = _compute_rows(task, parts, table, JobOptions(executor, limits), rerun=rerun)
            ranking = assemble_ranking(path.stem, task, rows, rng or np.random.default_rng(0))
            if results_folder is not None:
                report_progress("writing the report")
                results_folder.replace({NUMBERS: json_text(ranking_dict(ranking)), REPORT: ranking_page(ranking)})
    return ranking


def _read_true_values(project: Project, truth: str | Path | Mapping[str, float] | None) -> dict[str, float] | None:
    """Return the true values that are given, or that the configuration names; a file is read now."""
    section = project.config.compare
    if truth is not None:
        return read_truth(truth, Path(), project.config.model)
    if section is None or section.truth is None:
        return None
    return read_truth(section.truth, project.path.parent, project.config.model)


def _prepare_task(
    project: Project,
    truth: Mapping[str, float] | None,
    folds: int,
    smoothers: Sequence[str | Smoother] | None,
    estimators: Sequence[str | Estimator] | None,
) -> tuple[Task, Parts]:
    """Return the task, and the smoothers and estimators that are compared on it."""
    chosen_estimators = estimator_candidates(project.config, project.model, estimators)
    parts = smoother_candidates(project.config, smoothers), chosen_estimators
    task, identification = create_task(project, folds)
    if not task.held_out and not folds:
        raise InputError(
            f"{project.path}: no log is held out, and without cross-validation there is nothing to rank by; name one "
            "as `validation`, or give a number of folds."
        )
    if truth is not None:
        report_progress("computing the bound")
        task = replace(task, truth=compute_truth(truth, identification, task.logs.recorded["train"]))
    return task, parts


def _compute_rows(task: Task, parts: Parts, table: Path | None, options: JobOptions, *, rerun: bool) -> ComparisonRows:
    """Return the rows of all smoothers and combinations; those in the table are not computed again."""
    smoothers, estimators = parts
    with RowStore(table, row_schema(), KEY, rerun=rerun, retried={"status": FAILURES}) as store:
        # a row is known by the digest of all that it depends on, so that changed settings are computed anew
        digests = tuple(_text_digest(task.digest, smoother.settings) for smoother in smoothers)
        keys = [(smoother.name, "", digest) for smoother, digest in zip(smoothers, digests, strict=True)]
        smoothing, numbers = Smoothing(task, smoothers, digests), range(len(smoothers))
        key = keys.__getitem__

        def make_rows(result: JobResult[int, dict[str, Any]]) -> list[Mapping[str, Any]]:
            return [result.value or _unfinished_row(key(result.job), result)]

        store.fill(smoothing, numbers, key, make_rows, options, "smoothing by each method")
        # the rows of all smoothers are needed first: only samples that all of them keep are compared
        smoother_rows = _rows_by_key(store, keys)
        fit = Fit(task, _common_samples(task, smoothers, smoother_rows), smoothers, estimators)
        rows, computed = _fit_rows(store, fit, _fit_jobs(fit, smoother_rows), options)
        # the best one must stand in cross-validation, whatever that takes
        best = min(rows, key=lambda job: held_out_error(task, fit.common, rows[job]), default=None)
        if best is not None and not best.cross_validate:
            complete_job = replace(best, digest=_text_digest(best.digest, "cross-validated"), cross_validate=True)
            best_row, added = _fit_rows(store, fit, [complete_job], options)
            rows, computed = rows | {best: best_row[complete_job]}, computed + added
    fits = {(job.smoother, job.estimator): row for job, row in rows.items()}
    return ComparisonRows(smoothers, estimators, smoother_rows, fits, fit.common, computed)


def _fit_rows(
    store: RowStore, fit: Fit, jobs: Sequence[Job], options: JobOptions
) -> tuple[dict[Job, Mapping[str, Any]], int]:
    """Return the rows of jobs, and how many of them were computed now."""
    missing = [job for job in jobs if fit.key(job) not in store]
    # estimators that begin with the same rows of a smoother come together, unless limits hold for each of them
    groups: dict[Any, tuple[Job, ...]] = {}
    for job in missing:
        part = fit.estimators[job.estimator].part
        linear = part.linear if isinstance(part, PhysicallyConsistent) else part
        group = job if options.limits not in (None, Limits()) else (job.smoother, repr(linear))
        groups[group] = (*groups.get(group, ()), job)
    store.fill(fit, groups.values(), lambda group: fit.key(group[0]), partial(_group_rows, fit), options, "estimating")
    return dict(zip(jobs, _rows_by_key(store, [fit.key(job) for job in jobs]), strict=True)), len(missing)


def _fit_jobs(fit: Fit, smoother_rows: Sequence[Mapping[str, Any]]) -> list[Job]:
    """Return all combinations whose smoother takes part."""
    task, common = fit.task, fit.common
    base = _text_digest(task.digest, truth_text(task.truth), pack_masks(common.masks).hex())
    return [
        Job(
            i,
            j,
            int(row["chosen"]),
            tuple(row["shift"]),
            _text_digest(base, smoother.settings, estimator.settings),
            cross_validate=not (task.held_out and _iterates(estimator.part)),
        )
        for i, (smoother, row) in enumerate(zip(fit.smoothers, smoother_rows, strict=True))
        if row["status"] == CombinationOutcome.OK and smoother.name not in common.excluded
        for j, estimator in enumerate(fit.estimators)
    ]


def _iterates(estimator: Estimator) -> bool:
    """Return whether an estimator simulates, or passes over all samples many times: each fold takes as long as a
    fit."""
    linear = estimator.fit if isinstance(estimator, PhysicallyConsistent) else estimator
    return isinstance(linear, SimulatingEstimator | AugmentedKalman | MaximumLikelihood)


def _group_rows(fit: Fit, result: JobResult[tuple[Job, ...], list[dict[str, Any]]]) -> Sequence[Mapping[str, Any]]:
    """Return the rows of a group, which has no value where its worker could not go on."""
    return [_unfinished_row(fit.key(job), result) for job in result.job] if result.value is None else result.value


def _unfinished_row(key: tuple[str, str, str], result: JobResult[Any, Any]) -> dict[str, Any]:
    status = Status.FAILED if result.status is Status.OK else result.status
    return empty_row(key, CombinationOutcome(status.value), result.reason, result.seconds)


def _rows_by_key(store: RowStore, keys: Sequence[tuple[str, str, str]]) -> list[Mapping[str, Any]]:
    import polars as pl

    key_table = pl.DataFrame(keys, schema=dict.fromkeys(KEY, pl.String), orient="row")
    rows = {tuple(row[name] for name in KEY): row for row in store.table(key_table).iter_rows(named=True)}
    return [rows[key] for key in keys]


def _common_samples(task: Task, smoothers: Sequence[Candidate], rows: Sequence[Mapping[str, Any]]) -> CommonSamples:
    working = [pair for pair in zip(smoothers, rows, strict=True) if pair[1]["status"] == CombinationOutcome.OK]
    masks = {smoother.name: unpack_masks(row["masks"], task.motions) for smoother, row in working}
    if not masks:
        reasons = "; ".join(f"{row['smoother']}: {row['reason']}" for row in rows)
        raise InputError(f"no smoother works on these logs: {reasons.rstrip('.')}.")
    return find_common_samples(task, masks)


def _text_digest(*texts: str) -> str:
    return sha256("\n".join(texts).encode()).hexdigest()[:16]
