"""Monte Carlo studies: scenario x method x noise level x run -> one row per fit, resumable."""

from __future__ import annotations

import hashlib
import struct
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, as_completed
from dataclasses import dataclass
from functools import cache
from importlib.metadata import version
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError
from dynident.estimators import Estimate
from dynident.kernel import kernel
from dynident.models import Recording
from dynident.regression import one_thread
from dynident.splines import NORMAL_95
from dynident.studies.table import KEY, Outcome, StudyTable, frame, key_of

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


@dataclass(frozen=True)
class _Unit:
    """The methods still to run on one recording: they all see the same noise."""

    scenario: Any
    methods: tuple[Any, ...]
    level: float
    run: int
    seed: int
    version: str

    def rows(self) -> list[dict[str, Any]]:
        record = self.scenario.record(self.level, generator(self.seed, self.level, self.run))
        with one_thread():
            return [self._row(method, record) for method in self.methods]

    def _row(self, method: Method, record: Recording) -> dict[str, Any]:
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
        except Exception as error:  # a failed fit is a row, whatever the exception
            outcome, reason = Outcome.FAILED, f"{type(error).__name__}: {error}"
        seconds = time.perf_counter() - began
        key = (self.scenario.name, method.name, self.level, self.run, self.seed, self.version)
        found: dict[str, Any] = {"status": outcome.value, "reason": reason, "seconds": seconds}
        found |= {"value": value, "std": std, "interval": ends}
        return {**dict(zip(KEY, key, strict=True)), **found}


def _outcome(estimate: Estimate) -> Outcome:
    if not estimate.converged:
        return Outcome.UNSETTLED
    return Outcome.NOTED if estimate.notes else Outcome.OK


@cache
def code_version() -> str:
    """Return the version of the code: that of the package, a digest of its sources, and "kernel" or "numpy".

    All levels of the kernel give the same numbers, NumPy others by rounding.
    """
    root = Path(__file__).parents[1]
    sources = sorted(root.rglob("*.py"))
    digest = hashlib.sha256(b"".join(source.read_bytes() for source in sources)).hexdigest()
    return f"{version('dynident')}+{digest[:12]}.{'kernel' if kernel().level else 'numpy'}"


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
    progress: Callable[[int, int], None] = lambda done, total: None,  # noqa: ARG005
) -> pl.DataFrame:
    """Run every method on ``runs`` recordings of every scenario at every noise level.

    Returns a table with one row per fit: scenario, method, level, run, seed, version, status (an ``Outcome``), reason
    (the error of a failed fit, else the types of the notes), seconds, value, std and interval (lists, empty where it
    failed; of the ends of 95 % intervals, lower and upper in turn, where they are known), sorted by these. With
    ``path`` the table is kept there (Parquet), and while it grows its new rows in a file beside it (``StudyTable``): an
    interrupted study continues where it stopped; failed rows and those of another version of dynident's code are
    computed again. With ``executor`` the recordings are spread
    over its workers; the numbers do not depend on it. ``progress`` is called with the fits done and their total.
    """
    import polars as pl

    if runs < 1:
        raise InputError(f"runs is {runs}; a study needs at least 1.")
    wanted = {
        (scenario.name, method.name, float(level), run, seed, code_version()): (scenario, method)
        for scenario, level, run, method in product(scenarios, levels, range(runs), methods)
    }
    with StudyTable(path) as kept:
        done = {key_of(row) for row in kept.rows}
        count = len(wanted.keys() & done)
        progress(count, len(wanted))
        for rows in _results(_units(wanted, done), executor):
            kept.add(rows)
            count += len(rows)
            progress(count, len(wanted))
    table = frame([row for row in kept.rows if key_of(row) in wanted])
    order = {name: k for k, name in enumerate(dict.fromkeys(method.name for method in methods))}
    return table.sort("scenario", "level", pl.col("method").replace_strict(order, return_dtype=pl.Int64), "run")


def _units(wanted: dict[tuple[Any, ...], tuple[Any, Any]], done: set[tuple[Any, ...]]) -> list[_Unit]:
    groups: dict[tuple[Any, ...], tuple[Any, list[Any]]] = {}
    for key, (scenario, method) in wanted.items():
        if key not in done:
            groups.setdefault((key[0], *key[2:]), (scenario, []))[1].append(method)
    return [_Unit(scenario, tuple(found), *key[1:]) for key, (scenario, found) in groups.items()]


def _results(units: Iterable[_Unit], executor: Executor | None) -> Iterator[list[dict[str, Any]]]:
    if executor is None:
        yield from (unit.rows() for unit in units)
        return
    futures = [executor.submit(_Unit.rows, unit) for unit in units]
    try:
        for future in as_completed(futures):
            yield future.result()
    finally:
        for future in futures:
            future.cancel()


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
    rows = [row for row in table.to_dicts() if row["value"]]
    good = [row["value"] for row in rows]
    for name, size in (("value", parameters), ("std", parameters), ("interval", 2 * parameters)):
        if wrong := {len(row.get(name) or ()) for row in rows} - {0, size}:
            words = f"lists of {min(wrong)} numbers in the column {name!r}, not of {size}"
            raise InputError(f"the table of the study has {words}; delete it and run again.")
    estimates = np.array(good, dtype=float).reshape(len(good), parameters)
    ends = [_ends(row) for row in rows]
    nothing = np.full(parameters, np.nan)
    return Statistics(
        mean=estimates.mean(axis=0) if good else nothing,
        variance=estimates.var(axis=0, ddof=1) if len(good) > 1 else nothing,
        estimates=estimates,
        failed=len(table) - len(good),
        interval=np.array(ends, dtype=float).reshape(len(good), parameters, 2),
        unsettled=sum(row.get("status") == Outcome.UNSETTLED for row in rows),
    )


def _ends(row: dict[str, Any]) -> Array:
    """Return the ends (p, 2) of the 95 % intervals of a row, nan where it has neither them nor standard errors."""
    value = np.array(row["value"])
    if row.get("interval"):
        return np.reshape(row["interval"], (-1, 2))
    half = NORMAL_95 * np.array(row.get("std") or np.full(len(value), np.nan))
    return np.stack([value - half, value + half], axis=1)
