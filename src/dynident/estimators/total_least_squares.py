"""Total least squares: the regressor has errors of stated sizes, too; columns known exactly stay exact."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Gt, Le

from dynident.estimators.estimator import Problem, check_parameters
from dynident.estimators.least_squares import LeastSquares, LinearEstimator, LinearFit, rows_by_joint
from dynident.estimators.notes import ErrorsInRegressor
from dynident.motion.log import Log, Motion
from dynident.motion.splines import steady_noise
from dynident.regression import Rank, Regression, Selection, one_thread
from dynident.runtime import ConfigError, InputError, Noun
from dynident.runtime.arrays import Array

MAX_WINDOW = 1024  # samples of a spectrum, at most
MIN_SAMPLES = 16
MIN_NOISE = 1e-7  # noise, relative to the largest position
CUTOFF_CANDIDATES = 300  # cut-offs


class MotionNoise(Noun):
    """The noise of a motion's positions and how far it passes the smoother.

    ``density`` (n) is in rad^2/Hz or m^2/Hz, ``cutoff`` (n) is the frequency in Hz at which smoothing halves an
    amplitude.
    """

    density: Array
    cutoff: Array

    def draw(self, motion: Motion, rng: np.random.Generator) -> Motion:
        """Return the motion with random errors like its own added to q, dq and ddq.

        White noise of the positions is filtered as by a smoothing spline, 1 / (1 + (f / cutoff)^4), and
        differentiated.
        """
        n, step = len(motion), float(np.diff(motion.t).mean())
        size = n + (n % 2)
        f = np.fft.rfftfreq(size, step)[:, None]
        # white noise in the frequency domain, filtered like the positions; derivatives multiply it by i omega
        white = np.fft.rfft(rng.standard_normal((size, len(self.density))), axis=0) * np.sqrt(self.density / (2 * step))
        filtered = white / (1.0 + (f / self.cutoff) ** 4)
        rate = 2j * np.pi * f
        q, dq, ddq = (np.fft.irfft(filtered * rate**k, size, axis=0)[:n] for k in range(3))
        return replace(motion, q=motion.q + q, dq=motion.dq + dq, ddq=motion.ddq + ddq)


def motion_noise(log: Log, motion: Motion, time_offset: float = 0.0) -> MotionNoise:
    """Estimate the noise of a log's positions, and how far it passes into its motion.

    The density is that of the positions' differences, which contain hardly any motion. The cut-off is that of the
    smoothing spline whose transfer function is nearest to that between measured and smoothed positions.
    """
    step = float(np.diff(log.t).mean())
    if int(motion.mask.sum()) < MIN_SAMPLES:
        return MotionNoise(np.zeros(log.q.shape[1]), np.full(log.q.shape[1], 1e3 / step))
    smooth = motion.shift(-time_offset).q if time_offset else motion.q
    cutoff = [_smoothing_cutoff(a, b, step) for a, b in zip(log.q[motion.mask].T, smooth[motion.mask].T, strict=True)]
    return MotionNoise(2 * step * np.square(steady_noise(log.q, MIN_NOISE)), np.array(cutoff))


def _smoothing_cutoff(measured: Array, smooth: Array, step: float) -> float:
    """Return the cut-off (Hz) of smoothing by its effect on second differences, where low frequencies do not leak."""
    length = min(MAX_WINDOW, max((len(measured) - 2) // 4, MIN_SAMPLES - 2))
    window = np.hanning(length + 2)[1:-1]
    parts = [
        np.lib.stride_tricks.sliding_window_view(np.diff(x, 2), length)[:: max(length // 2, 1)]
        for x in (measured, smooth)
    ]
    before, after = (np.fft.rfft(part * window) for part in parts)
    f = np.fft.rfftfreq(length, step)[1:]
    # the transfer function by cross spectrum over spectrum: noise that both share is what smoothing passes
    power = np.square(np.abs(before)).sum(axis=0)[1:]
    transfer = (before.conj() * after).real.sum(axis=0)[1:]
    share = np.divide(transfer, power, out=np.ones_like(power), where=power > 0)
    candidates = np.append(np.geomspace(f[0], f[-1], CUTOFF_CANDIDATES), 1e3 / step)[:, None]
    return float(candidates[np.square(share - 1.0 / (1.0 + (f / candidates) ** 4)).sum(axis=1).argmin(), 0])


MAX_ERROR = 1e9
SEED = 0  # of the errors that are drawn
MAX_DRAWS, TOTAL_SAMPLES = 8, 20_000  # of the errors of the motion, at most; samples that are enough
MAX_ROUNDS, CONVERGED_CHANGE = 50, 1e-10
# of the residual's square is the torque's own at least, however large the regressor's errors are said to be
MIN_TORQUE_SHARE = 0.05
MAX_ERROR_SHARE = 0.1  # share of the regressor's square that is error, along one direction, above which it is said
# of the torque that the parameters make: a solution that leaves no more of the measured one is none
MIN_TORQUE_COMPONENT = 1e-3


@dataclass(frozen=True)
class TotalLeastSquares(LinearEstimator):
    """Least squares where the regressor has errors as well as the torque: mixed, generalised total least squares.

    ``errors`` are those of the regressor. "motion": of what the noise of the positions leaves in the smoothed motion,
    by its spectrum before and after smoothing; the covariance of the errors of a row follows from the model. Or the
    standard deviation of each column's error by parameter name, N m or N per unit of the parameter; columns that are
    not named are exact, and those named have independent errors. Offsets are exact in any case, with "motion" all that
    does not depend on it. ``torque`` is the standard deviation of the torque's error, N m or N; None takes what the
    residual has beyond the errors of the regressor.

    With M = [X y]'[X y] and C the sum of the covariances of the rows' errors, v = (theta, -1) minimises v'Mv / v'Cv
    (Van Huffel and Vandewalle, 1991, "The total least squares problem", chapters 3 and 10); singular C, of exact
    columns, is no special case. Only the directions that the data determine are fitted. Joints are weighted by their
    residuals. The covariance is A^-1 s^2 X'X A^-1 with A = X'X - C; it counts the errors of the motion.

    What it assumes is rarely true of robots, so compare with least squares on held-out motion. The estimate rests on
    the *stated* size of the errors; a size that is wrong by as much as it matters is worse than none. Errors of the
    columns are neither equal nor independent: all come from one motion, which the textbook's method (equal errors in
    all entries) ignores. It is consistent where errors are independent of the true motion; a smoother also takes
    motion away, which is no such error. Where no direction holds the torque there is no solution (the nongeneric case),
    and close to it the variance is large: a note says where errors are a good part of what a direction shows. Without
    logs the motion is taken as exact, and the estimate is that of least squares.

    >>> import numpy as np
    >>> import dynident as dy
    >>> from dynident.models.lagrangian import pendulum
    >>> arm, t, rng = pendulum(), np.arange(2001) * 0.01, np.random.default_rng(0)
    >>> motion = dy.simulate(arm, arm.values, lambda s: [0.4 * np.sin(5 * s)], t)
    >>> log = dy.record(motion, sigma_q=2e-3, sigma_tau=0.01, rng=rng).log
    >>> for estimator in (dy.LeastSquares(), dy.TotalLeastSquares()):
    ...     fit = dy.identify(arm, log, smoother=dy.Spline(sigma=1.8e-3), estimator=estimator).estimate
    ...     print(f"J = {fit.value[0]:.4f} +- {fit.std[0]:.4f}, h = {fit.value[1]:.4f} +- {fit.std[1]:.4f}")
    J = 0.0813 +- 0.0004, h = 0.2465 +- 0.0013
    J = 0.0820 +- 0.0005, h = 0.2486 +- 0.0014
    """

    errors: Literal["motion"] | Mapping[str, float] | tuple[tuple[str, float], ...] = "motion"
    torque: Annotated[float, Gt(0), Le(MAX_ERROR)] | None = None

    by_parameter: ClassVar[tuple[str, ...]] = ("errors",)
    title = "total least squares"

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, value in self.values_of("errors").items():
            if not 0 <= value <= MAX_ERROR:
                raise ConfigError(f"errors: {name} = {value}; give a standard deviation, from 0 to {MAX_ERROR:g}.")

    @property
    def needs_samples(self) -> bool:
        """Whether it repeats the smoothing of the samples."""
        return self.errors == "motion"

    def quick(self) -> TotalLeastSquares | LeastSquares:
        """Return least squares where the errors are those of the motion: each trial would smooth all logs again."""
        return LeastSquares(weights="per_joint") if self.errors == "motion" else self

    def reduced(self, problem: Problem) -> LinearFit:
        """Return the fit by its value and information, or the rows of least squares where nothing has errors.

        A note tells where errors of the regressor are a good part of what the motion shows. Raises ConfigError where
        ``errors`` names parameters that the model does not have, and InputError where there is no solution.
        """
        plain = rows_by_joint(problem)
        w, rank = np.asarray(plain.weights), plain.directions
        C = self._error_covariance(problem, w)
        if not C.any():
            return plain
        rows = problem.regression.triangular_factors.rows
        torque = None if self.torque is None else float(rows @ np.square(w * self.torque))
        solution = _solve_total(plain.factor, C, rank, plain.total, torque)
        parameter = problem.model.names[int(np.abs(solution.direction).argmax())]
        notes = (ErrorsInRegressor(parameter, 100.0 * solution.share),) if solution.share > MAX_ERROR_SHARE else ()
        fit = LinearFit.from_information(solution.value, solution.information, rank, plain.total, notes)
        return replace(fit, weights=w)

    def _error_covariance(self, problem: Problem, w: Array) -> Array:
        """Return C (p, p), the sum of the covariances of the errors of all rows, weighted by joint (n)."""
        model, triangular = problem.model, problem.regression.triangular_factors
        if self.errors == "motion" and not problem.logs:
            return np.zeros((1, 1))
        if self.errors == "motion":
            return _motion_error_covariance(problem, w, np.random.default_rng(SEED))
        stated = self.values_of("errors")
        check_parameters(stated, model, "errors")
        size = np.array([stated.get(name, 0.0) for name in model.names])
        rows = (triangular.rows * np.square(w)) @ model.support
        return np.diag(np.square(size) * rows)


class _Solution(Noun):
    """The ``value`` (p) with its ``information`` (p, p), and where errors matter most.

    ``share`` is the largest share of the regressor's square that is error, ``direction`` (p) its direction in
    scaled columns.
    """

    value: Array
    information: Array
    share: float
    direction: Array


def _solve_total(factor: Array, C: Array, rank: Rank, total: int, torque: float | None) -> _Solution:
    """Return the solution along the directions that the rank determines.

    ``torque`` is the torque's entry of C, None where it is unknown.
    """
    V, p = rank.determined_directions, len(factor) - 1
    R: Array = np.asarray(np.linalg.qr(np.column_stack([factor[:, :p] @ V, factor[:, p]]), mode="r"))
    # in the determined directions the regressor has full rank
    C = V.T @ C @ V
    r = len(C)
    R[r, r] = max(abs(R[r, r]), np.finfo(float).eps * np.linalg.norm(R[:, r]))  # of exact data it is rounding
    v, minimum = _solve_unknown_torque(R, C) if torque is None else _minimise_ratio(R, C, torque)
    A = R[:r, :r].T @ R[:r, :r] - minimum * C
    residual_square = float(np.sum((R @ v) ** 2))
    # sandwich A (X'X)^-1 A, so that the covariance is A^-1 s^2 X'X A^-1
    half = np.linalg.solve(R[:r, :r].T, A)
    information = half.T @ half * (total - r) / residual_square
    basis = rank.scale[:, None] * rank.vectors[:, :r]
    inverse = np.linalg.inv(R[:r, :r])
    shares, vectors = np.linalg.eigh(inverse.T @ C @ inverse)
    return _Solution(
        V @ v[:r], basis @ information @ basis.T, float(shares[-1]), rank.vectors[:, :r] @ inverse @ vectors[:, -1]
    )


def _solve_unknown_torque(R: Array, C: Array) -> tuple[Array, float]:
    """Return v = (theta, -1) and the minimum, where the torque has the part of the residual that C does not explain.

    Then the minimum is one, (X'X - C) theta = X'y. Where C is stated larger than the residual, the torque keeps
    the share ``MIN_TORQUE_SHARE`` of it.
    """
    gram, right_side = R[:-1, :-1].T @ R[:-1, :-1], R[:-1, :-1].T @ R[:-1, -1]
    v, residual_square = np.append(np.linalg.solve(gram, right_side), -1.0), 0.0
    # with an unknown error of the torque the minimum of the ratio is one by definition
    if np.linalg.eigvalsh(gram - C)[0] > 0:
        v = np.append(np.linalg.solve(gram - C, right_side), -1.0)
        residual_square = float(np.sum((R @ v) ** 2))
        if residual_square - float(v[:-1] @ C @ v[:-1]) > MIN_TORQUE_SHARE * residual_square:
            return v, 1.0
    # stated errors exceed the residual: leave the torque a small share of it, and iterate since that depends on v
    minimum = 1.0
    for _ in range(MAX_ROUNDS):
        previous, residual_square = residual_square, float(np.sum((R @ v) ** 2))
        if abs(residual_square - previous) <= CONVERGED_CHANGE * residual_square:
            break
        v, minimum = _minimise_ratio(R, C, MIN_TORQUE_SHARE * residual_square)
    return v, minimum


def _minimise_ratio(R: Array, C: Array, torque_error: float) -> tuple[Array, float]:
    """Return v = (theta, -1) that minimises v'R'Rv / v'Cv, and the minimum.

    ``torque_error`` is the torque's entry of C.
    """
    inverse = np.linalg.inv(R)
    error_covariance = np.zeros_like(R)
    error_covariance[:-1, :-1], error_covariance[-1, -1] = C, torque_error
    # the smallest ratio is one over the largest eigenvalue of the errors in units of the rows
    values, vectors = np.linalg.eigh(inverse.T @ error_covariance @ inverse)
    v = inverse @ vectors[:, -1]
    if not abs(v[-1]) * np.linalg.norm(R[:, -1]) > MIN_TORQUE_COMPONENT * np.linalg.norm(R @ np.append(v[:-1], 0.0)):
        raise InputError(
            "total least squares has no solution here: along one direction the motion shows no more than the errors "
            "that are stated of the regressor. State smaller errors, leave out terms that the motion does not excite, "
            "or use kind: instrumental_variables."
        )
    return -v / v[-1], float(1.0 / values[-1])


def _motion_error_covariance(problem: Problem, w: Array, rng: np.random.Generator) -> Array:
    """Return C from random errors like those of the motion, and their effect on the rows."""
    # the bias correction would be drawn as well: only the rows themselves are compared
    regression = replace(problem.regression, bias=None)
    pairs = zip(problem.logs, regression.motions, strict=True)
    noises = [motion_noise(log, entry, problem.time_offset) for log, entry in pairs]
    draws = int(np.clip(TOTAL_SAMPLES // max(sum(map(len, regression.motions)), 1), 1, MAX_DRAWS))
    total = np.zeros((len(problem.model.names),) * 2)
    with one_thread():
        for _ in range(draws):
            motions = tuple(entry.draw(motion, rng) for entry, motion in zip(noises, regression.motions, strict=True))
            total += _row_difference_gram(
                regression, replace(regression, motions=motions, selection=Selection(regression.filter)), w
            )
    return total / draws


def _row_difference_gram(regression: Regression, perturbed: Regression, w: Array) -> Array:
    """Return the sum of w^2 d'd (p, p), where d is the difference of the rows of two regressions."""
    structure = regression.model.structure
    grams = [np.zeros((len(column_map), len(column_map))) for column_map in structure.maps]
    for a, b in zip(regression.entries(), perturbed.entries(), strict=True):
        for j, part in enumerate(structure.parts):
            d = (b.entries[part] - a.entries[part]) * (1.0 if a.keep is None else a.keep[j])
            grams[j] += w[j] ** 2 * d @ d.T
    pairs = zip(structure.maps, grams, strict=True)
    return np.asarray(sum(column_map.T @ gram @ column_map for column_map, gram in pairs))
