"""Maximum likelihood of eq. (7): errors in positions and torques alike, on a spline trajectory."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Literal, get_args

import numpy as np
from annotated_types import Ge, Gt, Le, Lt
from numpy.typing import NDArray

from dynident.errors import ConfigError, InputError, ModelError, Note, changed, choices
from dynident.estimators.constraints import Barrier, bodies_of
from dynident.estimators.estimator import Consistency, Determined, Estimate, Problem, Provenance, Residual
from dynident.estimators.least_squares import LeastSquares, weighted
from dynident.estimators.maximum_likelihood.findings import residual_notes, undetermined_notes
from dynident.estimators.maximum_likelihood.friction import has_sign
from dynident.estimators.maximum_likelihood.measured import feasible, misfit, recordings, usual_noise
from dynident.estimators.maximum_likelihood.newton import LikelihoodFit, NewtonSettings
from dynident.estimators.maximum_likelihood.physics import movable, psd_constraints
from dynident.estimators.maximum_likelihood.search import Search
from dynident.estimators.maximum_likelihood.segment import Sigma
from dynident.estimators.notes import Failed, MovingStart, NotConverged, SmoothSigns
from dynident.estimators.physically_consistent import PhysicallyConsistent
from dynident.regression import Rank, rank_of
from dynident.splines import NORMAL_95

__all__ = ["MaximumLikelihood"]

Array = NDArray[np.float64]
Start = Literal["free", "rest", "test"]
DEEP = 0.8  # slack of a second start, relative to the usual size
ROUGH = 100.0  # factor of the tolerance while the noise is only roughly known
FINEST = 0.25  # samples between knots: finer ones follow nothing that was measured
WIDEST = 1e6  # standard deviations, or times the value
SLOWEST = 1e-3  # Hz
ROUNDS, MOST = 20, 1000  # of the noise; iterations
LEVEL = 0.01  # of the test whether the recordings start from rest
ROUNDING = 1e-15  # an undetermined parameter smaller than this share of the largest is set to zero


@dataclass(frozen=True)
class MaximumLikelihood:
    """The trajectory and theta that maximise the likelihood of measured positions and torques: article, eq. (7).

    ``start``: "rest" where the recordings start from rest, "test" to decide this by a likelihood ratio test at the 1 %
    level, "free" where they may start in motion. ``spacing`` (samples) of the knots away from steps of the torque; None
    halves it from 80, or less in short recordings, until the residuals of the positions are white, or, where they never
    are, until the torque no longer improves.
    ``steps``: whether to search for steps of the torque; None does so unless the model has Coulomb friction, whose
    reversals look like steps. A start from rest counts as a step. ``huber`` (standard deviations, such as 1.345) bounds
    the influence of a torque sample. ``rounds``: how often the noise of each joint's position and torque is estimated.
    Parameters whose standard error exceeds the share ``profile`` of their value get intervals by profile likelihood;
    with None all intervals are symmetric. ``rate`` (Hz): faster recordings are averaged down to it; None keeps them.

    The iteration starts from least squares, or from the physically consistent fit for bodies, moved into the feasible
    set; where it fails, the start is returned, with a note. The discontinuous sign of Coulomb friction is smoothed over
    the uncertainty of the velocity. The ``weight`` of the barrier that keeps inertia and friction physical is in units
    of half a squared standard deviation. ``iterations`` and ``tolerance`` (expected decrease of the cost, in the same
    units) end the iteration.

    Calling it with a ``Problem`` gives an ``Estimate``. Raises ConfigError for bad settings.

    >>> import numpy as np
    >>> import dynident as dy
    >>> from dynident.models.gallery import pendulum
    >>> arm, t, rng = pendulum(), np.arange(1001) * 0.01, np.random.default_rng(0)
    >>> motion = dy.simulate(arm, arm.values, lambda s: [np.sin(5 * s)], t)
    >>> log = dy.record(motion, sigma_q=1e-4, sigma_tau=0.01, rng=rng).log
    >>> found = dy.identify(arm, log, smoother=dy.Spline(sigma=1e-4), estimator=dy.MaximumLikelihood(start="rest"))
    >>> for name, value, std in zip(arm.names, found.estimate.value, found.estimate.std):
    ...     print(f"{name} = {value:.4f} +- {std:.5f}")
    J = 0.0824 +- 0.00005
    h = 0.2497 +- 0.00014
    """

    start: Start = "free"
    spacing: Annotated[float, Ge(FINEST)] | None = None
    steps: bool | None = None
    huber: Annotated[float, Gt(0), Le(WIDEST)] | None = None
    rounds: Annotated[int, Ge(1), Le(ROUNDS)] = 2
    profile: Annotated[float, Gt(0), Le(WIDEST)] | None = 0.4
    weight: Annotated[float, Gt(0), Lt(1)] = 1e-3
    tolerance: Annotated[float, Gt(0), Lt(1)] = 1e-5
    iterations: Annotated[int, Ge(1), Le(MOST)] = 60
    rate: Annotated[float, Ge(SLOWEST)] | None = 1100.0

    needs_samples: ClassVar[bool] = True
    __repr__ = changed

    def __post_init__(self) -> None:
        if self.start not in get_args(Start):
            raise ConfigError(f"start = {self.start!r}; {choices(self.start, get_args(Start))}")
        for name, least, most in (
            ("spacing", FINEST, np.inf),
            ("huber", 0.0, WIDEST),
            ("profile", 0.0, WIDEST),
            ("rate", SLOWEST, np.inf),
        ):
            value = getattr(self, name)
            if value is not None and not (0 < value < np.inf and least <= value <= most):
                raise ConfigError(f"{name} = {value}; give a positive number{_range(least, most)}, or leave it out.")
        for name, most in (("rounds", ROUNDS), ("iterations", MOST)):
            if not 1 <= getattr(self, name) <= most:
                raise ConfigError(f"{name} = {getattr(self, name)}; give a whole number from 1 to {most}.")
        for name in ("weight", "tolerance"):
            if not 0 < getattr(self, name) < 1:
                raise ConfigError(f"{name} = {getattr(self, name)}; give a number between 0 and 1, such as 1e-3.")

    def __call__(self, problem: Problem) -> Estimate:
        """Estimate, with notes on the iteration. Raises ConfigError, InputError and ModelError as the start does."""
        model = problem.model
        start = PhysicallyConsistent(costs=False)(problem) if bodies_of(model.parameters) else LeastSquares()(problem)
        fallback = start
        try:
            run = _Run.begin(self, problem, start)
            fallback = replace(start, value=run.search.theta)  # the nearest feasible point
            return run.estimate()
        except (ModelError, InputError, np.linalg.LinAlgError) as error:
            return replace(fallback, notes=(Failed(str(error)), *fallback.notes))

    def quick(self) -> LeastSquares:
        """Return least squares: fitting the trajectory takes too long for a search."""
        return LeastSquares()


def _range(least: float, most: float) -> str:
    """Return the limits of a setting as text, where there are any."""
    return (f" of at least {least:g}" if least else "") + (f" of at most {most:g}" if most < np.inf else "")


@dataclass(eq=False)
class _Run:
    """One estimation in progress: the search and its notes."""

    settings: MaximumLikelihood
    problem: Problem
    start: Estimate
    search: Search
    notes: list[Note]

    @classmethod
    def begin(cls, settings: MaximumLikelihood, problem: Problem, start: Estimate) -> _Run:
        """Return the run with its data, a first estimate of the noise, and a feasible start."""
        model = problem.model
        coulomb = any(parameter.role == "coulomb" for parameter in model.parameters)
        look = not coulomb if settings.steps is None else settings.steps
        given, notes = recordings(problem, settings.rate, steps=look)
        barrier, directions = movable(
            Barrier(psd_constraints(model, given.logs, start.value), settings.weight),
            rank_of(problem.regression.triangular_factors.stacked(), model.parameters),
        )
        theta = feasible(start.value, problem, barrier.psd_constraints)
        sigma_q, sigma_tau = usual_noise(given.logs)
        sigma_tau = np.maximum(sigma_tau, misfit(problem, theta))  # the misfit of the model counts as noise
        bodies = any(parameter.body for parameter in model.parameters)
        limits = NewtonSettings(settings.tolerance, settings.iterations, newton=not bodies)
        sigma = Sigma(sigma_q, sigma_tau)
        search = Search(model, given, barrier, limits, directions, theta, sigma, progress=problem.progress)
        return cls(settings, problem, start, search, notes)

    def estimate(self) -> Estimate:
        """Fit, test for a start from rest where that is configured, and return the estimate."""
        fitted = self.fitted()
        if self.settings.start == "test" and (chance := self.from_rest(fitted)) < LEVEL:
            # knots, noise and theta must be found anew
            moving = _Run.begin(replace(self.settings, start="free"), self.problem, self.start)
            moving.notes.append(MovingStart(chance))
            return moving.estimate()
        if not fitted.converged:
            self.notes.append(NotConverged(fitted.iterations, float(abs(fitted.decrement) / 2)))
        return self.to_estimate(fitted)

    def fitted(self) -> LikelihoodFit:
        """Choose the knots, fit with a better noise estimate each round, and restart once where that fails."""
        search, settings = self.search, self.settings
        rest = settings.start != "free"
        search.choose_knots(settings.spacing, rest=rest, condense=settings.huber is None)
        if has_sign(search.model) and (widths := search.smooth_signs()):
            self.notes.append(SmoothSigns(widths))
        fitted = search.run(hold=2, loose=ROUGH if settings.rounds > 1 else 1.0)
        for _ in range(settings.rounds - 1):
            search.reweight(settings.huber, fitted)
            fitted = search.run()
        bodies = not search.settings.newton  # some parameters of bodies are never determined
        undetermined = bool(self.directions(fitted).undetermined.any()) and not bodies
        return fitted if fitted.converged and not undetermined else self.restarted(fitted)

    def directions(self, fitted: LikelihoodFit) -> Rank:
        """Return what the information determines of the directions that the smoothed motions show."""
        triangular = self.problem.regression.triangular_factors
        _, rank = weighted(triangular, 1.0 / self.search.sigma.tau, self.problem.model.parameters)
        return rank.within(fitted.information)

    def restarted(self, fitted: LikelihoodFit) -> LikelihoodFit:
        """Search once more from well inside the feasible set, and return the more likely result."""
        deep = feasible(self.start.value, self.problem, self.search.barrier.psd_constraints, DEEP)
        other = self.search.searched(deep, self.search.states, hold=3)
        better = other.converged and (other.cost < fitted.cost or not fitted.converged)
        return self.search.moved_to(other if better else fitted)

    def from_rest(self, fitted: LikelihoodFit) -> float:
        """Return the p-value of the likelihood ratio test that the recordings start from rest."""
        from scipy.stats import chi2

        free = self.search.with_free_start().run()
        gain, degrees = 2 * (fitted.cost - free.cost), len(self.search.segments) * len(self.search.sigma.q)
        return float(chi2.sf(max(gain, 0.0), degrees))

    def intervals(self, fitted: LikelihoodFit, covariance: Array) -> Array:
        """Return the 95 % intervals (p, 2): along profile likelihoods where a standard error is large, else symmetric.

        Each parameter uses the profile of the parameter with a large standard error that it is most correlated with.
        """
        std, share = np.sqrt(np.diag(covariance)), self.settings.profile
        out = fitted.theta[:, None] + NORMAL_95 * std[:, None] * np.array([-1.0, 1.0])
        asked = share is not None and bool(np.isfinite(std).all())
        weak = np.flatnonzero(std > (share or np.inf) * np.abs(fitted.theta))
        if asked and len(weak):
            correlation = np.abs(covariance[:, weak]) / np.outer(std, std[weak])
            leader = np.argmax(correlation, axis=1)
            for at, k in enumerate(weak):
                out[leader == at] = self.search.profiled(fitted, covariance, int(k))[leader == at]
        return np.asarray(out)

    def to_estimate(self, fitted: LikelihoodFit) -> Estimate:
        """Return the estimate of a fit, with covariance, intervals and notes."""
        model, search = self.problem.model, self.search
        tau = search.residuals()[1]
        directions = self.directions(fitted)
        inverse, rank, undetermined = directions.inverse, directions.rank, directions.undetermined
        covariance = directions.covariance()
        provenance = self.provenance(undetermined) if bodies_of(model.parameters) else ()
        notes = (*self.notes, *residual_notes(search, fitted, model.names, inverse, undetermined, tau))
        used = sum((one.raw.weight > 0).sum(axis=0) for one in search.segments)
        nothing = undetermined & (np.abs(fitted.theta) <= ROUNDING * np.abs(fitted.theta).max())
        bodies = bodies_of(model.parameters)
        smallest = {body.name: float(np.linalg.eigvalsh(body.scaled(fitted.theta))[0]) for body in bodies}
        return Estimate(
            parameters=model.parameters,
            value=np.where(nothing, 0.0, fitted.theta),
            covariance=covariance,
            determined=Determined(rank, directions.condition, directions),
            residual=Residual(
                np.sqrt(sum((x**2).sum(axis=0) for x in tau) / np.maximum(used, 1)) * search.sigma.tau,
                sum(map(len, search.given.logs)),
                1.0 / search.sigma.tau,
            ),
            notes=(*notes, *undetermined_notes(model.names, undetermined, rank, provenance)),
            provenance=provenance,
            consistency=Consistency(smallest) if smallest else None,
            interval=self.intervals(fitted, covariance) if fitted.converged else None,
            information=fitted.information,
        )

    def provenance(self, undetermined: NDArray[np.bool_]) -> tuple[Provenance, ...]:
        """Return what determines each parameter; where not the data, the provenance is that of the start."""
        data, prior = Provenance.DATA, Provenance.PRIOR
        pairs = zip(undetermined, self.start.provenance, strict=True)
        return tuple((prior if was is data else was) if gone else data for gone, was in pairs)
