"""Maximum likelihood of eq. (7): errors in positions and torques alike, on a spline trajectory."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Literal, get_args

import numpy as np
from annotated_types import Ge, Gt, Lt
from numpy.typing import NDArray

from dynident.errors import ConfigError, InputError, ModelError, Note, choices
from dynident.estimators.constraints import Barrier, bodies_of
from dynident.estimators.estimator import Estimate, Problem, Provenance
from dynident.estimators.least_squares import LeastSquares
from dynident.estimators.maximum_likelihood.findings import residual_notes, undetermined_notes
from dynident.estimators.maximum_likelihood.friction import has_sign
from dynident.estimators.maximum_likelihood.measured import feasible, misfit, recordings, usual_noise
from dynident.estimators.maximum_likelihood.newton import LikelihoodFit, NewtonSettings
from dynident.estimators.maximum_likelihood.physics import psd_constraints
from dynident.estimators.maximum_likelihood.search import Search
from dynident.estimators.maximum_likelihood.segment import Sigma
from dynident.estimators.notes import Failed, MovingStart, NotConverged, SmoothSigns
from dynident.estimators.physically_consistent import PhysicallyConsistent
from dynident.regression import Rank, rank_of
from dynident.splines import NORMAL_95

__all__ = ["MaximumLikelihood"]

Array = NDArray[np.float64]
Positive = Annotated[float, Gt(0)]
Start = Literal["free", "rest", "test"]
DEEP = 0.8  # room to the boundary that a second start is given, relative to the usual size
ROUGH = 100.0  # factor of the tolerance while the noise is only roughly known
LEVEL = 0.01  # of the test whether the recordings start from rest
ROUNDING = 1e-15  # an undetermined parameter that is smaller than the largest by so much is nothing


@dataclass(frozen=True)
class MaximumLikelihood:
    """The trajectory and theta that make measured positions and torques most likely: article, eq. (7).

    ``start``: "rest" where the recordings start from standstill, "test" to decide it by a likelihood ratio at the level
    of 1 %, "free" where they may start in motion. ``spacing`` (samples) of the knots far from steps of the torque; None
    halves 80, or less in short recordings, until the positions are fitted to white residuals; where they never are, the
    torque decides.
    ``steps``: whether steps of the torque are looked for; None does so unless the model has Coulomb friction, whose
    reversals look like steps. A start from rest is one. ``huber`` (standard deviations, such as 1.345) bounds the pull
    of a torque sample. ``rounds`` of estimating the noise of each joint's position and torque. Parameters whose
    standard error exceeds the share ``profile`` of their value get intervals by profile likelihood; None leaves all
    symmetric. ``rate`` (Hz): faster recordings are thinned to it by means of neighbouring samples; None leaves all.

    The start is a fit of least squares, or the consistent one for bodies, moved to where physics allows it; where the
    iteration fails it is returned, and the status says so. Sharp signs of Coulomb friction are made as smooth as the
    velocities are known. The barrier ``weight`` that keeps inertia and friction physical is in units of half a squared
    standard deviation.
    """

    start: Start = "free"
    spacing: Positive | None = None
    steps: bool | None = None
    huber: Positive | None = None
    rounds: Annotated[int, Ge(1)] = 2
    profile: Positive | None = 0.4
    weight: Annotated[float, Gt(0), Lt(1)] = 1e-3
    tolerance: Annotated[float, Gt(0), Lt(1)] = 1e-3
    iterations: Annotated[int, Ge(1)] = 60
    rate: Positive | None = 1100.0

    def __post_init__(self) -> None:
        if self.start not in get_args(Start):
            raise ConfigError(f"start = {self.start!r}; {choices(self.start, get_args(Start))}")
        for name in ("spacing", "huber", "profile", "rate"):
            value = getattr(self, name)
            if value is not None and not 0 < value < np.inf:
                raise ConfigError(f"{name} = {value}; give a positive number, or leave it out.")
        for name in ("rounds", "iterations"):
            if getattr(self, name) < 1:
                raise ConfigError(f"{name} = {getattr(self, name)}; give a whole number from 1.")
        for name in ("weight", "tolerance"):
            if not 0 < getattr(self, name) < 1:
                raise ConfigError(f"{name} = {getattr(self, name)}; give a number between 0 and 1, such as 1e-3.")

    def __call__(self, problem: Problem) -> Estimate:
        """Estimate; notes say how it went. Raises ConfigError, InputError and ModelError as the start does."""
        model = problem.model
        start = PhysicallyConsistent(costs=False)(problem) if bodies_of(model.parameters) else LeastSquares()(problem)
        fallback = start
        try:
            run = _Run.begin(self, problem, start)
            fallback = replace(start, value=run.search.theta)  # as near to it as physics allows
            return run.estimate()
        except (ModelError, InputError, np.linalg.LinAlgError) as error:
            return replace(fallback, notes=(Failed(str(error)), *fallback.notes))

    def quick(self) -> LeastSquares:
        """Return least squares: the search for the trajectory takes too long to be repeated."""
        return LeastSquares()


@dataclass(eq=False)
class _Run:
    """One estimation on its way: the search, and what is to be said of it."""

    settings: MaximumLikelihood
    problem: Problem
    start: Estimate
    search: Search
    notes: list[Note]

    @classmethod
    def begin(cls, settings: MaximumLikelihood, problem: Problem, start: Estimate) -> _Run:
        """Return the run with its data, noise as far as it is known, and a start that physics allows."""
        model = problem.model
        coulomb = any(parameter.role == "coulomb" for parameter in model.parameters)
        look = not coulomb if settings.steps is None else settings.steps
        given, notes = recordings(problem, settings.rate, steps=look)
        barrier = Barrier(psd_constraints(model, given.logs, start.value), settings.weight)
        theta = feasible(start.value, problem, barrier.psd_constraints)
        sigma_q, sigma_tau = usual_noise(given.logs)
        sigma_tau = np.maximum(sigma_tau, misfit(problem, theta))  # what the model cannot explain counts as noise
        bodies = any(parameter.body for parameter in model.parameters)
        limits = NewtonSettings(settings.tolerance, settings.iterations, newton=not bodies)
        return cls(
            settings, problem, start, Search(model, given, barrier, limits, theta, Sigma(sigma_q, sigma_tau)), notes
        )

    def estimate(self) -> Estimate:
        """Fit, decide whether the recordings start from rest where that is asked, and tell."""
        fitted = self.fitted()
        if self.settings.start == "test" and (chance := self.from_rest(fitted)) < LEVEL:
            # knots, noise and theta are those of another motion
            moving = _Run.begin(replace(self.settings, start="free"), self.problem, self.start)
            moving.notes.append(MovingStart(chance))
            return moving.estimate()
        if not fitted.converged:
            self.notes.append(NotConverged(fitted.iterations, float(abs(fitted.decrement) / 2)))
        return self.to_estimate(fitted)

    def fitted(self) -> LikelihoodFit:
        """Lay out the segments, and fit with the noise known better each round; once more where that leads nowhere."""
        search, settings = self.search, self.settings
        rest = settings.start != "free"
        search.choose_knots(settings.spacing, rest=rest, condense=settings.huber is None)
        if has_sign(search.model) and (widths := search.smooth_signs()):
            self.notes.append(SmoothSigns(widths))
        fitted = search.run(hold=2, loose=ROUGH if settings.rounds > 1 else 1.0)
        for _ in range(settings.rounds - 1):
            search.reweight(settings.huber)
            fitted = search.run()
        bodies = not search.settings.newton  # some of their parameters are never determined
        undetermined = bool(self.directions(fitted).undetermined.any()) and not bodies
        return fitted if fitted.converged and not undetermined else self.restarted(fitted)

    def directions(self, fitted: LikelihoodFit) -> Rank:
        """Return what the information determines of the directions that the smoothed motions show."""
        factor = self.problem.regression.triangular_factors.stacked(1.0 / self.search.sigma.tau)
        return rank_of(factor, self.problem.model.parameters).within(fitted.information)

    def restarted(self, fitted: LikelihoodFit) -> LikelihoodFit:
        """Search once more from well inside of what physics allows, and keep the more likely end."""
        deep = feasible(self.start.value, self.problem, self.search.barrier.psd_constraints, DEEP)
        other = self.search.searched(deep, self.search.states, hold=3)
        better = other.converged and (other.cost < fitted.cost or not fitted.converged)
        return self.search.moved_to(other if better else fitted)

    def from_rest(self, fitted: LikelihoodFit) -> float:
        """Return how likely so much less a likelihood is if the recordings start from rest: its ratio's probability."""
        from scipy.stats import chi2

        free = self.search.with_free_start().run()
        gain, degrees = 2 * (fitted.cost - free.cost), len(self.search.segments) * len(self.search.sigma.q)
        return float(chi2.sf(max(gain, 0.0), degrees))

    def intervals(self, fitted: LikelihoodFit, covariance: Array) -> Array:
        """Return the 95 % intervals (p, 2): along profile likelihoods where a standard error is large, else symmetric.

        Each parameter follows the one with a large standard error that it is correlated with most.
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
        """Return the estimate that belongs to a fit: covariance, intervals and notes."""
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
        return Estimate(
            value=np.where(nothing, 0.0, fitted.theta),
            covariance=covariance,
            names=model.names,
            units=tuple(parameter.unit for parameter in model.parameters),
            sigma=np.sqrt(sum((x**2).sum(axis=0) for x in tau) / used) * search.sigma.tau,
            rank=rank,
            condition=directions.condition,
            samples=sum(map(len, search.given.logs)),
            notes=(*notes, *undetermined_notes(model.names, undetermined, rank, provenance)),
            provenance=provenance,
            eigenvalues={body.name: float(np.linalg.eigvalsh(body.scaled(fitted.theta))[0]) for body in bodies},
            interval=self.intervals(fitted, covariance) if fitted.converged else np.zeros((0, 2)),
            weights=1.0 / search.sigma.tau,
            information=fitted.information,
            directions=directions,
        )

    def provenance(self, undetermined: NDArray[np.bool_]) -> tuple[Provenance, ...]:
        """Say what each parameter was determined by: where not by the data, by the start, and so as that says."""
        data, prior = Provenance.DATA, Provenance.PRIOR
        pairs = zip(undetermined, self.start.provenance, strict=True)
        return tuple((prior if was is data else was) if gone else data for gone, was in pairs)
