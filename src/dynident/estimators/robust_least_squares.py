"""Least squares that is robust to outliers of the torque: M-estimates by iteratively reweighted least squares."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt, Le
from numpy.typing import NDArray

from dynident.estimators.estimator import Problem
from dynident.estimators.least_squares import (
    MAX_ITERATIONS,
    ROUNDING,
    LinearFit,
    SampledEstimator,
    rounding_floor,
    rows_by_joint,
)
from dynident.estimators.notes import Downweighted, StillMoving
from dynident.regression import Rank, Regression, one_thread, rank_of
from dynident.runtime import Note, Noun, Step, report_progress, settings_text
from dynident.runtime.arrays import Array

Mask = NDArray[np.bool_]
MAX_KEPT_BYTES = 2**28  # bytes of rows that are kept
NORMAL_MAD = 0.6744897501960817  # median absolute deviation of a standard normal error


class RowErrors(Noun):
    """The residuals of each motion (N, n), and which torques are fitted (N, n)."""

    residuals: tuple[Array, ...]
    is_fitted: tuple[Mask, ...]

    @classmethod
    def of(cls, regression: Regression, blocks: Iterable[tuple[int, slice, Array, Mask | None]]) -> RowErrors:
        """Collect the residuals of blocks (B, n).

        Where a filter decimates, samples between get the residual before them.
        """
        residuals = tuple(np.zeros(motion.q.shape) for motion in regression.motions)
        is_fitted = tuple(np.zeros(motion.q.shape, dtype=bool) for motion in regression.motions)
        for k, rows, error, keep in blocks:
            span = slice(rows.start, rows.stop)
            residuals[k][span] = np.repeat(error, rows.step or 1, axis=0)[: len(residuals[k][span])]
            is_fitted[k][rows] = True if keep is None else keep
        return cls(residuals, is_fitted)

    def scale(self, regression: Regression) -> Array:
        """Return the scale (n) of each joint by the median of its absolute residuals, not below rounding."""
        deviations = [
            np.median(np.abs(residual)) / NORMAL_MAD if len(residual) else 0.0
            for residual in self.by_joint(self.residuals)
        ]
        return np.maximum(deviations, rounding_floor(regression.triangular_factors))

    def by_joint(self, values: Sequence[Array]) -> list[Array]:
        """Return the fitted ones of the values (N, n) of each motion, joint by joint."""
        pairs = list(zip(values, self.is_fitted, strict=True))
        return [np.concatenate([array[mask[:, j], j] for array, mask in pairs]) for j in range(values[0].shape[1])]


class _RowBlock(Noun):
    """Rows ``rows`` of the motion with index ``motion``.

    The columns ``Q`` (B, n, r), the torque ``y`` (B, n), and which entries are fitted, ``keep`` (B, n), None for
    all.
    """

    motion: int
    rows: slice
    Q: Array
    y: Array
    keep: Mask | None


class BaseRows(Noun):
    """The rows of a regression along ``directions`` (p, r), with the torque residuals of a ``start`` (p).

    ``cached_blocks`` are the blocks, where they fit into memory; else they are computed on every call.
    """

    regression: Regression
    start: Array
    directions: Array
    cached_blocks: tuple[_RowBlock, ...] | None = None

    @classmethod
    def of(cls, regression: Regression, start: Array, rank: Rank) -> BaseRows:
        """Return the rows along the directions that a rank determines."""
        rows = cls(regression, start, rank.determined_directions / rank.values[: rank.rank])
        decimation = 1 if regression.filter is None else regression.filter.decimate
        size = sum(motion.q.size for motion in regression.motions) // decimation * rank.rank * 8
        return rows if size > MAX_KEPT_BYTES else replace(rows, cached_blocks=tuple(rows.blocks()))

    def value(self, z: Array) -> Array:
        """Return the parameters (p) at coordinates z (r) from the start."""
        return np.asarray(self.start + self.directions @ z)

    def blocks(self) -> Iterator[_RowBlock]:
        """Yield the blocks."""
        if self.cached_blocks is not None:
            yield from self.cached_blocks
            return
        for k, rows, block in self.regression.placed_blocks(self.regression.structure, self.start):
            keep = None if block.keep is None else block.keep.T
            yield _RowBlock(k, rows, np.ascontiguousarray(block.regressor(self.directions)), block.tau.T, keep)

    def errors(self, z: Array) -> RowErrors:
        """Return the torque residuals of the parameters at coordinates z (r) from the start."""
        blocks = ((block.motion, block.rows, block.y - block.Q @ z, block.keep) for block in self.blocks())
        return RowErrors.of(self.regression, blocks)

    def step(self, weights: Sequence[Array], residuals: Sequence[Array], joints: Array) -> tuple[Array, float]:
        """Return the step (r) to the weighted solution, and its length in standard errors.

        Rows are weighted by ``weights`` (N, n) of each motion and ``joints`` (n); ``residuals`` (N, n) are those of
        the current value. The length is in standard errors where ``joints`` are one over the variances.
        """
        r = self.directions.shape[1]
        normal, pull = np.zeros((r, r)), np.zeros(r)
        # small products, many times: threads of the linear algebra cost more than they gain
        with one_thread():
            for block in self.blocks():
                w = weights[block.motion][block.rows] * joints
                w = (w if block.keep is None else w * block.keep).ravel()
                Q = block.Q.reshape(-1, r)
                normal += Q.T @ (Q * w[:, None])
                pull += Q.T @ (w * residuals[block.motion][block.rows].ravel())
        step: Array = np.asarray(np.linalg.lstsq(normal, pull)[0], dtype=np.float64)
        return step, float(np.sqrt(np.abs(step @ normal @ step)))


Loss = Literal["huber", "tukey"]
DEFAULT_TUNING = {"huber": 1.345, "tukey": 4.685}  # 95 % efficiency for normal errors
MAX_TUNING = 1e6  # standard deviations
SCALE_STEPS = 10  # steps after which the scales stay: the median need not settle
# step, in standard errors of all parameters together, that ends the iteration; of a start
CONVERGED_STEP, ROUGH_STEP = 1e-2, 1e-1
MIN_MEAN_SLOPE = 0.1  # mean slope of psi: less, and the iteration has lost the data
LOW_WEIGHT, MAX_DOWNWEIGHTED_SHARE = 0.5, 0.05  # a torque that counts less than half; share of them that is said


@dataclass(frozen=True)
class RobustLeastSquares(SampledEstimator):
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
    >>> from dynident.models.lagrangian import pendulum
    >>> arm, t, rng = pendulum(), np.arange(1001) * 0.01, np.random.default_rng(0)
    >>> motion = dy.simulate(arm, arm.values, lambda s: [np.sin(5 * s)], t)
    >>> log = dy.record(motion, sigma_q=1e-4, sigma_tau=0.01, rng=rng).log
    >>> wrong = np.where(rng.random((1001, 1)) < 0.1, log.tau + 5.0, log.tau)
    >>> log = dy.Log(t, log.q, wrong, log.joints)
    >>> for estimator in (dy.LeastSquares(), dy.RobustLeastSquares("tukey")):
    ...     found = dy.identify(arm, log, smoother=dy.Spline(sigma=1e-4), estimator=estimator)
    ...     print(", ".join(f"{value:.4f}" for value in found.estimate.value))
    0.0832, 0.2524
    0.0824, 0.2497
    """

    loss: Loss = "huber"
    tuning: Annotated[float, Gt(0), Le(MAX_TUNING)] | None = None
    iterations: Annotated[int, Ge(1), Le(MAX_ITERATIONS)] = 50

    def reduced(self, problem: Problem) -> LinearFit:
        """Return the rows with the weights of the last step.

        Notes tell where many torques count little, and where the iteration did not settle.
        """
        plain = rows_by_joint(problem)
        rank = plain.directions
        rows, z = BaseRows.of(problem.regression, plain.solution.value, rank), np.zeros(rank.rank)
        # Tukey's loss has several minima: the fit with Huber's loss, which has one, is close to the right one
        if self.loss == "tukey":
            z = self._iterate(problem, rows, _Huber(DEFAULT_TUNING["huber"]), z, ROUGH_STEP).z
        psi = (_Huber if self.loss == "huber" else _Tukey)(self.tuning or DEFAULT_TUNING[self.loss])
        solution = self._iterate(problem, rows, psi, z, CONVERGED_STEP)
        fit, low_share = _weighted_fit(problem, solution, psi, rank)
        downweighted = tuple(
            (problem.model.joints[j].name, float(low_share[j]))
            for j in np.flatnonzero(low_share > MAX_DOWNWEIGHTED_SHARE)
        )
        notes: list[Note] = [Downweighted(downweighted)] if downweighted else []
        notes += [StillMoving(self.iterations, solution.step_size)] if solution.step_size > CONVERGED_STEP else []
        return replace(fit, notes=tuple(notes))

    def _iterate(
        self, problem: Problem, rows: BaseRows, psi: _Huber | _Tukey, z: Array, tolerance: float
    ) -> _RobustSolution:
        """Iterate from z (r) until a step is below ``tolerance``, in standard errors."""
        errors, scale, step_size = rows.errors(z), np.zeros(0), np.inf
        for k in range(self.iterations):
            report_progress(Step("weighting the rows anew", k, self.iterations))
            # the median of the residuals need not settle; with constant scales the iteration must
            scale = errors.scale(problem.regression) if k < SCALE_STEPS else scale
            weights = [psi.weights(residual / scale) for residual in errors.residuals]
            variance, trust, _ = _psi_moments(errors, scale, psi)
            step, step_size = rows.step(weights, errors.residuals, 1.0 / _bounded_variance(variance * trust, scale))
            z = z + step
            errors = rows.errors(z)
            if step_size <= tolerance:
                break
        return _RobustSolution(z, errors, scale, step_size)

    def __str__(self) -> str:
        name = {"huber": "Huber's", "tukey": "Tukey's"}[self.loss]
        return settings_text(f"robust least squares, {name} weights", self, ("loss",))


