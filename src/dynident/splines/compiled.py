"""What the kernel does for the splines, each with its NumPy counterpart where there is no kernel.

``Solver`` solves eq. (32) for many trials at once: those of one time grid side by side, each with its own p.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from ctypes import c_int32, c_int64, c_void_p
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from dynident.kernel import function
from dynident.splines.banded import EPS, TINY, Grid, IllConditionedError, Solution, System, second_difference

__all__ = ["Answer", "Data", "Solver", "Trial", "finished", "scaled", "slopes", "survey"]

Array = NDArray[np.float64]
Answer = Solution | IllConditionedError
GIVEN = (c_int64, *(c_void_p,) * 5)
WORK = (*GIVEN, *(c_void_p,) * 4)
FIGURES = 8  # that the kernel returns of each series
PRODUCTS = 8  # pivots in a product
BROKEN = IllConditionedError("the Cholesky factorisation broke down")


class Data(Protocol):
    """What is known of a series."""

    @property
    def system(self) -> System:
        """The matrices."""

    @property
    def z(self) -> Array:
        """The right-hand side Q' y (N - 2)."""

    @property
    def norm(self) -> float:
        """Its norm."""


@dataclass(frozen=True, eq=False)
class Trial:
    """A p to solve eq. (32) of a series for; u of it, refined, or figures alone; those of the determinant, too."""

    series: Data
    p: float
    refine: bool = False
    trace: bool = False


