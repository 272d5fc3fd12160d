"""Generalised least squares: an autoregressive noise of each joint, and the covariance of its innovations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from annotated_types import Ge, Gt, Le

from dynident.errors import ConfigError, changed
from dynident.estimators.estimator import Estimate, Problem
from dynident.estimators.feasible import check_feasible, feasible
from dynident.estimators.least_squares import COARSEST, MOST, LeastSquares
from dynident.estimators.linear import LinearFit, estimate_of

__all__ = ["GeneralisedLeastSquares"]

HIGHEST = 200  # order


@dataclass(frozen=True)
class GeneralisedLeastSquares:
    """Least squares for noise that is coloured in time and correlated between joints, (X' V^-1 X)^-1 X' V^-1 y.

    The noise of each joint is an autoregression, of the order with the least Bayesian information criterion up to
    ``max_order``; rows are prewhitened by it, and mixed by the covariance of the innovations of all joints. The noise
    is that of the residual of the fit itself, which is repeated until the parameters stand still, at most
    ``iterations`` times (Cochrane and Orcutt, 1949). ``tolerance`` is that of ``LeastSquares``. The covariance is
    s^2 (X' V^-1 X)^-1.

    It is the best linear fit where the residual is noise. Where it is what the model lacks, slow and following the
    motion, prewhitening takes the slow part of the torque away with it, and fits what is left, where noise of the
    smoothed motion is largest. A note says where the whitened residual is still coloured; where the fit leaves 1.1
    times as much of the torque of a joint as least squares, the iteration ends, and another says whether 99 simulations
    of the noise explain it (Hausman, 1978).

    >>> from dataclasses import replace
    >>> import numpy as np
    >>> from scipy.signal import lfilter
    >>> import dynident as dy
    >>> from dynident.models.gallery import pendulum
    >>> arm, t, rng = pendulum(), np.arange(1001) * 0.01, np.random.default_rng(0)
    >>> motion = dy.simulate(arm, arm.values, lambda s: [np.sin(5 * s)], t)
    >>> log = dy.record(motion, sigma_q=1e-8, sigma_tau=0.0, rng=rng).log
    >>> noise = lfilter([1.0], [1.0, -0.9], 0.01 * rng.standard_normal(1001))
    >>> log = replace(log, tau=log.tau + noise[:, None])
    >>> found = dy.identify(arm, log, smoother=dy.Spline(sigma=1e-8), estimator=dy.GeneralisedLeastSquares())
    >>> (a,) = found.estimate.residual.whitening.coefficients
    >>> print(a.round(2))
    [0.89]
    """

    max_order: Annotated[int, Ge(1), Le(HIGHEST)] = 20
    tolerance: Annotated[float, Gt(0), Le(COARSEST)] | None = None
    iterations: Annotated[int, Ge(1), Le(MOST)] = 10

    needs_samples: ClassVar[bool] = True
    __repr__ = changed

    def __post_init__(self) -> None:
        check_feasible(self.tolerance, self.iterations)
        if not 1 <= self.max_order <= HIGHEST:
            raise ConfigError(f"max_order = {self.max_order} of the noise; give a whole number from 1 to {HIGHEST}.")

    def __call__(self, problem: Problem) -> Estimate:
        """Estimate; notes say where the residual is more than noise."""
        return estimate_of(problem, self.reduced(problem))

    def reduced(self, problem: Problem) -> LinearFit:
        """Return the whitened rows."""
        return feasible(problem, self.max_order, self.iterations, self.tolerance)

    def quick(self) -> LeastSquares:
        """Return least squares with one weight for each joint."""
        return LeastSquares(self.tolerance, "per_joint")
