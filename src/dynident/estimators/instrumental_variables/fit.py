"""Instrumental variables (IDIM-IV): theta = (W' X)^-1 W' y, where the noise of W is not that of X and y."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, get_args

from annotated_types import Ge, Gt, Le

from dynident.errors import ConfigError, changed, choices
from dynident.estimators.estimator import Estimate, Problem
from dynident.estimators.instrumental_variables.run import Run, Source
from dynident.estimators.least_squares import MOST, LeastSquares, Weights, check_weights, joint_weights, weighted
from dynident.estimators.linear import LinearFit, estimate_of, solve

__all__ = ["InstrumentalVariables"]

LONGEST = 1e3  # s


@dataclass(frozen=True)
class InstrumentalVariables:
    """Instrumental variables, theta = (W' D^2 X)^-1 W' D^2 y, consistent although noise is in the regressor X.

    W is the regressor of a motion whose errors are not those of X, D holds the ``weights`` of the joints. Which motion
    is said by ``instruments``: "simulated" is what the model makes under the same reference in the loop of the recorded
    controller, begun with least squares and repeated until theta stays (at most ``iterations``): it is consistent also
    where the loop feeds noise and disturbances back. "repeated" is another pass of the same motion, in another training
    recording or later in the same: consistent where the noise of the two is independent. "lagged" is interpolated from
    the motion a time ``lag`` (s) before and after: consistent where noise of the positions is not correlated over the
    lag, which by default is as long as smoother and filter spread white noise. Disturbances that move the joints remain
    a bias of the last two, and coloured noise one of the last. "auto" takes for each recording the first that it has;
    another pass must then share half of its samples, with the same speeds to 30 %.

    Where the model of least squares fails in the loop, the simulation begins with another one, and a note says with
    which. The covariance allows for residuals that are correlated in time and between joints, and counts the errors of
    the motion. A note says which instruments were used and how much they explain of the regressor.

    Calling it with a ``Problem`` gives an ``Estimate``. Raises MissingInputError where a recording lacks what the
    instruments need, InputError where the model fails in the loop, ConfigError for bad settings. Reference: Janot,
    Vandanjon and Gautier (2014).

    Of positions with much noise, least squares with difference quotients finds too small an inertia:

    >>> import numpy as np
    >>> import dynident as dy
    >>> from dynident.models.gallery import pendulum
    >>> arm, t, rng = pendulum(), np.arange(4001) * 0.01, np.random.default_rng(0)
    >>> motion = dy.simulate(arm, arm.values, lambda s: [np.sin(2 * s) + np.sin(3 * s)], t)
    >>> log = dy.record(motion, sigma_q=1e-3, sigma_tau=0.01, rng=rng).log
    >>> for estimator in (dy.LeastSquares(), dy.InstrumentalVariables()):
    ...     found = dy.identify(arm, log, recipe=dy.Recipe(smoother=dy.Difference(), estimator=estimator)).estimate
    ...     print(f"J = {found.value[0]:.3f} +- {found.std[0]:.3f}, is {arm.values[0]:.3f}")
    J = 0.016 +- 0.001, is 0.083
    J = 0.085 +- 0.006, is 0.083
    """

    instruments: Source = "auto"
    iterations: Annotated[int, Ge(1), Le(MOST)] = 10
    lag: Annotated[float, Gt(0), Le(LONGEST)] | None = None
    weights: Weights = "per_joint"

    needs_samples: ClassVar[bool] = True
    __repr__ = changed

    def __post_init__(self) -> None:
        if self.instruments not in get_args(Source):
            raise ConfigError(f"instruments = {self.instruments!r}; {choices(self.instruments, get_args(Source))}")
        check_weights(self.weights, self.iterations)
        if self.lag is not None and not 0 < self.lag <= LONGEST:
            raise ConfigError(f"lag = {self.lag} of the instruments; give a time (s) of at most {LONGEST:g}, or null.")

    def __call__(self, problem: Problem) -> Estimate:
        """Estimate; notes say which instruments were used and what the data do not determine."""
        return estimate_of(problem, self.reduced(problem))

    def reduced(self, problem: Problem) -> LinearFit:
        """Return the value with its information, as rows that constraints can be put on."""
        triangular, parameters = problem.regression.triangular_factors, problem.model.parameters
        weights = joint_weights(triangular, self.weights, 3, parameters)
        factor, rank = weighted(triangular, weights, parameters)
        if not rank.rank:
            return LinearFit(factor, rank, triangular.total, weights)
        start = solve(factor, rank).value
        fitted = Run(problem, self.instruments, self.iterations, self.lag, weights, rank, start).fit()
        return replace(fitted, weights=None) if self.weights == "equal" else fitted

    def quick(self) -> LeastSquares:
        """Return least squares: what a search varies matters more than noise in the regressor."""
        return LeastSquares(weights=self.weights)
