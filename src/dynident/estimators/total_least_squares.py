"""Total least squares: the regressor has errors, too, of stated sizes; what is known exactly stays exact."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt, Le
from numpy.typing import NDArray

from dynident.errors import ConfigError, InputError, Note, brief, changed, choices
from dynident.estimators.estimator import Estimate, Problem
from dynident.estimators.least_squares import joint_weights, weighted
from dynident.estimators.linear import LinearFit, estimate_of, of_information
from dynident.estimators.motion_noise import motion_noise
from dynident.estimators.notes import ErrorsInRegressor
from dynident.models import Model
from dynident.regression import Rank, Regression, one_thread

__all__ = ["TotalLeastSquares"]

Array = NDArray[np.float64]
LARGEST = 1e9
DRAWS, ENOUGH = 8, 20_000  # of the errors of the motion, at most; samples that are enough
ROUNDS, CLOSE = 50, 1e-10
LEAST = (
    0.05  # of the residual's square is the torque's own at least, however large the regressor's errors are said to be
)
WEAK = 0.1  # share of the regressor's square that is error, along one direction, above which it is said
FLAT = 1e-3  # of the torque that the parameters make: a solution that leaves no more of the measured one is none


@dataclass(frozen=True)
class TotalLeastSquares:
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
    >>> from dynident.models.gallery import pendulum
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
    torque: Annotated[float, Gt(0), Le(LARGEST)] | None = None
    tolerance: Annotated[float, Gt(0), Le(0.01)] | None = None
    seed: Annotated[int, Ge(0), Le(2**32 - 1)] = 0

    __repr__ = changed

    def __post_init__(self) -> None:
        if isinstance(self.errors, Mapping):
            object.__setattr__(self, "errors", tuple(self.errors.items()))
        if isinstance(self.errors, str) and self.errors != "motion":
            raise ConfigError(f"errors = {self.errors!r}; {choices(self.errors, ['motion'])}, or sizes by parameter.")
        for name, value in self._given.items():
            if not 0 <= value <= LARGEST:
                raise ConfigError(
                    f"errors: {name} = {value}; give a standard deviation, a number from 0 to {LARGEST:g}."
                )
        if self.torque is not None and not 0 < self.torque <= LARGEST:
            raise ConfigError(f"torque = {self.torque}; give the standard deviation of its error, a positive number.")

    @property
    def named(self) -> tuple[str, ...]:
        """The parameters of which the columns' errors are given."""
        return tuple(self._given)

    @property
    def needs_samples(self) -> bool:
        """Whether it repeats the smoothing of the samples."""
        return self.errors == "motion"

    def among(self, names: Collection[str]) -> TotalLeastSquares:
        """Return the estimator without the errors of other columns than these."""
        if isinstance(self.errors, str):
            return self
        return replace(self, errors=tuple(one for one in self._given.items() if one[0] in names))

    @property
    def _given(self) -> dict[str, float]:
        return {} if isinstance(self.errors, str) else dict(self.errors)

    def __call__(self, problem: Problem) -> Estimate:
        """Estimate; a note says where the errors of the regressor are a good part of what the motion shows.

        Raises ConfigError where ``errors`` names parameters that the model does not have, and InputError where there is
        no solution.
        """
        return estimate_of(problem, self.reduced(problem))

    def reduced(self, problem: Problem) -> LinearFit:
        """Return the fit, by its value and information; where nothing has errors the rows of least squares."""
        regression, parameters = problem.regression, problem.model.parameters
        triangular = regression.triangular_factors
        w = joint_weights(triangular, "per_joint", 3, parameters, self.tolerance)
        factor, rank = weighted(triangular, w, parameters, self.tolerance)
        C = self._errors(problem, w)
        if not C.any():
            return LinearFit(factor, rank, triangular.total, w)
        torque = None if self.torque is None else float(triangular.rows @ np.square(w * self.torque))
        found = _solved(factor, C, rank, triangular.total, torque)
        notes = _noted(found, problem.model)
        return replace(of_information(found.value, found.information, rank, triangular.total, notes), weights=w)

    def _errors(self, problem: Problem, w: Array) -> Array:
        """Return C (p, p), the sum of the covariances of the errors of all rows, weighted by joint (n)."""
        model, triangular = problem.model, problem.regression.triangular_factors
        if self.errors == "motion":
            return _of_motion(problem, w, np.random.default_rng(self.seed)) if problem.logs else np.zeros((1, 1))
        for name in self._given:
            if name not in model.names:
                raise ConfigError(f"errors: {model.name} has no parameter {name!r}; {choices(name, model.names)}")
        size = np.array([self._given.get(name, 0.0) for name in model.names])
        rows = (triangular.rows * np.square(w)) @ model.support
        return np.diag(np.square(size) * rows)


@dataclass(frozen=True, eq=False)
class _Solution:
    """The ``value`` (p) with its ``information`` (p, p); the largest ``share`` of the regressor's square that is error,
    and its ``direction`` (p), in scaled columns."""

    value: Array
    information: Array
    share: float
    direction: Array

    __repr__ = brief


