"""Least squares that outliers of the torque hardly move: M-estimates by iteratively reweighted least squares."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Literal, get_args

import numpy as np
from annotated_types import Ge, Gt, Le
from numpy.typing import NDArray

from dynident.errors import ConfigError, Note, Step, brief, changed, choices
from dynident.estimators.estimator import Estimate, Problem
from dynident.estimators.least_squares import MOST, LeastSquares, joint_weights, weighted
from dynident.estimators.linear import LinearFit, estimate_of, solve
from dynident.estimators.notes import Downweighted, StillMoving
from dynident.estimators.reweighting import ROUNDING, BaseRows, RowErrors
from dynident.regression import Rank, rank_of

__all__ = ["RobustLeastSquares"]

Array = NDArray[np.float64]
Loss = Literal["huber", "tukey"]
USUAL = {"huber": 1.345, "tukey": 4.685}  # 95 % efficiency for normal errors
WIDEST = 1e6  # standard deviations
HELD = 10  # steps after which the scales stay: the median need not settle
CLOSE, ROUGH = 1e-2, 1e-1  # step, in standard errors of all parameters together, that ends the iteration; of a start
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

    needs_samples: ClassVar[bool] = True
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
        rows, z = BaseRows.of(regression, solve(factor, rank).value, rank), np.zeros(rank.rank)
        if self.loss == "tukey":
            z = self._settled(problem, rows, _Huber(USUAL["huber"]), z, ROUGH).z
        psi = (_Huber if self.loss == "huber" else _Tukey)(self.tuning or USUAL[self.loss])
        found = self._settled(problem, rows, psi, z, CLOSE)
        fit, little = _fit(problem, found, psi, rank)
        few = tuple((problem.model.joints[j].name, float(little[j])) for j in np.flatnonzero(little > MANY))
        notes: list[Note] = [Downweighted(few)] if few else []
        notes += [StillMoving(self.iterations, found.moved)] if found.moved > CLOSE else []
        return replace(fit, notes=tuple(notes))

    def quick(self) -> LeastSquares:
        """Return least squares: what searches compare is a sum of squares, too."""
        return LeastSquares(weights="per_joint")

    def _settled(self, problem: Problem, rows: BaseRows, psi: _Huber | _Tukey, z: Array, close: float) -> _Settled:
        """Return where the iteration from z (r) ends."""
        errors, scale, moved = rows.errors(z), np.zeros(0), np.inf
        for k in range(self.iterations):
            problem.progress(Step("weighting the rows anew", k, self.iterations))
            scale = errors.scale(problem.regression) if k < HELD else scale
            weights = [psi.weights(one / scale) for one in errors.left]
            variance, trust, _ = _moments(errors, scale, psi)
            step, moved = rows.step(weights, errors.left, 1.0 / _variance(variance * trust, scale))
            z = z + step
            errors = rows.errors(z)
            if moved <= close:
                break
        return _Settled(z, errors, scale, moved)


@dataclass(frozen=True, eq=False)
class _Settled:
    """The end ``z`` (r) of an iteration, the ``errors`` there, their ``scale`` (n), and the last step in standard
    errors."""

    z: Array
    errors: RowErrors
    scale: Array
    moved: float

    __repr__ = brief


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


def _fit(problem: Problem, at: _Settled, psi: _Huber | _Tukey, rank: Rank) -> tuple[LinearFit, Array]:
    """Return the fit with the weights of the last residuals, and the share (n) of torques that count little."""
    regression, errors, parameters = problem.regression, at.errors, problem.model.parameters
    u = [left / at.scale for left in errors.left]
    w, slopes = [psi.weights(one) for one in u], [psi.slopes(one) for one in u]
    variance, trust, least = _moments(errors, at.scale, psi)
    given = regression.weights or tuple(np.ones_like(one) for one in w)
    rows = replace(regression, weights=tuple(g * np.sqrt(one) for g, one in zip(given, w, strict=True)))
    triangular = rows.triangular_factors
    total, p = triangular.total, len(parameters)
    sigma = np.sqrt(_variance(variance * trust, at.scale) * total / max(total - rank.rank, 1))
    factor = triangular.stacked(1.0 / sigma)
    directions = rank_of(factor, parameters, None, rank)
    factor[p, p] = np.sqrt(max(total - directions.rank, 1))  # the variance of a row is one
    curved = tuple(np.square(g) * np.maximum(one, 0.0) * least for g, one in zip(given, slopes, strict=True))
    little = [float(np.mean(one < HALF)) if len(one) else 0.0 for one in errors.by_joint(w)]
    return LinearFit(factor, directions, total, 1.0 / sigma, rows.weights, curved, sigma=sigma), np.array(little)


def _variance(variance: Array, scale: Array) -> Array:
    """Return a variance (n) that is not below rounding of the scale."""
    return np.asarray(np.maximum(variance, np.square(ROUNDING * scale)))


def _moments(errors: RowErrors, scale: Array, psi: _Huber | _Tukey) -> tuple[Array, Array, Array]:
    """Return of each joint (n) the variance s^2 mean(psi^2) / mean(psi')^2 of an error that counts as much, the mean
    weight, and what slopes that are not negative are multiplied with, to have the mean of all."""
    variance, trust, least = np.square(scale), np.ones_like(scale), np.ones_like(scale)
    for j, own in enumerate(errors.by_joint(errors.left)):
        if len(own):
            u = own / scale[j]
            weight, slope = psi.weights(u), psi.slopes(u)
            mean = max(float(slope.mean()), FLATTEST)
            variance[j] *= float(np.mean(np.square(weight * u))) / mean**2
            trust[j] = float(weight.mean())
            least[j] = mean / max(float(np.maximum(slope, 0.0).mean()), FLATTEST)
    return variance, trust, least
