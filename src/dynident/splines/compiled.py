"""What the kernel does for the splines, each with its NumPy counterpart where there is no kernel.

``Solver`` solves eq. (32) for many trials at once: those of one time grid side by side, each with its own p.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from ctypes import addressof, c_char, c_double, c_int32, c_int64, c_void_p
from dataclasses import dataclass
from math import isfinite, nan
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from dynident.kernel import function
from dynident.splines.banded import Grid, IllConditionedError, Solution, System

__all__ = ["Answer", "Bare", "Data", "Solver", "Trial", "finished", "roughness", "scaled", "slopes", "survey"]

Array = NDArray[np.float64]
Answer = Solution | IllConditionedError
GIVEN = (c_int64, *(c_void_p,) * 5)
FIGURES = 8  # that the kernel returns of each series
ABREAST = 16  # rows that the kernel looks at side by side
PRODUCTS = 8  # pivots in a product
CLEAR = 1e-4  # share of the sum of squares from which on what a line leaves may be had by subtraction
KEPT, MOST = 2**20, 12  # numbers of the largest work array that is kept, and how many of them
NARROW = 2**21  # numbers of a work array from which on series are refined one after the other, which needs less memory
BROKEN = IllConditionedError("the Cholesky factorisation broke down")


class Data(Protocol):
    """What is known of a series."""

    @property
    def system(self) -> System:
        """The matrices."""

    @property
    def z(self) -> Array:
        """The right-hand side Q' y (N - 2)."""


@dataclass(frozen=True, eq=False)
class Bare:
    """A system and a right-hand side alone."""

    system: System
    z: Array


class Trial(NamedTuple):
    """A p to solve eq. (32) of a series for: for u, refined, or for figures alone, with the derivatives of the
    determinant (``trace``), and that itself (``determinant``).

    ``aim``: the rss that a refined solution should have, and its logarithm's slope by log p. The kernel corrects p
    where it is missed by a relative error below 1e-5, so the p of the solution may differ.
    """

    series: Data
    p: float
    refine: bool = False
    trace: bool = False
    determinant: bool = False
    aim: tuple[float, float] = (0.0, 0.0)


class Work:
    """An array that is handed to the kernel again and again, and its address."""

    def __init__(self, rows: int, count: int, kind: type = np.float64) -> None:
        self.array: NDArray[Any] = np.empty((rows, count), kind)
        self.at = self.array.ctypes.data