class _RobustSolution(Noun):
    """The end ``z`` (r) of an iteration, the ``errors`` there, their ``scale`` (n), and the last ``step_size``.

    The step is in standard errors of all parameters together.
    """

    z: Array
    errors: RowErrors
    scale: Array
    step_size: float


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


def _weighted_fit(
    problem: Problem, solution: _RobustSolution, psi: _Huber | _Tukey, rank: Rank
) -> tuple[LinearFit, Array]:
    """Return the fit with the weights of the last residuals, and the share (n) of torques that count little."""
    regression, errors, parameters = problem.regression, solution.errors, problem.model.parameters
    u = [residual / solution.scale for residual in errors.residuals]
    w, slopes = [psi.weights(array) for array in u], [psi.slopes(array) for array in u]
    variance, trust, slope_factor = _psi_moments(errors, solution.scale, psi)
    sample_weights = regression.weights or tuple(np.ones_like(array) for array in w)
    rows = replace(regression, weights=tuple(g * np.sqrt(array) for g, array in zip(sample_weights, w, strict=True)))
    triangular = rows.triangular_factors
    total, p = triangular.total, len(parameters)
    # the degrees of freedom count once for all joints, as in least squares
    sigma = np.sqrt(_bounded_variance(variance * trust, solution.scale) * total / max(total - rank.rank, 1))
    factor = triangular.stack(1.0 / sigma)
    directions = rank_of(factor, parameters, None, rank)
    factor[p, p] = np.sqrt(max(total - directions.rank, 1))  # the variance of a row is one
    # negative slopes would make the curvature indefinite: they are cut off, and the others keep the mean of all
    curved = tuple(
        np.square(g) * np.maximum(array, 0.0) * slope_factor for g, array in zip(sample_weights, slopes, strict=True)
    )
    low_share = [float(np.mean(array < LOW_WEIGHT)) if len(array) else 0.0 for array in errors.by_joint(w)]
    return LinearFit(factor, directions, total, 1.0 / sigma, rows.weights, curved, sigma=sigma), np.array(low_share)


