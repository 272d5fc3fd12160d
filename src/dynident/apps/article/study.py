"""Monte Carlo studies: scenario x method x noise level x run, with one row per fit; can be resumed."""

from __future__ import annotations

import struct
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from dynident.estimators import Estimate
from dynident.files.row_store import RowStore
from dynident.models.simulation import Recording
from dynident.motion.splines import NORMAL_95
from dynident.regression import one_thread
from dynident.runtime import InputError
from dynident.runtime.arrays import Array
from dynident.runtime.jobs import FAILURES, JobOptions, JobResult, Limits, Status
from dynident.runtime.jobs.cluster import code_version

if TYPE_CHECKING:
    import polars as pl

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


class FitJob(NamedTuple):
    """One fit, by what tells it from all others: the key of its row."""

    scenario: str
    method: str
    level: float
    run: int
    seed: int
    version: str


KEY = FitJob._fields


@dataclass(frozen=True)
class _FitRunner:
    """Makes the row of a fit; sent to each worker once."""

    scenarios: Mapping[str, Scenario]
    methods: Mapping[str, Method]

    def __call__(self, job: FitJob) -> dict[str, Any]:
        with one_thread():
            return job._asdict() | self._fit_columns(job)

    def _fit_columns(self, job: FitJob) -> dict[str, Any]:
        began, numbers = time.perf_counter(), NOTHING
        try:
            scenario: Any = self.scenarios[job.scenario]
            recording = _recording(scenario, job.level, job.run, job.seed)
            began = time.perf_counter()
            estimate = self.methods[job.method].estimate(recording)
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


@lru_cache(maxsize=1)
def _recording(scenario: Scenario, level: float, run: int, seed: int) -> Recording:
    """Return a recording, which all methods see; jobs of one follow each other, so that it is mostly made once."""
    return scenario.record(level, generator(seed, level, run))


def _row(result: JobResult[FitJob, dict[str, Any]]) -> Mapping[str, Any]:
    if result.value is not None:
        return result.value
    outcome = {"status": result.status.value, "reason": result.reason, "seconds": result.seconds}
    return result.job._asdict() | outcome | NOTHING


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
) -> pl.DataFrame:
    """Run every method on ``runs`` recordings of every scenario at every noise level.

    Returns a table with one row per fit: scenario, method, level, run, seed, version, status (a ``FitOutcome``),
    reason (of a failure, else the types of the notes), seconds, value, std and interval (lists, empty where the
    fit failed; the ends of 95 % intervals, lower and upper in turn, where they are known), sorted by these.

    With ``path`` the table is kept there (Parquet), and grows in parts beside it (``RowStore``): an interrupted
    study continues where it stopped. Failed fits and those of another version of dynident's code are computed
    again, with ``rerun`` all are. With ``executor`` the fits are spread over its workers; the numbers do not depend
    on it. ``limits`` hold for one fit.
    """
    import polars as pl

    if runs < 1:
        raise InputError(f"runs is {runs}; a study needs at least 1.")
    fits = _FitRunner({entry.name: entry for entry in scenarios}, {entry.name: entry for entry in methods})
    keys = product(fits.scenarios, dict.fromkeys(map(float, levels)), range(runs), fits.methods)
    version = code_version()
    jobs = [FitJob(scenario, method, level, run, seed, version) for scenario, level, run, method in keys]
    with study_table(path, rerun=rerun) as store:
        store.fill(fits, jobs, tuple, lambda result: [_row(result)], JobOptions(executor, limits), "fitting")
    key_types = {name: kind for name, kind in _schema().items() if name in KEY}
    table = store.table(pl.DataFrame(jobs, schema=key_types, orient="row"))
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
    """Return the sample mean and variance over the rows of a table; InputError where a list has a wrong length."""
    import polars as pl

    successful = table.filter(pl.col("value").list.len() > 0)
    value, std = _list_column(successful, "value", parameters), _list_column(successful, "std", parameters)
    interval = _list_column(successful, "interval", 2 * parameters).reshape(-1, parameters, 2)
    # two standard errors where the estimator gives no interval
    is_absent = (successful["interval"].list.len() == 0).to_numpy()
    interval[is_absent] = np.stack([value - NORMAL_95 * std, value + NORMAL_95 * std], axis=2)[is_absent]
    not_available = np.full(parameters, np.nan)
    return Statistics(
        mean=value.mean(axis=0) if len(successful) else not_available,
        variance=value.var(axis=0, ddof=1) if len(successful) > 1 else not_available,
        estimates=value,
        failed=len(table) - len(successful),
        interval=interval,
        unsettled=int((successful["status"] == FitOutcome.UNSETTLED).sum()),
    )


def _list_column(table: pl.DataFrame, name: str, size: int) -> Array:
    """Return a column of lists as an array (rows, size), nan where a list is empty; InputError for other lengths."""
    rows = table[name].to_list()
    if wrong := {len(row) for row in rows} - {0, size}:
        words = f"lists of {min(wrong)} numbers in the column {name!r}, not of {size}"
        raise InputError(f"the table of the study has {words}; delete it and run again.")
    return np.array([row or [np.nan] * size for row in rows], dtype=float).reshape(-1, size)
