"""Spline operations of the compiled kernel, each with a NumPy fallback.

``Solver`` solves eq. (32) for many trials at once: those of one time grid side by side, each with its own p.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from ctypes import addressof, c_char, c_double, c_int32, c_int64, c_void_p
from math import isfinite, nan, sqrt
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from dynident.motion.splines.banded import Grid, IllConditionedError, Solution, System
from dynident.runtime import Noun
from dynident.runtime.arrays import Array
from dynident.runtime.kernel import function

Answer = Solution | IllConditionedError
ARGUMENT_TYPES = (c_int64, *(c_void_p,) * 5)
FIGURE_COUNT = 8  # that the kernel returns of each series
SURVEY_LANES = 16  # rows that the kernel looks at side by side
PIVOTS_PER_PRODUCT = 8  # pivots in a product
MIN_RESIDUAL_SHARE = 1e-4  # share of the sum of squares from which on what a line leaves may be had by subtraction
CHUNK_SAMPLES = 4096  # of the middle of long data, from which a search starts
MAX_CACHED_SIZE, MAX_CACHED_ARRAYS = 2**20, 12  # numbers of the largest work array that is kept, and how many of them
# numbers of a work array from which on series are refined one after the other, which needs less memory
MAX_PARALLEL_SIZE = 2**21
FACTORISATION_ERROR = IllConditionedError("the Cholesky factorisation broke down")


class SplineProblem(Protocol):
    """Protocol of a series to be solved: its system of matrices and its right-hand side."""

    @property
    def system(self) -> System:
        """The matrices."""

    @property
    def z(self) -> Array:
        """The right-hand side Q' y (N - 2)."""


class BareProblem(Noun):
    """A system and a right-hand side without the data they come from."""

    system: System
    z: Array


class SplineTrial(NamedTuple):
    """One p for which eq. (32) of a series is to be solved.

    With ``refine`` the answer holds u, refined; without, only figures: with ``trace`` also the derivatives of the
    determinant, with ``determinant`` the determinant itself. ``aim`` is the rss that a refined solution should
    have, and the slope of its logarithm by log p: the kernel corrects p where that rss is missed by a relative
    error below 1e-5, so that the p of the solution may differ.
    """

    series: SplineProblem
    p: float
    refine: bool = False
    trace: bool = False
    determinant: bool = False
    aim: tuple[float, float] = (0.0, 0.0)


class WorkArray:
    """An array that is passed to the kernel repeatedly, and its address in memory."""

    def __init__(self, rows: int, count: int, kind: type = np.float64) -> None:
        self.array: NDArray[Any] = np.empty((rows, count), kind)
        self.at = self.array.ctypes.data


