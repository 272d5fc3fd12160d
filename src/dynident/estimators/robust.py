"""Least squares that outliers of the torque hardly move: M-estimates by iteratively reweighted least squares."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal, get_args

import numpy as np
from annotated_types import Ge, Gt, Le
from numpy.typing import NDArray

from dynident.errors import ConfigError, Note, brief, changed, choices
from dynident.estimators.estimator import Estimate, Problem
from dynident.estimators.least_squares import MOST, joint_weights, weighted
from dynident.estimators.linear import LinearFit, estimate_of
from dynident.estimators.notes import Downweighted, StillMoving
from dynident.models import Model
from dynident.regression import Rank, Regression, rank_of

__all__ = ["RobustLeastSquares"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Loss = Literal["huber", "tukey"]
USUAL = {"huber": 1.345, "tukey": 4.685}  # 95 % efficiency for normal errors
WIDEST = 1e6  # standard deviations
NORMAL_MAD = 0.6744897501960817  # median absolute deviation of a standard normal error
HELD = 10  # steps after which the scales stay: the median need not settle
CLOSE, ROUGH = 1e-2, 1e-1  # step, in standard errors of all parameters together, that ends the iteration; of a start
ROUNDING = 1e-7  # of the torque: the least scale
FLATTEST = 0.1  # mean slope of psi: less, and the iteration has lost the data
HALF, MANY = 0.5, 0.05  # a torque that counts less than half; share of them that is said


@dataclass(frozen=True)
class RobustLeastSquares:
    """Least squares with Huber's or Tukey's weights: theta that minimises sum rho(e / s_j) over all torques.

    ``loss``: "huber" counts residuals beyond ``tuning`` scales by their size and not by their square; "tukey" does not
    count them at all, and starts from the fit with Huber's loss, because there is more than one minimum. ``tuning`` is
    in standard deviations; None takes 1.345 and 4.685, which lose 5 % of the efficiency where errors are normal. The
    scale s_j of each joint is the median absolute residual over 0.6745, so that up to half of its torques may be wrong.
    ``iterations`` at most.

    It is robust to wrong torques, not to a wrong motion: a sample at which the acceleration itself is spoilt has
    leverage. Residuals of a model that lacks an effect are no outliers; both losses then fit where the model is right,
    such as away from reversals, and the error of the rest grows. Rows are reweighted by sqrt(psi(u) / u), u = e / s_j,
    which, with the slopes psi', reaches all standard errors; the covariance is Huber's, s^2 mean(psi^2) / mean(psi')^2
    (X' X)^-1.

    P. J. Huber (1981), "Robust statistics", chapter 7; Beaton and Tukey (1974). Here every tenth torque is wrong:

    >>> import numpy as np
    >>> import dynident as dy
    >>> from dynident.models.gallery import pendulum
    >>> arm, t, rng = pendulum(), np.arange(1001) * 0.01, np.random.default_rng(0)
    >>> motion = dy.simulate(arm, arm.values, lambda s: [np.sin(5 * s)], t)
    >>> log = dy.record(motion, sigma_q=1e-4, sigma_tau=0.01, rng=rng).log
    >>> wrong = np.where(rng.random((1001, 1)) < 0.1, log.tau + 5.0, log.tau)
    >>> log = dy.Log(t, log.q, wrong, log.joints)
    >>> for estimator in (dy.LeastSquares(), dy.RobustLeastSquares("tukey")):
    ...     found = dy.identify(arm, log, smoother=dy.Spline(sigma=1e-4), estimator=estimator)
    ...     print(", ".join(f"{one:.4f}" for one in found.estimate.value))
    0.0832, 0.2524
    0.0824, 0.2497
    """

    loss: Loss = "huber"
    tuning: Annotated[float, Gt(0), Le(WIDEST)] | None = None
    iterations: Annotated[int, Ge(1), Le(MOST)] = 50

    __repr__ = changed

    def __post_init__(self) -> None:
        if self.loss not in get_args(Loss):
            raise ConfigError(f"loss = {self.loss!r}; {choices(self.loss, get_args(Loss))}")
        if self.tuning is not None and not 0 < self.tuning <= WIDEST:
            raise ConfigError(f"tuning = {self.tuning}; give standard deviations such as {USUAL[self.loss]}.")
        if not 1 <= self.iterations <= MOST:
            raise ConfigError(f"iterations = {self.iterations}; give a whole number from 1 to {MOST}.")

    def __call__(self, problem: Problem) -> Estimate:
        """Estimate; notes say where many torques count little, and where the iteration did not settle."""
        return estimate_of(problem, self.reduced(problem))

    def reduced(self, problem: Problem) -> LinearFit:
        """Return the rows with the weights of the last step."""
        regression, parameters = problem.regression, problem.model.parameters
        triangular = regression.triangular_factors
        factor, rank = weighted(triangular, joint_weights(triangular, "per_joint", 3, parameters), parameters)
        start = _Step.of(LinearFit(factor, rank, triangular.total))
        if self.loss == "tukey":
            start = self._settled(problem, _Huber(USUAL["huber"]), start, rank, ROUGH)[0]
        psi = _Huber if self.loss == "huber" else _Tukey
        last, moved = self._settled(problem, psi(self.tuning or USUAL[self.loss]), start, rank, CLOSE)
        notes = last.notes(problem.model)
        return replace(last.fit, notes=(*notes, *([StillMoving(self.iterations, moved)] if moved > CLOSE else [])))

    def _settled(
        self, problem: Problem, psi: _Huber | _Tukey, step: _Step, rank: Rank, close: float
    ) -> tuple[_Step, float]:
        """Return the last step, and its length in standard errors."""
        moved, scale = np.inf, None
        for k in range(self.iterations):
            errors = _Errors.of(problem.regression, step.value)
            if scale is None or k < HELD:
                scale = errors.scale(problem.regression)
            step, before = _step(problem, errors, scale, psi, rank), step
            moved = float(np.linalg.norm(step.fit.factor[:-1, :-1] @ (step.value - before.value)))
            if moved <= close:
                break
        return step, moved


@dataclass(frozen=True)
class _Huber:
    """psi(u) = u, at most ``c`` in size."""

    c: float

    def weights(self, u: Array) -> Array:
        """Return psi(u) / u."""
        return np.asarray(self.c / np.maximum(np.abs(u), self.c))

    def slopes(self, u: Array) -> Array:
        """Return psi'(u)."""
        return (np.abs(u) <= self.c).astype(float)


@dataclass(frozen=True)
class _Tukey:
    """psi(u) = u (1 - (u / c)^2)^2 within ``c``, and zero beyond."""

    c: float

    def weights(self, u: Array) -> Array:
        """Return psi(u) / u."""
        return np.asarray(np.square(1.0 - np.minimum(np.square(u / self.c), 1.0)))

    def slopes(self, u: Array) -> Array:
        """Return psi'(u), which is negative where psi falls."""
        x2 = np.minimum(np.square(u / self.c), 1.0)
        return np.asarray((1.0 - x2) * (1.0 - 5.0 * x2))


@dataclass(frozen=True, eq=False)
class _Step:
    """The ``value`` (p) after a step, the rows of which it is the solution, and the share (n) that counts little."""

    value: Array
    fit: LinearFit
    little: Array

    __repr__ = brief

    @classmethod
    def of(cls, fit: LinearFit, little: Array | None = None) -> _Step:
        """Return the step to the solution of a fit."""
        return cls(fit.solution.value, fit, np.zeros(0) if little is None else little)

    def notes(self, model: Model) -> tuple[Note, ...]:
        """Return the note on joints of which many torques count less than half."""
        found = tuple((model.joints[j].name, float(self.little[j])) for j in np.flatnonzero(self.little > MANY))
        return (Downweighted(found),) if found else ()


@dataclass(frozen=True, eq=False)
class _Errors:
    """The residuals of each motion (N, n), and which torques are fitted (N, n)."""

    left: tuple[Array, ...]
    used: tuple[Mask, ...]

    __repr__ = brief

    @classmethod
    def of(cls, regression: Regression, theta: Array) -> _Errors:
        """Return what theta (p) leaves, block by block."""
        left = tuple(np.zeros(one.q.shape) for one in regression.motions)
        used = tuple(np.zeros(one.q.shape, dtype=bool) for one in regression.motions)
        for k, rows, error, keep in regression.residuals(theta):
            left[k][rows], used[k][rows] = error, True if keep is None else keep
        return cls(left, used)

    def scale(self, regression: Regression) -> Array:
        """Return the scale (n) of each joint by the median of its absolute residuals, not below rounding."""
        triangular = regression.triangular_factors
        size = np.sqrt(np.square(triangular.factors[:, :, -1]).sum(axis=1) / np.maximum(triangular.rows, 1))
        floor = ROUNDING * np.where(size > 0, size, size.max(initial=0.0) or 1.0)
        found = [np.median(np.abs(own)) / NORMAL_MAD if len(own) else 0.0 for own in self.by_joint(self.left)]
        return np.maximum(found, floor)

    def by_joint(self, values: Sequence[Array]) -> list[Array]:
        """Return those of the values (N, n) of each motion that are fitted, joint by joint."""
        pairs = list(zip(values, self.used, strict=True))
        return [np.concatenate([one[on[:, j], j] for one, on in pairs]) for j in range(values[0].shape[1])]


def _step(problem: Problem, errors: _Errors, scale: Array, psi: _Huber | _Tukey, rank: Rank) -> _Step:
    """Return the weighted fit for residuals with these scales (n)."""
    regression, parameters = problem.regression, problem.model.parameters
    u = [left / scale for left in errors.left]
    w, slopes = [psi.weights(one) for one in u], [psi.slopes(one) for one in u]
    own = [errors.by_joint(some) for some in (u, w, slopes)]
    variance, trust, least = _moments(scale, *own)
    given = regression.weights or tuple(np.ones_like(one) for one in w)
    rows = replace(regression, weights=tuple(g * np.sqrt(one) for g, one in zip(given, w, strict=True)))
    triangular = rows.triangular_factors
    total = triangular.total
    sigma = np.sqrt(np.maximum(variance * trust, (ROUNDING * scale) ** 2) * total / max(total - rank.rank, 1))
    factor = triangular.stacked(1.0 / sigma)
    directions = rank_of(factor, parameters, None, rank)
    p = len(parameters)
    factor[p, p] = np.sqrt(max(total - directions.rank, 1))  # the variance of a row is one
    curved = tuple(np.square(g) * np.maximum(one, 0.0) * least for g, one in zip(given, slopes, strict=True))
    fit = LinearFit(factor, directions, total, 1.0 / sigma, rows.weights, curved, sigma=sigma)
    little = np.array([float(np.mean(one < HALF)) if len(one) else 0.0 for one in own[1]])
    return _Step.of(fit, little)


def _moments(
    scale: Array, u: Sequence[Array], w: Sequence[Array], slopes: Sequence[Array]
) -> tuple[Array, Array, Array]:
    """Return of each joint (n) the variance s^2 mean(psi^2) / mean(psi')^2 of an error that counts as much, the mean
    weight, and what slopes that are not negative are multiplied with, to have the mean of all."""
    variance, trust, least = np.square(scale), np.ones_like(scale), np.ones_like(scale)
    for j, (x, weight, slope) in enumerate(zip(u, w, slopes, strict=True)):
        if len(x):
            mean = max(float(slope.mean()), FLATTEST)
            variance[j] *= float(np.mean(np.square(weight * x))) / mean**2
            trust[j] = float(weight.mean())
            least[j] = mean / max(float(np.maximum(slope, 0.0).mean()), FLATTEST)
    return variance, trust, least
