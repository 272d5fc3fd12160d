"""Monte Carlo studies: scenario x method x noise level x run, with one row per fit; can be resumed."""

from __future__ import annotations

import struct
import time
from array import array
from collections.abc import Callable, Container, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing, contextmanager
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from dynident.estimators import Estimate
from dynident.files.row_store import RowStore
from dynident.models.simulation import Recording
from dynident.motion.splines import NORMAL_95
from dynident.regression import one_thread
from dynident.runtime import InputError
from dynident.runtime.arrays import Array
from dynident.runtime.jobs import FAILURES, JobResult, Limits, Status, run_jobs
from dynident.runtime.jobs.cluster import code_version

if TYPE_CHECKING:
    import polars as pl

KEY = ("scenario", "method", "level", "run", "seed", "version")
NOTHING: dict[str, list[float]] = {"value": [], "std": [], "interval": []}  # of a fit that failed


class FitOutcome(StrEnum):
    """Outcome of a fit: without notes, with notes, not converged, or none.

    There is none where it raised an error, exceeded its limit of time or memory, or its process died.
    """

    OK = "ok"
    NOTED = "noted"
    UNSETTLED = "unsettled"
    FAILED = Status.FAILED.value
    TIMED_OUT = Status.TIMED_OUT.value
    OUT_OF_MEMORY = Status.OUT_OF_MEMORY.value
    DIED = Status.DIED.value


@contextmanager
def study_table(path: str | Path | None, *, rerun: bool = False) -> Iterator[RowStore]:
    """Open the rows of a study: those in the table at ``path``, if given, which holds all of them in the end.

    Failed fits are not read from it; with ``rerun`` no row is. Raises InputError where a file is not that of a
    study, or another run works on it.
    """
    with RowStore(path, _schema(), KEY, rerun=rerun, retried={"status": FAILURES}) as rows:
        statuses = rows.scan().select("status").unique().collect()["status"].to_list()
        if wrong := [repr(status) for status in statuses if status not in set(FitOutcome)]:
            raise InputError(f"{path}: is not a table of a study: {min(wrong)} is no status of a fit; choose another.")
        yield rows


def key_type() -> dict[str, Any]:
    """Return the types of the columns that identify a fit."""
    return {name: kind for name, kind in _schema().items() if name in KEY}


def _schema() -> dict[str, pl.DataType | type[pl.DataType]]:
    import polars as pl

    return {
        "scenario": pl.String, "method": pl.String, "level": pl.Float64, "run": pl.Int64, "seed": pl.Int64,
        "version": pl.String, "status": pl.String, "reason": pl.String, "seconds": pl.Float64,
        "value": pl.List(pl.Float64), "std": pl.List(pl.Float64), "interval": pl.List(pl.Float64),
    }  # fmt: skip


class Scenario(Protocol):
    """A simulated experiment: frozen and picklable."""

    @property
    def name(self) -> str:
        """A short name, the scenario's key in the table."""

    def record(self, level: float, rng: np.random.Generator) -> Recording:
        """Return one noisy recording at a noise level."""


class Method(Protocol):
    """An identification method: frozen and picklable."""

    @property
    def name(self) -> str:
        """A short name, the method's key in the table."""

    def estimate(self, recording: Recording) -> Estimate:
        """Estimate the parameters from the recording's log."""


class _RecordingJob(NamedTuple):
    """Methods, by their names, to be run on one recording, so that all see the same noise."""

    scenario: str
    methods: tuple[str, ...]
    level: float
    run: int


@dataclass(frozen=True)
class _FitRunner:
    """Makes the rows of a job; sent to each worker once."""

    scenarios: Mapping[str, Scenario]
    methods: Mapping[str, Method]
    seed: int
    version: str

    def __call__(self, job: _RecordingJob) -> list[dict[str, Any]]:
        # all methods of a job see the same recording
        record = self.scenarios[job.scenario].record(job.level, generator(self.seed, job.level, job.run))
        with one_thread():
            return [self.key(job, name) | _fit_row(self.methods[name], record) for name in job.methods]

    def key(self, job: _RecordingJob, method: str) -> dict[str, Any]:
        """Return the key that identifies a fit."""
        return dict(zip(KEY, (job.scenario, method, job.level, job.run, self.seed, self.version), strict=True))

    def failed_rows(self, finished_job: JobResult[_RecordingJob, list[dict[str, Any]]]) -> list[dict[str, Any]]:
        """Return the rows of a job that gave no result."""
        outcome = {
            "status": finished_job.status.value, "reason": finished_job.reason, "seconds": finished_job.seconds
        }  # fmt: skip
        return [self.key(finished_job.job, name) | outcome | NOTHING for name in finished_job.job.methods]