class Solver:
    """Solves trials; keeps its work arrays from one call to the next, as fresh memory costs more than arithmetic."""

    _local: ClassVar[threading.local] = threading.local()

    @classmethod
    def of_thread(cls) -> Solver:
        """Return the solver of this thread."""
        if not hasattr(cls._local, "solver"):
            cls._local.solver = cls()
        solver: Solver = cls._local.solver
        return solver

    def __init__(self) -> None:
        width = function("spline_lanes", result=c_int32)
        self.lanes = 0 if width is None else int(width())
        self._work: dict[tuple[str, int, int], WorkArray] = {}
        self._calls: dict[tuple[bool, int], Callable[..., None]] = {}
        for name, count in (("one", 1), ("many", self.lanes)) if self.lanes else ():
            self._calls[False, count] = _require_function(f"spline_figures_{name}", *ARGUMENT_TYPES, *(c_void_p,) * 2)
            self._calls[True, count] = _require_function(f"spline_refined_{name}", *ARGUMENT_TYPES, *(c_void_p,) * 6)

    def __call__(self, trials: Sequence[SplineTrial]) -> list[Answer]:
        """Return the solution of each trial, or the error where double precision is not enough for it."""
        if not self.lanes or trials[0].series.system.size < 2:
            return [_solve_by_lapack(trial) for trial in trials]
        if len(trials) == 1:
            return self._solve(trials)
        answers: dict[int, Answer] = {}
        groups: dict[tuple[int, bool, bool], list[int]] = {}
        for k, trial in enumerate(trials):
            # one call of the kernel takes trials of one time grid that want the same kind of solution
            groups.setdefault((id(trial.series.system.grid), trial.refine, trial.determinant), []).append(k)
        for members in groups.values():
            leader = trials[members[0]]
            in_lanes = not leader.refine or leader.series.system.size * self.lanes <= MAX_PARALLEL_SIZE
            for part in self._split_lanes(members) if in_lanes else [[k] for k in members]:
                answers.update(zip(part, self._solve([trials[k] for k in part]), strict=True))
        return [answers[k] for k in range(len(trials))]

    def tidy(self) -> None:
        """Release the work arrays where one is large or there are many of them."""
        sizes = [work.array.size for work in self._work.values()]
        if sizes and (max(sizes) > MAX_CACHED_SIZE or len(sizes) > MAX_CACHED_ARRAYS):
            self._work.clear()

    def _split_lanes(self, members: list[int]) -> list[list[int]]:
        """Split into groups that fill the lanes, and single ones, which are faster than a group nearly empty."""
        min_filled = max(2, (self.lanes + 1) // 3)
        parts = [members[k : k + self.lanes] for k in range(0, len(members), self.lanes)]
        if len(parts[-1]) < min_filled:
            parts[-1:] = [[k] for k in parts[-1]]
        return parts

    def _array(self, key: str, rows: int, count: int, kind: type = np.float64) -> WorkArray:
        """Return a work array (rows, count), the same one for the same key and shape."""
        if (key, rows, count) not in self._work:
            self._work[key, rows, count] = WorkArray(rows, count, kind)
        return self._work[key, rows, count]

    def _solve(self, trials: Sequence[SplineTrial]) -> list[Answer]:
        """Solve trials of one grid side by side."""
        count = 1 if len(trials) == 1 else self.lanes
        p, data = self._array("p", 1, count), self._array("data", 2, count, np.uintp)
        leader, weighted = trials[0], trials[0].series.system.variance is not None
        # lanes without a trial repeat the first one, so that the kernel always reads valid memory
        p.array[:], data.array[0] = leader.p, _address(leader.series.z)
        for k, trial in enumerate(trials[1:], 1):
            p.array[0, k], data.array[0, k] = trial.p, _address(trial.series.z)
        if weighted:
            variance_addresses = [
                _address(trial.series.system.variance) for trial in trials if trial.series.system.variance is not None
            ]
            data.array[1] = variance_addresses + variance_addresses[:1] * (count - len(variance_addresses))
        step, r = leader.series.system.grid.addresses
        variance = data.at + data.array.strides[0] if weighted else None
        arguments = (leader.series.system.size, step, r, data.at, variance, p.at)
        return (self._solve_refined if leader.refine else self._solve_figures)(trials, arguments, count)

    def _solve_figures(
        self, trials: Sequence[SplineTrial], arguments: tuple[int | None, ...], count: int
    ) -> list[Answer]:
        """Return the figures of one forward sweep: with E = z' A^-1 z, rss is E + dE / d log p."""
        out, with_determinant = self._array("out", FIGURE_COUNT, count), trials[0].determinant
        products = (
            self._array("products", trials[0].series.system.size // PIVOTS_PER_PRODUCT + 2, count)
            if with_determinant
            else None
        )
        self._calls[False, count](*arguments, None if products is None else products.at, out.at)
        determinant = [nan] * count
        if products is not None:
            # the kernel returns products of a few pivots each: their logarithms are fewer, and no product overflows
            with np.errstate(all="ignore"):
                factors = products.array[: int(out.array[7, 0])]
                determinant = (np.log(factors).sum(axis=0) + np.log(out.array[6])).tolist()
        answers: list[Answer] = []
        for trial, figures, log_det in zip(trials, out.array.T.tolist(), determinant, strict=False):
            quadratic_form, rate, rate2, rise, bend, is_broken = figures[:6]
            rss = quadratic_form + rate
            if is_broken or not isfinite(rss):
                answers.append(FACTORISATION_ERROR)
            else:
                slope = (rate + rate2) / rss if rss else nan
                answers.append(Solution(trial.p, None, rss, nan, nan, slope, -rate / trial.p, log_det, rise, bend))
        return answers

    def _solve_refined(
        self, trials: Sequence[SplineTrial], arguments: tuple[int | None, ...], count: int
    ) -> list[Answer]:
        """Return u with iterative refinement, as ``System`` does."""
        rows = trials[0].series.system.size + 2
        work = [self._array(key, rows, count).at for key in ("rd", "left", "g")]
        u, out, aim = np.empty((rows, count)), self._array("results", 6, count), self._array("aim", 2, count)
        aim.array[:] = 0.0
        for k, trial in enumerate(trials):
            aim.array[:, k] = trial.aim
        self._calls[True, count](*arguments, *work, _address(u), aim.at, out.at)
        answers: list[Answer] = []
        for k, (_, figures) in enumerate(zip(trials, out.array.T.tolist(), strict=False)):
            rss, residual, accuracy, state, p, square = figures
            if state:
                message = f"iterative refinement stops at a relative correction of {accuracy**0.5:.1e}"
                answers.append(FACTORISATION_ERROR if state == 1 else IllConditionedError(message))
            else:
                answers.append(Solution(p, u[1:-1, k], rss, sqrt(residual), sqrt(accuracy), norm=sqrt(square)))
        return answers


def _solve_by_lapack(trial: SplineTrial) -> Answer:
    try:
        return trial.series.system.solve(trial.p, trial.series.z, refine=trial.refine, trace=trial.trace)
    except IllConditionedError as error:
        return error


def _require_function(name: str, *types: Any) -> Callable[..., None]:
    kernel_function = function(name, *types)
    assert kernel_function is not None  # noqa: S101 - the kernel was there when the solver was made
    return kernel_function


def _address(x: NDArray[Any]) -> int:
    """Return where the contiguous array is in memory."""
    try:
        return addressof(c_char.from_buffer(x))  # type: ignore[arg-type] # three times as fast as the other
    except (TypeError, ValueError):  # what may not be written, or has no elements
        return int(x.ctypes.data)


def column_ranges(columns: Array) -> tuple[list[float], list[float], bool]:
    """Return the least and the largest value of each of the columns (N, k), and whether all are finite."""
    call = function("spline_survey", c_int64, c_int64, c_void_p, c_void_p)
    if call is None:
        return columns.min(axis=0).tolist(), columns.max(axis=0).tolist(), bool(np.isfinite(columns).all())
    n, k = columns.shape
    out = np.empty((3, SURVEY_LANES * k))
    call(n, k, _address(columns), _address(out))
    low, high, bad = out[:, :k].tolist()
    return low, high, not any(bad)  # nan is true


def scale_columns(
    grid: Grid, t: Array, columns: Array, unit: Sequence[float]
) -> tuple[Array, list[float], list[float]]:
    """Return Q' y, the norms of the slopes of y and the residual of a straight line, for scaled columns.

    y are the columns (N, k) less their first values, times ``unit`` (k). Q' y has the shape (k, N - 2), the norms
    (k). The third result (k) is the sum of squares that a line with equal weights leaves of y, nan where
    subtraction is too inexact to tell.
    """
    n, k = columns.shape
    call = function("spline_scale", c_int64, c_int64, *(c_void_p,) * 4, c_double, c_double, *(c_void_p,) * 3)
    z = np.empty((k, n - 2))
    if call is None:
        slope_norms = []
        for j in range(k):
            slope = np.diff(columns[:, j])
            slope /= grid.step
            slope *= unit[j]
            np.subtract(slope[1:], slope[:-1], out=z[j])
            slope_norms.append(float(slope @ slope) ** 0.5)
        return z, slope_norms, [nan] * k
    out, units = np.empty((5, k)), np.array(unit, dtype=float)
    # the kernel fits the line in time from the middle sample, in units of the mean step
    middle, rate = float(t[n // 2]), (n - 1) / float(t[-1] - t[0])
    addresses = map(_address, (columns, grid.reciprocal, units, t))
    call(n, k, *addresses, middle, rate, _address(z), _address(out), _address(out) + out.strides[0] * 2)
    squares, total_squares, line_squares = out[2:].tolist()
    # what a line leaves is had by subtraction, which loses all digits of a share this small
    line_rss = [
        square if square > MIN_RESIDUAL_SHARE * total else nan
        for square, total in zip(line_squares, total_squares, strict=True)
    ]
    return z, list(map(sqrt, squares)), line_rss


def spline_values(
    columns: Array, systems: Sequence[System], u: Sequence[Array], size: Sequence[float], bend: Sequence[float]
) -> tuple[Array, Array]:
    """Return values and second-derivative coefficients of the spline.

    The values are the columns (N, k) less ``size`` (k) D^2 Q u; the coefficients c are ``bend`` (k) times u with
    zeros at the ends.
    """
    n, k = columns.shape
    call = function("spline_finish", c_int64, c_int64, *(c_void_p,) * 9)
    values, c = np.empty((n, k)), np.empty((n, k))
    if call is None:
        c[0] = c[-1] = 0.0
        for j, system in enumerate(systems):
            removed = system.removed_signal(u[j])
            removed *= size[j]
            np.subtract(columns[:, j], removed, out=values[:, j])
            np.multiply(u[j], bend[j], out=c[1:-1, j])
        return values, c
    variances = [system.variance for system in systems if system.variance is not None]
    variance = np.array([_address(x) for x in variances], dtype=np.uintp) if variances else None
    u_addresses, u_strides = np.array([x.ctypes.data for x in u]), np.array([x.strides[0] // x.itemsize for x in u])
    inputs = _address(columns), _address(systems[0].grid.reciprocal), _address(u_addresses), _address(u_strides)
    units = np.array([size, bend], dtype=float)
    outputs = _address(units), _address(units) + units.strides[0], _address(values), _address(c)
    call(n, k, *inputs, None if variance is None else _address(variance), *outputs)
    return values, c


def fit_single(t: Array, y: Array, rule: int, setting: float, sigma: float) -> tuple[Array, Array, Array] | None:
    """Return values (N), c (N) and the figures p, lam, S, sigma, residual and accuracy of the spline of one series.

    ``t`` (N) and ``y`` (N) or (N, 1) are float64; ``rule`` 0: with the sum S = ``setting``, 1: with p = ``setting``, 2:
    by GCV. A ``sigma`` of 0 is estimated. None where there is no kernel, or where this is left to the searches for
    several: for long data, data that cannot be smoothed, straight lines.
    """
    types = c_int64, *(c_void_p,) * 2, c_int32, *(c_double,) * 2, *(c_void_p,) * 4
    call, n = function("spline_fit", *types, result=c_int32), len(t)
    if call is None or not 4 <= n < 4 * CHUNK_SAMPLES:
        return None
    t, y = np.ascontiguousarray(t), np.ascontiguousarray(y)
    values, c, figures, work = np.empty(n), np.empty(n), np.empty(6), np.empty(7 * n)
    done = call(n, _address(t), _address(y), rule, setting, sigma, *map(_address, (work, values, c, figures)))
    return (values, c, figures) if done else None


def roughness(t: Array, columns: Array, weight: Array) -> Array | None:
    """Return the mean squares (k) of the fourth divided differences of columns (N, k), each over its variance.

    The variance of a sample is 1 / ``weight``, (N, 1) or (N, k). None where there is no kernel.
    """
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