class Solver:
    """Solves trials; keeps its work arrays from one call to the next, as fresh memory costs more than arithmetic."""

    _local: ClassVar[threading.local] = threading.local()

    @classmethod
    def of_thread(cls) -> Solver:
        """Return the one of this thread."""
        if not hasattr(cls._local, "solver"):
            cls._local.solver = cls()
        solver: Solver = cls._local.solver
        return solver

    def __init__(self) -> None:
        width = function("spline_lanes", result=c_int32)
        self.lanes = 0 if width is None else int(width())
        self._work: dict[tuple[str, int, int], Work] = {}
        self._calls: dict[tuple[bool, int], Callable[..., None]] = {}
        for name, count in (("one", 1), ("many", self.lanes)) if self.lanes else ():
            self._calls[False, count] = _function(f"spline_figures_{name}", *GIVEN, *(c_void_p,) * 2)
            self._calls[True, count] = _function(f"spline_refined_{name}", *GIVEN, *(c_void_p,) * 6)

    def __call__(self, trials: Sequence[Trial]) -> list[Answer]:
        """Return the solution of each, or the error where double precision is not enough for it."""
        if not self.lanes or trials[0].series.system.size < 2:
            return [_by_lapack(trial) for trial in trials]
        if len(trials) == 1:
            return self._solve(trials)
        answers: dict[int, Answer] = {}
        groups: dict[tuple[int, bool, bool], list[int]] = {}
        for k, trial in enumerate(trials):
            groups.setdefault((id(trial.series.system.grid), trial.refine, trial.determinant), []).append(k)
        for members in groups.values():
            first = trials[members[0]]
            wide = not first.refine or first.series.system.size * self.lanes <= NARROW
            for part in self._parts(members) if wide else [[k] for k in members]:
                answers.update(zip(part, self._solve([trials[k] for k in part]), strict=True))
        return [answers[k] for k in range(len(trials))]

    def tidy(self) -> None:
        """Let go of the work arrays where one is large, or they are many."""
        sizes = [work.array.size for work in self._work.values()]
        if sizes and (max(sizes) > KEPT or len(sizes) > MOST):
            self._work.clear()

    def _parts(self, members: list[int]) -> list[list[int]]:
        """Split into groups that fill the lanes, and single ones, which are faster than a group nearly empty."""
        least = max(2, (self.lanes + 1) // 3)
        parts = [members[k : k + self.lanes] for k in range(0, len(members), self.lanes)]
        if len(parts[-1]) < least:
            parts[-1:] = [[k] for k in parts[-1]]
        return parts

    def _array(self, key: str, rows: int, count: int, kind: type = np.float64) -> Work:
        """Return a work array (rows, count), the same one for the same key and shape."""
        if (key, rows, count) not in self._work:
            self._work[key, rows, count] = Work(rows, count, kind)
        return self._work[key, rows, count]

    def _solve(self, trials: Sequence[Trial]) -> list[Answer]:
        """Solve trials of one grid side by side."""
        count = 1 if len(trials) == 1 else self.lanes
        p, data = self._array("p", 1, count), self._array("data", 2, count, np.uintp)
        first, weighted = trials[0], trials[0].series.system.variance is not None
        p.array[:], data.array[0] = first.p, _address(first.series.z)
        for k, trial in enumerate(trials[1:], 1):
            p.array[0, k], data.array[0, k] = trial.p, _address(trial.series.z)
        if weighted:
            at = [
                _address(trial.series.system.variance) for trial in trials if trial.series.system.variance is not None
            ]
            data.array[1] = at + at[:1] * (count - len(at))
        step, r = first.series.system.grid.addresses
        variance = data.at + data.array.strides[0] if weighted else None
        given = (first.series.system.size, step, r, data.at, variance, p.at)
        return (self._refined if first.refine else self._figures)(trials, given, count)

    def _figures(self, trials: Sequence[Trial], given: tuple[int | None, ...], count: int) -> list[Answer]:
        """Return what one sweep inwards shows: with E = z' A^-1 z, rss is E + dE / d log p."""
        out, determined = self._array("out", FIGURES, count), trials[0].determinant
        products = self._array("products", trials[0].series.system.size // PRODUCTS + 2, count) if determined else None
        self._calls[False, count](*given, None if products is None else products.at, out.at)
        determinant = [nan] * count
        if products is not None:
            with np.errstate(all="ignore"):
                factors = products.array[: int(out.array[7, 0])]
                determinant = (np.log(factors).sum(axis=0) + np.log(out.array[6])).tolist()
        found: list[Answer] = []
        for trial, one, log_det in zip(trials, out.array.T.tolist(), determinant, strict=False):
            whole, rate, rate2, rise, bend, bad = one[:6]
            rss = whole + rate
            if bad or not isfinite(rss):
                found.append(BROKEN)
            else:
                slope = (rate + rate2) / rss if rss else nan
                found.append(Solution(trial.p, None, rss, nan, nan, slope, -rate / trial.p, log_det, rise, bend))
        return found

    def _refined(self, trials: Sequence[Trial], given: tuple[int | None, ...], count: int) -> list[Answer]:
        """Return u, refined as ``System`` does."""
        rows = trials[0].series.system.size + 2
        work = [self._array(key, rows, count).at for key in ("rd", "left", "g")]
        u, out, aim = np.empty((rows, count)), self._array("results", 6, count), self._array("aim", 2, count)
        aim.array[:] = 0.0
        for k, trial in enumerate(trials):
            aim.array[:, k] = trial.aim
        self._calls[True, count](*given, *work, _address(u), aim.at, out.at)
        found: list[Answer] = []
        for k, (_, one) in enumerate(zip(trials, out.array.T.tolist(), strict=False)):
            rss, residual, accuracy, state, p, square = one
            if state:
                words = f"iterative refinement stops at a relative correction of {accuracy**0.5:.1e}"
                found.append(BROKEN if state == 1 else IllConditionedError(words))
            else:
                found.append(Solution(p, u[1:-1, k], rss, residual**0.5, accuracy**0.5, norm=square**0.5))
        return found


def _by_lapack(trial: Trial) -> Answer:
    try:
        return trial.series.system.solve(trial.p, trial.series.z, refine=trial.refine, trace=trial.trace)
    except IllConditionedError as error:
        return error


def _function(name: str, *types: Any) -> Callable[..., None]:
    found = function(name, *types)
    assert found is not None  # noqa: S101 - the kernel was there when the solver was made
    return found


def _address(x: NDArray[Any]) -> int:
    """Return where the contiguous array is in memory."""
    try:
        return addressof(c_char.from_buffer(x))  # type: ignore[arg-type] # three times as fast as the other
    except (TypeError, ValueError):  # what may not be written, or has no elements
        return int(x.ctypes.data)


def _addresses(arrays: Sequence[Array]) -> NDArray[np.uintp]:
    """Return the addresses of contiguous arrays, which must be kept."""
    return np.array([_address(x) for x in arrays], dtype=np.uintp)


def survey(columns: Array) -> tuple[list[float], list[float], bool]:
    """Return the least and the largest value of each of the columns (N, k), and whether all are finite."""
    call = function("spline_survey", c_int64, c_int64, c_void_p, c_void_p)
    if call is None:
        return columns.min(axis=0).tolist(), columns.max(axis=0).tolist(), bool(np.isfinite(columns).all())
    n, k = columns.shape
    out = np.empty((3, ABREAST * k))
    call(n, k, _address(columns), _address(out))
    low, high, bad = out[:, :k].tolist()
    return low, high, not any(bad)  # nan is true


def scaled(grid: Grid, t: Array, columns: Array, unit: Sequence[float]) -> tuple[Array, list[float], list[float]]:
    """Return Q' y (k, N - 2) of y, the columns (N, k) less their first values times ``unit`` (k); the norm (k) of the
    slopes of y; and what a straight line with equal weights leaves of y, sum of squares (k), nan where subtraction is
    too inexact to tell."""
    n, k = columns.shape
    call = function("spline_scale", c_int64, c_int64, *(c_void_p,) * 4, c_double, c_double, *(c_void_p,) * 3)
    z = np.empty((k, n - 2))
    if call is None:
        steep = []
        for j in range(k):
            slope = np.diff(columns[:, j])
            slope /= grid.step
            slope *= unit[j]
            np.subtract(slope[1:], slope[:-1], out=z[j])
            steep.append(float(slope @ slope) ** 0.5)
        return z, steep, [nan] * k
    out, units = np.empty((5, k)), np.array(unit, dtype=float)
    middle, rate = float(t[n // 2]), (n - 1) / float(t[-1] - t[0])
    given = map(_address, (columns, grid.reciprocal, units, t))
    call(n, k, *given, middle, rate, _address(z), _address(out), _address(out) + out.strides[0] * 2)
    squares, whole, left = out[2:].tolist()
    kept = [one if one > CLEAR * all_of else nan for one, all_of in zip(left, whole, strict=True)]
    return z, [one**0.5 for one in squares], kept


def finished(
    columns: Array, systems: Sequence[System], u: Sequence[Array], size: Sequence[float], bend: Sequence[float]
) -> tuple[Array, Array]:
    """Return values, columns (N, k) less ``size`` (k) D^2 Q u, and c, ``bend`` (k) times u with zeros at the ends."""
    n, k = columns.shape
    call = function("spline_finish", c_int64, c_int64, *(c_void_p,) * 9)
    values, c = np.empty((n, k)), np.empty((n, k))
    if call is None:
        c[0] = c[-1] = 0.0
        for j, system in enumerate(systems):
            away = system.smoothed_away(u[j])
            away *= size[j]
            np.subtract(columns[:, j], away, out=values[:, j])
            np.multiply(u[j], bend[j], out=c[1:-1, j])
        return values, c
    variances = [system.variance for system in systems if system.variance is not None]
    variance = _addresses(variances) if variances else None
    at, apart = np.array([x.ctypes.data for x in u]), np.array([x.strides[0] // x.itemsize for x in u])
    first = _address(columns), _address(systems[0].grid.reciprocal), _address(at), _address(apart)
    units = np.array([size, bend], dtype=float)
    last = _address(units), _address(units) + units.strides[0], _address(values), _address(c)
    call(n, k, *first, None if variance is None else _address(variance), *last)
    return values, c


def roughness(t: Array, columns: Array, weight: Array) -> Array | None:
    """Return the mean squares (k) of the fourth divided differences of columns (N, k), each over its variance, where
    that of a sample is 1 / ``weight``, (N, 1) or (N, k); None where there is no kernel."""
    call = function("spline_noise", c_int64, c_int64, *(c_void_p,) * 3, c_int64, c_void_p)
    if call is None:
        return None
    n, k = columns.shape
    t, columns, weight = map(np.ascontiguousarray, (t, columns, weight))
    sums = np.empty(k)
    call(n, k, _address(t), _address(columns), _address(weight), weight.shape[1], _address(sums))
    sums /= n - 4
    return sums


def slopes(t: Array, values: Array, c: Array) -> Array | None:
    """Return the first derivative at the samples, like the data; None where there is no kernel."""
    call = function("spline_slope", c_int64, c_int64, *(c_void_p,) * 4)
    if call is None or not all(x.flags.c_contiguous and x.dtype == np.float64 for x in (t, values, c)):
        return None
    out = np.empty(values.shape)
    call(len(t), values.size // len(t), *map(_address, (t, values, c, out)))
    return out