def _fit_row(method: Method, record: Recording) -> dict[str, Any]:
    began, numbers = time.perf_counter(), NOTHING
    try:
        estimate = method.estimate(record)
        interval = [] if estimate.interval is None else estimate.interval.ravel().tolist()
        numbers = {"value": estimate.value.tolist(), "std": estimate.std.tolist(), "interval": interval}
        outcome = FitOutcome.NOTED if estimate.notes else FitOutcome.OK
        outcome = outcome if estimate.converged else FitOutcome.UNSETTLED
        reason = ", ".join(type(note).__name__ for note in estimate.notes)
    except MemoryError:  # the job as a whole has too little
        raise
    except Exception as error:  # a failed fit is a row, whatever the exception
        outcome, reason = FitOutcome.FAILED, f"{type(error).__name__}: {error}"
    return {"status": outcome.value, "reason": reason, "seconds": time.perf_counter() - began} | numbers


def generator(seed: int, level: float, run: int) -> np.random.Generator:
    """Return the random generator of one recording.

    It depends on these three only, not on the worker or the order of runs.
    """
    words = struct.unpack("<2I", struct.pack("<d", level))
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(*words, run)))


def run_study(
    scenarios: Sequence[Scenario],
    methods: Sequence[Method],
    levels: Sequence[float],
    runs: int,
    seed: int = 0,
    *,
    path: str | Path | None = None,
    executor: Executor | None = None,
    rerun: bool = False,
    limits: Limits | None = None,
    progress: Callable[[int, int], None] = lambda completed, total: None,  # noqa: ARG005
) -> pl.DataFrame:
    """Run every method on ``runs`` recordings of every scenario at every noise level.

    Returns a table with one row per fit: scenario, method, level, run, seed, version, status (a ``FitOutcome``),
    reason (of a failure, else the types of the notes), seconds, value, std and interval (lists, empty where the
    fit failed; the ends of 95 % intervals, lower and upper in turn, where they are known), sorted by these.

    With ``path`` the table is kept there (Parquet), and grows in parts beside it (``RowStore``): an interrupted
    study continues where it stopped. Failed fits and those of another version of dynident's code are computed
    again, with ``rerun`` all are. With ``executor`` the recordings are spread over its workers; the numbers do
    not depend on it. ``limits`` hold for one job: one fit, or those on one recording. ``progress`` is called with
    the number of finished fits and their total.
    """
    if runs < 1:
        raise InputError(f"runs is {runs}; a study needs at least 1.")
    fits = _FitRunner(
        {entry.name: entry for entry in scenarios}, {entry.name: entry for entry in methods}, seed, code_version()
    )
    with study_table(path, rerun=rerun) as store:
        pending = _PendingJobs(fits, tuple(dict.fromkeys(map(float, levels))), runs, store)
        total = len(pending.keys())
        count = total - sum(pending.sizes)
        progress(count, total)
        with closing(_run_rows(fits, pending, executor, limits)) as job_rows:
            for rows in job_rows:
                store.add(rows)
                count += len(rows)
                progress(count, total)
    return _sort_rows(store.table(pending.keys()), fits)


@dataclass(frozen=True, eq=False)
class _PendingJobs:
    """The jobs of a study whose rows are not among the ``stored_keys``."""

    fits: _FitRunner
    levels: tuple[float, ...]
    runs: int
    stored_keys: Container[tuple[Any, ...]]

    @cached_property
    def sizes(self) -> array[int]:
        """The number of fits of each job, as counted before the first has ended."""
        return array("I", (len(job.methods) for job in self))

    def __len__(self) -> int:
        return len(self.sizes)

    def __iter__(self) -> Iterator[_RecordingJob]:
        # only methods without a stored row are run again, on the same recording
        for scenario, level, run in product(self.fits.scenarios, self.levels, range(self.runs)):
            job = _RecordingJob(scenario, tuple(self.fits.methods), level, run)
            if missing_methods := tuple(
                name for name in job.methods if tuple(self.fits.key(job, name).values()) not in self.stored_keys
            ):
                yield job._replace(methods=missing_methods)

    def keys(self) -> pl.DataFrame:
        """Return the keys of all fits."""
        import polars as pl

        kinds, fits = key_type(), self.fits
        table = pl.DataFrame({"seed": [fits.seed], "version": [fits.version]}, schema_overrides=kinds)
        axes = {"scenario": fits.scenarios, "method": fits.methods, "level": self.levels, "run": range(self.runs)}
        for name, values in axes.items():
            table = table.join(pl.DataFrame({name: list(values)}, schema_overrides=kinds), how="cross")
        return table


