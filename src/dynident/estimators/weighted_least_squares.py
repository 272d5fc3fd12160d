"""Weighted least squares with the covariance of the noise between the joints, estimated from the residual."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from annotated_types import Ge, Gt, Le

from dynident.errors import changed
from dynident.estimators.estimator import Estimate, Problem
from dynident.estimators.feasible import check_feasible, feasible
from dynident.estimators.least_squares import COARSEST, MOST, LeastSquares
from dynident.estimators.linear import LinearFit, estimate_of

__all__ = ["WeightedLeastSquares"]


@dataclass(frozen=True)
class WeightedLeastSquares:
    """Least squares weighted by the noise of all joints and its correlation between them, (X' V^-1 X)^-1 X' V^-1 y.

    The covariance S (n, n) of V is that of the residual of the fit itself, which is repeated until the parameters stand
    still (Zellner, 1962; in robotics with variances alone: Gautier, 1997). Correlations that may be chance are drawn to
    zero, or left out. The noise is taken as white in time, as ``GeneralisedLeastSquares`` does not. ``tolerance`` is
    that of ``LeastSquares``, ``iterations`` the largest number of fits. The covariance is s^2 (X' V^-1 X)^-1.

    >>> import numpy as np
    >>> import dynident as dy
    >>> from dynident.models.gallery import two_link_arm
    >>> arm, t, rng = two_link_arm(), np.arange(1001) * 0.01, np.random.default_rng(0)
    >>> motion = dy.simulate(arm, arm.values, lambda s: [np.sin(3 * s), np.cos(5 * s)], t)
    >>> log = dy.record(motion, sigma_q=1e-5, sigma_tau=0.01, rng=rng).log
    >>> found = dy.identify(arm, log, smoother=dy.Spline(sigma=1e-5), estimator=dy.WeightedLeastSquares())
    >>> found.estimate.residual.whitening.orders
    (0, 0)
    """

    tolerance: Annotated[float, Gt(0), Le(COARSEST)] | None = None
    iterations: Annotated[int, Ge(1), Le(MOST)] = 10

    needs_samples: ClassVar[bool] = True
    __repr__ = changed

    def __post_init__(self) -> None:
        check_feasible(self.tolerance, self.iterations)

    def __call__(self, problem: Problem) -> Estimate:
        """Estimate; a note says where whitening leaves much more of the torque than least squares."""
        return estimate_of(problem, self.reduced(problem))

    def reduced(self, problem: Problem) -> LinearFit:
        """Return the rows, mixed so that their noise is independent."""
        return feasible(problem, 0, self.iterations, self.tolerance)

    def quick(self) -> LeastSquares:
        """Return least squares with one weight for each joint."""
        return LeastSquares(self.tolerance, "per_joint")