def _solved(factor: Array, C: Array, rank: Rank, total: int, torque: float | None) -> _Solution:
    """Return the solution along the directions that the rank determines; ``torque`` is C of the torque, if known."""
    V, p = rank.determined, len(factor) - 1
    R: Array = np.asarray(np.linalg.qr(np.column_stack([factor[:, :p] @ V, factor[:, p]]), mode="r"))
    C = V.T @ C @ V
    r = len(C)
    R[r, r] = max(abs(R[r, r]), np.finfo(float).eps * np.linalg.norm(R[:, r]))  # of exact data it is rounding
    v, least = _without(R, C) if torque is None else _smallest(R, C, torque)
    A = R[:r, :r].T @ R[:r, :r] - least * C
    left = float(np.sum((R @ v) ** 2))
    half = np.linalg.solve(R[:r, :r].T, A)
    information = half.T @ half * (total - r) / left
    back = rank.scale[:, None] * rank.vectors[:, :r]
    inverse = np.linalg.inv(R[:r, :r])
    shares, turns = np.linalg.eigh(inverse.T @ C @ inverse)
    return _Solution(
        V @ v[:r], back @ information @ back.T, float(shares[-1]), rank.vectors[:, :r] @ inverse @ turns[:, -1]
    )


def _without(R: Array, C: Array) -> tuple[Array, float]:
    """Return v = (theta, -1) where C is known and the torque has what else the residual shows: then the minimum is one,
    (X'X - C) theta = X'y. Where C is said to be larger than that, the torque keeps the ``LEAST``."""
    gram, right = R[:-1, :-1].T @ R[:-1, :-1], R[:-1, :-1].T @ R[:-1, -1]
    v, left = np.append(np.linalg.solve(gram, right), -1.0), 0.0
    if np.linalg.eigvalsh(gram - C)[0] > 0:
        v = np.append(np.linalg.solve(gram - C, right), -1.0)
        left = float(np.sum((R @ v) ** 2))
        if left - float(v[:-1] @ C @ v[:-1]) > LEAST * left:
            return v, 1.0
    least = 1.0
    for _ in range(ROUNDS):
        before, left = left, float(np.sum((R @ v) ** 2))
        if abs(left - before) <= CLOSE * left:
            break
        v, least = _smallest(R, C, LEAST * left)
    return v, least


def _smallest(R: Array, C: Array, own: float) -> tuple[Array, float]:
    """Return v = (theta, -1) that minimises v'R'Rv / v'Cv, C with ``own`` for the torque, and the minimum."""
    inverse = np.linalg.inv(R)
    whole = np.zeros_like(R)
    whole[:-1, :-1], whole[-1, -1] = C, own
    values, turns = np.linalg.eigh(inverse.T @ whole @ inverse)
    v = inverse @ turns[:, -1]
    if not abs(v[-1]) * np.linalg.norm(R[:, -1]) > FLAT * np.linalg.norm(R @ np.append(v[:-1], 0.0)):
        raise InputError(
            "total least squares has no solution here: along one direction the motion shows no more than the errors "
            "that are stated of the regressor. State smaller errors, leave out terms that the motion does not excite, "
            "or use kind: instrumental_variables."
        )
    return -v / v[-1], float(1.0 / values[-1])


def _of_motion(problem: Problem, w: Array, rng: np.random.Generator) -> Array:
    """Return C by drawing errors of the motion like its own, and taking what they do to the rows."""
    regression = replace(problem.regression, bias=None)
    noises = [
        motion_noise(log, one, problem.time_offset) for log, one in zip(problem.logs, regression.motions, strict=True)
    ]
    draws = int(np.clip(ENOUGH // max(sum(map(len, regression.motions)), 1), 1, DRAWS))
    found = np.zeros((len(problem.model.names),) * 2)
    with one_thread():
        for _ in range(draws):
            motions = tuple(one.drawn(motion, rng) for one, motion in zip(noises, regression.motions, strict=True))
            found += _difference(regression, replace(regression, motions=motions, min_speed=None), w)
    return found / draws


def _difference(regression: Regression, other: Regression, w: Array) -> Array:
    """Return the sum of w^2 d'd (p, p), d by how much the rows of another regression differ."""
    structure = regression.model.structure
    grams = [np.zeros((len(one), len(one))) for one in structure.maps]
    for a, b in zip(regression.entries(), other.entries(), strict=True):
        for j, part in enumerate(structure.parts):
            d = (b.entries[part] - a.entries[part]) * (1.0 if a.keep is None else a.keep[j])
            grams[j] += w[j] ** 2 * d @ d.T
    return np.asarray(sum(one.T @ gram @ one for one, gram in zip(structure.maps, grams, strict=True)))


def _noted(found: _Solution, model: Model) -> tuple[Note, ...]:
    """Return the note on errors that are a good part of what one direction shows."""
    if found.share <= WEAK:
        return ()
    return (ErrorsInRegressor(model.names[int(np.abs(found.direction).argmax())], 100.0 * found.share),)