def _bounded_variance(variance: Array, scale: Array) -> Array:
    """Return a variance (n) that is not below rounding of the scale."""
    return np.asarray(np.maximum(variance, np.square(ROUNDING * scale)))


def _psi_moments(errors: RowErrors, scale: Array, psi: _Huber | _Tukey) -> tuple[Array, Array, Array]:
    """Return the moments of psi for each joint (n): error variance, mean weight, and a factor of the slopes.

    The variance s^2 mean(psi^2) / mean(psi')^2 is that of a normal error of equal effect. Nonnegative slopes are
    multiplied by the factor to get the mean of all slopes.
    """
    variance, trust, slope_factor = np.square(scale), np.ones_like(scale), np.ones_like(scale)
    for j, residual in enumerate(errors.by_joint(errors.residuals)):
        if len(residual):
            u = residual / scale[j]
            weight, slope = psi.weights(u), psi.slopes(u)
            # where nearly all residuals lie on the flat part of psi, the variance formula would blow up
            mean = max(float(slope.mean()), MIN_MEAN_SLOPE)
            variance[j] *= float(np.mean(np.square(weight * u))) / mean**2
            trust[j] = float(weight.mean())
            slope_factor[j] = mean / max(float(np.maximum(slope, 0.0).mean()), MIN_MEAN_SLOPE)
    return variance, trust, slope_factor
