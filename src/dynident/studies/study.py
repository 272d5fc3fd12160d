"""Monte Carlo studies: scenario x method x noise level x run -> one row per fit, resumable."""

from __future__ import annotations

import struct
import time
from array import array
from collections.abc import Callable, Container, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError
from dynident.estimators import Estimate
from dynident.jobs import Done, Limits, run_jobs
from dynident.jobs.software import code_version
from dynident.models import Recording
from dynident.regression import one_thread
from dynident.splines import NORMAL_95
from dynident.studies.table import KEY, Outcome, key_type, study_table

if TYPE_CHECKING:
    import polars as pl

__all__ = ["Method", "Outcome", "Scenario", "Statistics", "run_study", "statistics"]

Array = NDArray[np.float64]


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


class _Job(NamedTuple):
    """Methods to be run on one recording, which all see the same noise; by their names."""

    scenario: str
    methods: tuple[str, ...]
    level: float
    run: int


@dataclass(frozen=True)
class _Fits:
    """What makes the rows of a job; goes to each worker once."""

    scenarios: Mapping[str, Scenario]
    methods: Mapping[str, Method]
    seed: int
    version: str

    def __call__(self, job: _Job) -> list[dict[str, Any]]:
        record = self.scenarios[job.scenario].record(job.level, generator(self.seed, job.level, job.run))
        with one_thread():
            return [self.key(job, name) | _fit(self.methods[name], record) for name in job.methods]

    def key(self, job: _Job, method: str) -> dict[str, Any]:
        """Return what tells a fit from all others."""
        return dict(zip(KEY, (job.scenario, method, job.level, job.run, self.seed, self.version), strict=True))

    def without(self, done: Done[_Job, list[dict[str, Any]]]) -> list[dict[str, Any]]:
        """Return the rows of a job that gave none."""
        nothing = {"reason": done.reason, "seconds": done.seconds, "value": [], "std": [], "interval": []}
        return [self.key(done.job, name) | {"status": done.status.value} | nothing for name in done.job.methods]


def _fit(method: Method, record: Recording) -> dict[str, Any]:
    began = time.perf_counter()
    value: list[float] = []
    std: list[float] = []
    ends: list[float] = []
    try:
        estimate = method.estimate(record)
        value, std = estimate.value.tolist(), estimate.std.tolist()
        ends = [] if estimate.interval is None else estimate.interval.ravel().tolist()
        outcome = _outcome(estimate)
        reason = ", ".join(type(note).__name__ for note in estimate.notes)
    except MemoryError:  # the job as a whole has too little
        raise
    except Exception as error:  # a failed fit is a row, whatever the exception
        outcome, reason = Outcome.FAILED, f"{type(error).__name__}: {error}"
    seconds = time.perf_counter() - began
    return {
        "status": outcome.value, "reason": reason, "seconds": seconds, "value": value, "std": std, "interval": ends,
    }  # fmt: skip


def _outcome(estimate: Estimate) -> Outcome:
    if not estimate.converged:
        return Outcome.UNSETTLED
    return Outcome.NOTED if estimate.notes else Outcome.OK


def generator(seed: int, level: float, run: int) -> np.random.Generator:
    """Return the generator of one recording; it depends only on these three, not on the worker or the order of runs."""
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
    progress: Callable[[int, int], None] = lambda done, total: None,  # noqa: ARG005
) -> pl.DataFrame:
    """Run every method on ``runs`` recordings of every scenario at every noise level.

    Returns a table with one row per fit: scenario, method, level, run, seed, version, status (an ``Outcome``), reason
    (why a fit gave nothing, else the types of the notes), seconds, value, std and interval (lists, empty where it
    gave nothing; of the ends of 95 % intervals, lower and upper in turn, where they are known), sorted by these. With
    ``path`` the table is kept there (Parquet), while it grows in parts beside it (``RowStore``): an interrupted study
    continues where it stopped; fits that gave nothing and those of another version of dynident's code are computed
    again, with ``rerun`` all are. With ``executor`` the recordings are spread over its workers; the numbers do not
    depend on it. ``limits`` hold for one fit, or those on one recording. ``progress`` is called with the fits done and
    their total.
    """
    if runs < 1:
        raise InputError(f"runs is {runs}; a study needs at least 1.")
    fits = _Fits({one.name: one for one in scenarios}, {one.name: one for one in methods}, seed, code_version())
    with study_table(path, rerun=rerun) as kept:
        todo = _Todo(fits, tuple(dict.fromkeys(map(float, levels))), runs, kept)
        total = len(todo.keys())
        count = total - sum(todo.sizes)
        progress(count, total)
        with closing(_results(fits, todo, executor, limits)) as ended:
            for rows in ended:
                kept.add(rows)
                count += len(rows)
                progress(count, total)
    return _sorted(kept.table(todo.keys()), fits)