def _run_rows(
    fits: _FitRunner, jobs: Iterable[_RecordingJob], executor: Executor | None, limits: Limits | None
) -> Generator[list[dict[str, Any]], None, None]:
    """Yield the rows of each job; where a job of several methods failed as a whole, each of them is tried alone."""
    alone: list[_RecordingJob] = []
    for finished_job in run_jobs(fits, jobs, executor, limits=limits):
        if finished_job.value is not None:
            yield finished_job.value
        elif len(finished_job.job.methods) == 1:
            yield fits.failed_rows(finished_job)
        else:
            # one method may have ended the process of all: run each alone, so that only that one fails
            alone += [finished_job.job._replace(methods=(name,)) for name in finished_job.job.methods]
    if alone:
        yield from _run_rows(fits, alone, executor, limits)


def _sort_rows(table: pl.DataFrame, fits: _FitRunner) -> pl.DataFrame:
    import polars as pl

    order = {name: k for k, name in enumerate(fits.methods)}
    return table.sort("scenario", "level", pl.col("method").replace_strict(order, return_dtype=pl.Int64), "run")


@dataclass(frozen=True, eq=False)
class Statistics:
    """Sample ``mean`` and ``variance`` (p), eqs. (54)-(55), of the ``estimates`` (runs, p) of one case.

    Failed fits are counted in ``failed`` and left out; nan where too few are left. ``interval`` (runs, p, 2) are
    the ends of the 95 % intervals, two standard errors where the estimator gives no other; ``unsettled`` counts
    the fits that did not converge.
    """

    mean: Array
    variance: Array
    estimates: Array
    failed: int
    interval: Array
    unsettled: int = 0

    def covered_share(self, true: Array) -> Array:
        """Return the share (p) of the intervals that contain the true values (p); nan where there are none."""
        inside = (self.interval[:, :, 0] <= true) & (true <= self.interval[:, :, 1])
        return np.asarray(inside.mean(axis=0) if len(inside) else np.full(self.interval.shape[1], np.nan))


def statistics(table: pl.DataFrame, parameters: int) -> Statistics:
    """Return the sample mean and variance over the rows of a table."""
    import polars as pl

    successful = table.filter(pl.col("value").list.len() > 0)
    value, std = _list_column(successful, "value", parameters), _list_column(successful, "std", parameters)
    given_interval = _list_column(successful, "interval", 2 * parameters).reshape(-1, parameters, 2)
    normal_interval = np.stack([value - NORMAL_95 * std, value + NORMAL_95 * std], axis=2)
    not_available = np.full(parameters, np.nan)
    return Statistics(
        mean=value.mean(axis=0) if len(successful) else not_available,
        variance=value.var(axis=0, ddof=1) if len(successful) > 1 else not_available,
        estimates=value,
        failed=len(table) - len(successful),
        interval=np.where(_has_values(successful, "interval")[:, None, None], given_interval, normal_interval),
        unsettled=int((successful["status"] == FitOutcome.UNSETTLED).sum()) if "status" in table.columns else 0,
    )


def _list_column(table: pl.DataFrame, name: str, size: int) -> Array:
    """Return a column of lists as an array (rows, size), nan where a list is empty."""
    numbers = np.full((len(table), size), np.nan)
    if (present := _has_values(table, name)).any():
        lists = table[name].filter(present)
        if wrong := set(lists.list.len()) - {size}:
            words = f"lists of {min(wrong)} numbers in the column {name!r}, not of {size}"
            raise InputError(f"the table of the study has {words}; delete it and run again.")
        numbers[present] = lists.explode().to_numpy().reshape(-1, size)
    return numbers


def _has_values(table: pl.DataFrame, name: str) -> NDArray[np.bool_]:
    """Return for each row whether its list in a column is not empty."""
    if name not in table.columns:
        return np.zeros(len(table), bool)
    return np.asarray(table[name].list.len().fill_null(0).to_numpy() > 0)