class Solver:
    """Solves trials; keeps the work arrays from one call to the next."""

    def __init__(self) -> None:
        width = function("spline_lanes", result=c_int32)
        self.lanes = 0 if width is None else int(width())
        self._work: dict[tuple[str, int, int], Array] = {}

    def __call__(self, trials: Sequence[Trial]) -> list[Answer]:
        """Return the solution of each, or the error where double precision is not enough for it."""
        answers: dict[int, Answer] = {}
        groups: dict[tuple[int, bool, bool, bool], list[int]] = {}
        for k, trial in enumerate(trials):
            system = trial.series.system
            if not self.lanes or system.size < 2:
                answers[k] = _by_lapack(trial)
            else:
                key = (id(system.grid), system.variance is None, trial.refine, trial.trace)
                groups.setdefault(key, []).append(k)
        for members in groups.values():
            for part in self._parts(members):
                answers.update(zip(part, self._solve([trials[k] for k in part]), strict=True))
        return [answers[k] for k in range(len(trials))]

    def _parts(self, members: list[int]) -> list[list[int]]:
        """Split into groups that fill the lanes, and single ones, which are faster than a group that is nearly empty."""
        least = max(2, (self.lanes + 1) // 3)
        parts = [members[k : k + self.lanes] for k in range(0, len(members), self.lanes)]
        if len(parts[-1]) < least:
            parts[-1:] = [[k] for k in parts[-1]]
        return parts

    def _array(self, key: str, rows: int, count: int) -> Array:
        """Return a work array (rows, count), the same one for the same key and shape."""
        if (key, rows, count) not in self._work:
            self._work[key, rows, count] = np.empty((rows, count))
        return self._work[key, rows, count]

    def _solve(self, trials: list[Trial]) -> list[Answer]:
        """Solve trials of one grid side by side."""
        count, name = (1, "one") if len(trials) == 1 else (self.lanes, "many")
        filled = trials + trials[:1] * (count - len(trials))
        system = trials[0].series.system
        p = np.array([trial.p for trial in filled])
        z = _addresses([trial.series.z for trial in filled])
        variances = [trial.series.system.variance for trial in filled]
        variance = None if variances[0] is None else _addresses([x for x in variances if x is not None])
        given = (system.size, *map(_address, (system.grid.step, system.grid.reciprocal, z, variance, p)))
        found = self._refined if trials[0].refine else self._figures
        return found(trials, given, count, name)

    def _figures(self, trials: list[Trial], given: tuple[int | None, ...], count: int, name: str) -> list[Answer]:
        """Return what one sweep inwards shows: with E = z' A^-1 z, rss is E + dE / d log p."""
        products, out = self._array("products", given[0] // PRODUCTS + 2, count), np.empty((FIGURES, count))
        _function(f"spline_figures_{name}", *GIVEN, *(c_void_p,) * 2)(*given, _address(products), _address(out))
        whole, rate, rate2, rise, bend, bad, middle = out[:7]
        with np.errstate(all="ignore"):
            rss = whole + rate
            slope = (rate + rate2) / rss
            log_det = np.full(count, np.nan)
            if trials[0].trace:
                log_det = np.log(products[: int(out[7, 0])]).sum(axis=0) + np.log(middle)
        return [
            BROKEN
            if bad[k] or not np.isfinite(rss[k])
            else Solution(
                trial.p, None, *map(float, (rss[k], np.nan, np.nan, slope[k], -rate[k] / trial.p)),
                *map(float, (log_det[k], rise[k], bend[k])),
            )
            for k, trial in enumerate(trials)
        ]  # fmt: skip

    def _refined(self, trials: list[Trial], given: tuple[int | None, ...], count: int, name: str) -> list[Answer]:
        """Return u, refined as ``System`` does."""
        size, out = given[0], np.empty(count)
        rd, l, g, v = (self._array(key, size + 2, count) for key in ("rd", "l", "g", "v"))
        u = self._array("u", size + 2, count)
        given = (*given, *map(_address, (rd, l, g, u)))
        _function(f"spline_solve_{name}", *WORK, c_void_p)(*given, _address(out))
        norm = np.array([trial.series.norm for trial in trials] + [1.0] * (count - len(trials)))
        errors: list[IllConditionedError | None] = [BROKEN if bad else None for bad in out[: len(trials)]]
        rss, residual, accuracy = self._refine(given, v, name, norm, errors)
        return [
            error or Solution(trial.p, u[1:-1, k].copy(), *map(float, (rss[k], residual[k], accuracy[k])))
            for k, (trial, error) in enumerate(zip(trials, errors, strict=True))
        ]

    @staticmethod
    def _refine(
        given: tuple[int | None, ...], v: Array, name: str, norm: Array, errors: list[IllConditionedError | None]
    ) -> tuple[Array, Array, Array]:
        """Refine u of all lanes as ``System`` does; return rss, residual and accuracy, and note ``errors``."""
        remainder = _function(f"spline_remainder_{name}", *WORK, c_void_p, c_void_p, c_void_p)
        correct = _function(f"spline_correct_{name}", *WORK, c_void_p)
        count = v.shape[1]
        last, left, used = np.ones(count), np.full(count, np.inf), np.zeros(count)
        rss, residual, accuracy = np.full((3, count), np.nan)
        active = np.array([error is None for error in errors] + [False] * (count - len(errors)))
        sums, change = np.empty((3, count)), np.empty(count)
        with np.errstate(all="ignore"):
            while active.any():
                remainder(*given, _address(used), _address(v), _address(sums))
                rss[active] = sums[0, active]
                residual[active] = (np.sqrt(sums[1]) / np.maximum(norm, np.sqrt(TINY)))[active]
                done = active & (left <= EPS)
                accuracy[done] = EPS
                active &= ~done
                if not active.any():
                    break
                correct(*given, _address(change))
                change = np.sqrt(change / np.maximum(sums[2], TINY))
                stopped = active & ~(change < 0.5 * last)  # no further improvement at this precision
                accuracy[stopped] = change[stopped]
                for k in np.flatnonzero(stopped & ~(change < 1e-8)):
                    words = f"iterative refinement stops at a relative correction of {change[k]:.1e}"
                    errors[int(k)] = IllConditionedError(words)
                active &= ~stopped
                used = active.astype(float)
                left, last = change * change / last, change.copy()
        return rss, residual, accuracy


def _by_lapack(trial: Trial) -> Answer:
    try:
        return trial.series.system.solve(trial.p, trial.series.z, refine=trial.refine, trace=trial.trace)
    except IllConditionedError as error:
        return error


def _function(name: str, *types: Any) -> Callable[..., None]:
    found = function(name, *types)
    assert found is not None  # noqa: S101 - the kernel was there when the solver was made
    return found


def _address(x: Array | NDArray[np.uintp] | None) -> int | None:
    return None if x is None else x.ctypes.data


def _addresses(arrays: Sequence[Array]) -> NDArray[np.uintp]:
    """Return the addresses of contiguous arrays, which must be kept."""
    assert all(x.flags.c_contiguous for x in arrays)  # noqa: S101
    return np.array([x.ctypes.data for x in arrays], dtype=np.uintp)


def survey(columns: Array) -> tuple[Array, Array, bool]:
    """Return the least and the largest value of each of the columns (N, k), and whether all are finite."""
    call = function("spline_survey", c_int64, c_int64, c_void_p, c_void_p)
    if call is None:
        return columns.min(axis=0), columns.max(axis=0), bool(np.isfinite(columns).all())
    low, high, bad = out = np.empty((3, columns.shape[1]))
    call(*columns.shape, _address(columns), _address(out))
    return low, high, bool((bad == 0).all())


def scaled(grid: Grid, columns: Array, unit: Array) -> tuple[Array, Array]:
    """Return the columns (N, k) less their first values, times ``unit`` (k), as rows; and their Q' y (k, N - 2)."""
    n, k = columns.shape
    call = function("spline_scale", c_int64, c_int64, *(c_void_p,) * 5)
    y, z = np.empty((k, n)), np.empty((k, n - 2))
    if call is None:
        for j in range(k):
            np.subtract(columns[:, j], columns[0, j], out=y[j])
            y[j] *= unit[j]
            z[j] = second_difference(columns[:, j], grid.step)
            z[j] *= unit[j]
    else:
        call(n, k, *map(_address, (columns, grid.reciprocal, unit, y, z)))
    return y, z


def finished(
    columns: Array, systems: Sequence[System], u: Sequence[Array], size: Array, bend: Array
) -> tuple[Array, Array]:
    """Return values, columns (N, k) less ``size`` (k) D^2 Q u, and c, ``bend`` (k) times u with zeros at the ends."""
    n, k = columns.shape
    call = function("spline_finish", c_int64, c_int64, *(c_void_p,) * 8)
    values, c = np.empty((n, k)), np.empty((n, k))
    if call is None:
        c[0] = c[-1] = 0.0
        for j, system in enumerate(systems):
            np.subtract(columns[:, j], size[j] * system.smoothed_away(u[j]), out=values[:, j])
            np.multiply(u[j], bend[j], out=c[1:-1, j])
        return values, c
    variances = [system.variance for system in systems]
    variance = None if variances[0] is None else _addresses([x for x in variances if x is not None])
    r = systems[0].grid.reciprocal
    call(n, k, *map(_address, (columns, r, _addresses(u), variance, size, bend, values, c)))
    return values, c


def slopes(t: Array, values: Array, c: Array) -> Array | None:
    """Return the first derivative at the samples, like the data; None where there is no kernel."""
    call = function("spline_slope", c_int64, c_int64, *(c_void_p,) * 4)
    if call is None or not all(x.flags.c_contiguous and x.dtype == np.float64 for x in (t, values, c)):
        return None
    out = np.empty(values.shape)
    call(len(t), values.size // len(t), *map(_address, (t, values, c, out)))
    return out