@dataclass(frozen=True, eq=False)
class _Todo:
    """The jobs of a study whose rows are not yet ``kept``."""

    fits: _Fits
    levels: tuple[float, ...]
    runs: int
    kept: Container[tuple[Any, ...]]

    @cached_property
    def sizes(self) -> array[int]:
        """The number of fits of each job, before the first has ended."""
        return array("I", (len(job.methods) for job in self))

    def __len__(self) -> int:
        return len(self.sizes)

    def __iter__(self) -> Iterator[_Job]:
        for scenario, level, run in product(self.fits.scenarios, self.levels, range(self.runs)):
            job = _Job(scenario, tuple(self.fits.methods), level, run)
            if left := tuple(name for name in job.methods if tuple(self.fits.key(job, name).values()) not in self.kept):
                yield job._replace(methods=left)

    def keys(self) -> pl.DataFrame:
        """Return the keys of all fits."""
        import polars as pl

        kinds, fits = key_type(), self.fits
        found = pl.DataFrame({"seed": [fits.seed], "version": [fits.version]}, schema_overrides=kinds)
        every = {"scenario": fits.scenarios, "method": fits.methods, "level": self.levels, "run": range(self.runs)}
        for name, values in every.items():
            found = found.join(pl.DataFrame({name: list(values)}, schema_overrides=kinds), how="cross")
        return found


def _results(
    fits: _Fits, jobs: Iterable[_Job], executor: Executor | None, limits: Limits | None
) -> Generator[list[dict[str, Any]], None, None]:
    """Yield the rows of each job; where one of several methods ended all, each of them is tried alone."""
    alone: list[_Job] = []
    for done in run_jobs(fits, jobs, executor, limits=limits):
        if done.value is not None:
            yield done.value
        elif len(done.job.methods) == 1:
            yield fits.without(done)
        else:
            alone += [done.job._replace(methods=(name,)) for name in done.job.methods]
    if alone:
        yield from _results(fits, alone, executor, limits)


def _sorted(table: pl.DataFrame, fits: _Fits) -> pl.DataFrame:
    import polars as pl

    order = {name: k for k, name in enumerate(fits.methods)}
    return table.sort("scenario", "level", pl.col("method").replace_strict(order, return_dtype=pl.Int64), "run")


@dataclass(frozen=True, eq=False)
class Statistics:
    """Sample ``mean`` and ``variance`` (p), eqs. (54)-(55), of the ``estimates`` (runs, p) of one case.

    Failed fits are counted in ``failed`` and left out; nan where too few are left. ``interval`` (runs, p, 2) are the
    ends of their 95 % intervals, two standard errors where the estimator gives no other; ``unsettled`` counts the fits
    that did not converge.
    """

    mean: Array
    variance: Array
    estimates: Array
    failed: int
    interval: Array
    unsettled: int = 0

    def coverage(self, true: Array) -> Array:
        """Return the share (p) of the intervals that hold the true values (p); nan where there are none."""
        inside = (self.interval[:, :, 0] <= true) & (true <= self.interval[:, :, 1])
        return np.asarray(inside.mean(axis=0) if len(inside) else np.full(self.interval.shape[1], np.nan))


def statistics(table: pl.DataFrame, parameters: int) -> Statistics:
    """Return the sample mean and variance over the rows of a table."""
    import polars as pl

    good = table.filter(pl.col("value").list.len() > 0)
    value, std = _numbers(good, "value", parameters), _numbers(good, "std", parameters)
    ends = _numbers(good, "interval", 2 * parameters).reshape(-1, parameters, 2)
    around = np.stack([value - NORMAL_95 * std, value + NORMAL_95 * std], axis=2)
    nothing = np.full(parameters, np.nan)
    return Statistics(
        mean=value.mean(axis=0) if len(good) else nothing,
        variance=value.var(axis=0, ddof=1) if len(good) > 1 else nothing,
        estimates=value,
        failed=len(table) - len(good),
        interval=np.where(_present(good, "interval")[:, None, None], ends, around),
        unsettled=int((good["status"] == Outcome.UNSETTLED).sum()) if "status" in table.columns else 0,
    )


def _numbers(table: pl.DataFrame, name: str, size: int) -> Array:
    """Return a column of lists as an array (rows, size), nan where a list is empty."""
    found = np.full((len(table), size), np.nan)
    if (present := _present(table, name)).any():
        lists = table[name].filter(present)
        if wrong := set(lists.list.len()) - {size}:
            words = f"lists of {min(wrong)} numbers in the column {name!r}, not of {size}"
            raise InputError(f"the table of the study has {words}; delete it and run again.")
        found[present] = lists.explode().to_numpy().reshape(-1, size)
    return found


def _present(table: pl.DataFrame, name: str) -> NDArray[np.bool_]:
    """Tell the rows whose list in a column is not empty."""
    if name not in table.columns:
        return np.zeros(len(table), bool)
    return np.asarray(table[name].list.len().fill_null(0).to_numpy() > 0)
