"""Maximum likelihood of eq. (7): errors in positions and torques alike, on a spline trajectory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Gt, Le
from numpy.typing import NDArray

from dynident.estimators.barrier import Barrier
from dynident.estimators.cone import nearest_feasible
from dynident.estimators.estimator import Consistency, DataRank, Estimate, Estimator, Problem, Provenance, Residual
from dynident.estimators.least_squares import LeastSquares, weight_joints
from dynident.estimators.maximum_likelihood.newton import LikelihoodFit, NewtonSettings
from dynident.estimators.maximum_likelihood.plan import estimate_noise, misfit, recordings, whiteness_probability
from dynident.estimators.maximum_likelihood.search import LikelihoodSearch
from dynident.estimators.maximum_likelihood.segment import Sigma
from dynident.estimators.notes import (
    Failed,
    MovingStart,
    NotAlone,
    NotByData,
    NotConverged,
    NotWhite,
    RankDeficient,
    ScatterLarger,
    SmoothSigns,
)
from dynident.estimators.physical_constraints import BodyConstraint, PsdConstraint, bodies_of, physical_constraints
from dynident.estimators.physically_consistent import PhysicallyConsistent
from dynident.models import Model, to_pseudo
from dynident.motion.log import Log
from dynident.motion.splines import NORMAL_95
from dynident.regression import Rank, rank_of
from dynident.runtime import InputError, ModelError, Note
from dynident.runtime.arrays import Array

BARRIER_WEIGHT = 1e-3  # of the barrier that keeps inertia and friction physical, in half squared standard deviations
TOLERANCE = 1e-5  # expected decrease of the cost that ends the iteration, in the same unit
MIN_PRIOR_EIGENVALUE = 0.01  # least eigenvalue of a prior, relative to its diagonal
POSES = 16  # configurations of the recordings at which the mass matrix must be positive definite
START_SLACK = 0.3  # slack of the start, relative to the usual size
BODY_SLACK = 1e-3  # the same for bodies, which are often nearly rods or plates
StartMode = Literal["free", "rest", "test"]
RESTART_SLACK = 0.8  # slack of a second start, relative to the usual size
FIRST_ROUND_FACTOR = 100.0  # factor of the tolerance while the noise is only roughly known
MIN_SPACING = 0.25  # samples between knots: finer ones follow nothing that was measured
MAX_SETTING = 1e6  # standard deviations, or times the value
MIN_RATE = 1e-3  # Hz
MAX_ROUNDS, MAX_ITERATIONS = 20, 1000  # of the noise; iterations
REST_TEST_LEVEL = 0.01  # of the test whether the recordings start from rest
ROUNDING = 1e-15  # an undetermined parameter smaller than this share of the largest is set to zero
MAX_SANDWICH_RATIO = 1.3  # ratio of the sandwich's standard error to the likelihood's above which it is noted
MIN_CONTRIBUTING_PARTS = 20.0  # of the recordings that contribute to a parameter: fewer make no reliable sandwich
SIGNIFICANCE = 4.0  # standard deviations of the sandwich's own sampling error that make a difference significant
MIN_RELATIVE_NOISE = 1e-3  # residuals, relative to the largest torque, that count as zero
# correlation of neighbours, and its probability, that make residuals not white
MIN_CORRELATION, MAX_PROBABILITY = 0.1, 1e-3


@dataclass(frozen=True)
class MaximumLikelihood(Estimator):
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
    the uncertainty of the velocity. ``iterations`` at most.

    Calling it with a ``Problem`` gives an ``Estimate``. Raises ConfigError for bad settings.

    >>> import numpy as np
    >>> import dynident as dy
    >>> from dynident.models.lagrangian import pendulum
    >>> arm, t, rng = pendulum(), np.arange(1001) * 0.01, np.random.default_rng(0)
    >>> motion = dy.simulate(arm, arm.values, lambda s: [np.sin(5 * s)], t)
    >>> log = dy.record(motion, sigma_q=1e-4, sigma_tau=0.01, rng=rng).log
    >>> found = dy.identify(arm, log, smoother=dy.Spline(sigma=1e-4), estimator=dy.MaximumLikelihood(start="rest"))
    >>> for name, value, std in zip(arm.names, found.estimate.value, found.estimate.std):
    ...     print(f"{name} = {value:.4f} +- {std:.5f}")
    J = 0.0824 +- 0.00005
    h = 0.2497 +- 0.00014
    """

    start: StartMode = "free"
    spacing: Annotated[float, Ge(MIN_SPACING)] | None = None
    steps: bool | None = None
    huber: Annotated[float, Gt(0), Le(MAX_SETTING)] | None = None
    rounds: Annotated[int, Ge(1), Le(MAX_ROUNDS)] = 2
    profile: Annotated[float, Gt(0), Le(MAX_SETTING)] | None = 0.4
    iterations: Annotated[int, Ge(1), Le(MAX_ITERATIONS)] = 60
    rate: Annotated[float, Ge(MIN_RATE)] | None = 1100.0

    needs_samples: ClassVar[bool] = True
    title = "maximum likelihood"

    def __call__(self, problem: Problem) -> Estimate:
        """Estimate, with notes on the iteration. Raises ConfigError, InputError and ModelError as the start does."""
        model = problem.model
        start = PhysicallyConsistent(costs=False)(problem) if bodies_of(model.parameters) else LeastSquares()(problem)
        fallback = start
        try:
            run = _LikelihoodRun.begin(self, problem, start)
            fallback = replace(start, value=run.search.theta)  # the nearest feasible point
            return run.estimate()
        except (ModelError, InputError, np.linalg.LinAlgError) as error:
            return replace(fallback, notes=(Failed(str(error)), *fallback.notes))

    def quick(self) -> LeastSquares:
        """Return least squares: fitting the trajectory takes too long for a search."""
        return LeastSquares()


@dataclass(eq=False)
class _LikelihoodRun:
    """One estimation in progress: the search and its notes."""

    settings: MaximumLikelihood
    problem: Problem
    start: Estimate
    search: LikelihoodSearch
    notes: list[Note]

    @classmethod
    def begin(cls, settings: MaximumLikelihood, problem: Problem, start: Estimate) -> _LikelihoodRun:
        """Return the run with its data, a first estimate of the noise, and a feasible start."""
        model = problem.model
        coulomb = any(parameter.role == "coulomb" for parameter in model.parameters)
        find_steps = not coulomb if settings.steps is None else settings.steps
        measurements, notes = recordings(problem, settings.rate, steps=find_steps)
        # theta moves only where the data or a prior determine it
        barrier, directions = movable_directions(
            Barrier(psd_constraints(model, measurements.logs, start.value), BARRIER_WEIGHT),
            rank_of(problem.regression.triangular_factors.stack(), model.parameters),
        )
        theta = move_into_constraints(start.value, problem, barrier.psd_constraints)
        sigma_q, sigma_tau = estimate_noise(measurements.logs)
        sigma_tau = np.maximum(sigma_tau, misfit(problem, theta))  # the misfit of the model counts as noise
        bodies = any(parameter.body for parameter in model.parameters)
        newton_settings = NewtonSettings(TOLERANCE, settings.iterations, newton=not bodies)
        sigma = Sigma(sigma_q, sigma_tau)
        search = LikelihoodSearch(model, measurements, barrier, newton_settings, directions, theta, sigma)
        return cls(settings, problem, start, search, notes)

    def estimate(self) -> Estimate:
        """Fit, test for a start from rest where that is configured, and return the estimate."""
        fit = self.fit_rounds()
        if self.settings.start == "test" and (chance := self.rest_p_value(fit)) < REST_TEST_LEVEL:
            # knots, noise and theta must be found anew
            moving = _LikelihoodRun.begin(replace(self.settings, start="free"), self.problem, self.start)
            moving.notes.append(MovingStart(chance))
            return moving.estimate()
        if not fit.converged:
            self.notes.append(NotConverged(fit.iterations, float(abs(fit.decrement) / 2)))
        return self.to_estimate(fit)

    def fit_rounds(self) -> LikelihoodFit:
        """Choose the knots, fit in rounds with a better noise estimate each, and restart once where that fails."""
        search, settings = self.search, self.settings
        rest = settings.start != "free"
        search.choose_knots(settings.spacing, from_rest=rest, condense=settings.huber is None)
        if widths := search.smooth_signs():
            self.notes.append(SmoothSigns(widths))
        fit = search.run(hold=2, loose=FIRST_ROUND_FACTOR if settings.rounds > 1 else 1.0)
        # each round estimates the noise from the last fit, and fits again with it
        for _ in range(settings.rounds - 1):
            search.reweight(settings.huber, fit)
            fit = search.run()
        bodies = not search.settings.newton  # some parameters of bodies are never determined
        undetermined = bool(self.directions(fit).undetermined_mask.any()) and not bodies
        return fit if fit.converged and not undetermined else self.restart(fit)

    def directions(self, fit: LikelihoodFit) -> Rank:
        """Return what the information determines of the directions that the smoothed motions excite."""
        triangular = self.problem.regression.triangular_factors
        _, rank = weight_joints(triangular, 1.0 / self.search.sigma.tau, self.problem.model.parameters)
        return rank.with_information(fit.information)

    def restart(self, fit: LikelihoodFit) -> LikelihoodFit:
        """Search once more from well inside the feasible set, and return the more likely result."""
        constraints = self.search.barrier.psd_constraints
        inner_start = move_into_constraints(self.start.value, self.problem, constraints, RESTART_SLACK)
        second_fit = self.search.search_from(inner_start, self.search.states, hold=3)
        is_better = second_fit.converged and (second_fit.cost < fit.cost or not fit.converged)
        return self.search.move_to(second_fit if is_better else fit)

    def rest_p_value(self, fit: LikelihoodFit) -> float:
        """Return the p-value of the likelihood ratio test that the recordings start from rest."""
        from scipy.stats import chi2

        free = self.search.with_free_start().run()
        gain, degrees = 2 * (fit.cost - free.cost), len(self.search.segments) * len(self.search.sigma.q)
        return float(chi2.sf(max(gain, 0.0), degrees))

    def intervals(self, fit: LikelihoodFit, covariance: Array) -> Array:
        """Return the 95 % intervals (p, 2): along profile likelihoods where a standard error is large, else symmetric.

        Each parameter uses the profile of the parameter with a large standard error that it is most correlated with.
        """
        std, share = np.sqrt(np.diag(covariance)), self.settings.profile
        out = fit.theta[:, None] + NORMAL_95 * std[:, None] * np.array([-1.0, 1.0])
        is_requested = share is not None and bool(np.isfinite(std).all())
        weak = np.flatnonzero(std > (share or np.inf) * np.abs(fit.theta))
        # along a nearly undetermined direction the likelihood is far from normal: follow its profile
        if is_requested and len(weak):
            correlation = np.abs(covariance[:, weak]) / np.outer(std, std[weak])
            leader = np.argmax(correlation, axis=1)
            for place, k in enumerate(weak):
                out[leader == place] = self.search.profile_intervals(fit, covariance, int(k))[leader == place]
        return np.asarray(out)

    def to_estimate(self, fit: LikelihoodFit) -> Estimate:
        """Return the estimate of a fit, with covariance, intervals and notes."""
        model, search = self.problem.model, self.search
        tau, directions, bodies = search.residuals()[1], self.directions(fit), bodies_of(model.parameters)
        rank, undetermined, covariance = directions.rank, directions.undetermined_mask, directions.covariance()
        provenance = self.provenance(undetermined) if bodies else ()
        notes = (*self.notes, *residual_notes(search, fit, directions, tau))
        degrees = search.torque_degrees
        if degrees is None:
            degrees = np.maximum(sum((segment.raw.weight > 0).sum(axis=0) for segment in search.segments), 1)
        rms = np.sqrt(sum((x**2).sum(axis=0) for x in tau) / degrees)
        is_zero = undetermined & (np.abs(fit.theta) <= ROUNDING * np.abs(fit.theta).max())
        smallest = {body.name: body.min_eigenvalue(fit.theta) for body in bodies}
        return Estimate(
            parameters=model.parameters,
            value=np.where(is_zero, 0.0, fit.theta),
            covariance=covariance,
            determined=DataRank(rank, directions.condition, directions),
            residual=Residual(rms * search.sigma.tau, sum(map(len, search.recordings.logs)), 1.0 / search.sigma.tau),
            notes=(*notes, *undetermined_notes(model.names, undetermined, rank, provenance)),
            provenance=provenance,
            consistency=Consistency(smallest) if smallest else None,
            interval=self.intervals(fit, covariance) if fit.converged else None,
            information=fit.information,
        )

    def provenance(self, undetermined: NDArray[np.bool_]) -> tuple[Provenance, ...]:
        """Return what determines each parameter; where it is not the data, the provenance is that of the start."""
        origins = [Provenance.PRIOR if x is Provenance.DATA else x for x in self.start.provenance]
        return tuple(np.where(undetermined, origins, Provenance.DATA).tolist())


def residual_notes(search: LikelihoodSearch, fit: LikelihoodFit, rank: Rank, tau: Sequence[Array]) -> list[Note]:
    """Return the notes on the torque's residuals ``tau`` and on standard errors, by the pseudo-inverse."""
    notes: list[Note] = []
    inverse, undetermined = rank.inverse, rank.undetermined_mask
    correlation = _neighbour_correlation(tau)
    largest = np.abs(np.concatenate([log.tau for log in search.recordings.logs])).max(axis=0)
    if correlation and (search.sigma.tau > MIN_RELATIVE_NOISE * largest).any():
        notes.append(NotWhite(correlation))
    sandwich, contributing = search.sandwich_std(fit, inverse)
    std = np.sqrt(np.diag(inverse))
    is_reliable = (std > 0) & (contributing > MIN_CONTRIBUTING_PARTS) & ~undetermined
    ratio = np.divide(sandwich, std, out=np.ones_like(std), where=is_reliable)
    # differences within the sampling error of the sandwich itself count as none
    ratio[ratio**2 - 1 < SIGNIFICANCE / np.sqrt(np.maximum(contributing, MIN_CONTRIBUTING_PARTS))] = 1.0
    worst = int(np.argmax(ratio))
    if ratio[worst] > MAX_SANDWICH_RATIO:  # smaller ones occur by chance where a few samples dominate
        notes.append(ScatterLarger(search.model.names[worst], float(ratio[worst])))
    return notes


def undetermined_notes(
    names: Sequence[str], undetermined: NDArray[np.bool_], rank: int, provenance: Sequence[Provenance]
) -> list[Note]:
    """Return the notes on parameters that the data do not determine."""
    if not undetermined.any():
        return []
    deficient = RankDeficient(rank, len(undetermined))
    if provenance:
        return [deficient, NotByData(sum(entry is not Provenance.DATA for entry in provenance))]
    return [deficient, NotAlone(tuple(name for name, entry in zip(names, undetermined, strict=True) if entry))]


def _neighbour_correlation(tau: Sequence[Array]) -> float:
    """Return the largest correlation of neighbouring residuals of a joint, zero where they are nearly white."""
    if min(whiteness_probability(x, 0) for x in tau) > MAX_PROBABILITY:
        return 0.0
    power = np.maximum(sum((x**2).sum(axis=0) for x in tau), 1e-300)
    correlation = float((sum((x[1:] * x[:-1]).sum(axis=0) for x in tau) / power).max())
    return correlation if correlation > MIN_CORRELATION else 0.0


def psd_constraints(model: Model, logs: Sequence[Log], start: Array) -> tuple[PsdConstraint, ...]:
    """Return the physical constraints on a model at the configurations of the logs.

    The prior of the bodies is nominal, or that of ``start`` (p).
    """
    poses = np.concatenate([log.q[:: max(len(log) * len(logs) // POSES, 1)] for log in logs])
    constraints = physical_constraints(model, poses)
    bodies, p = constraints.bodies, len(model.parameters)
    centred = [replace(body.psd_constraint(p), centre=_prior_inertia(body, model, start)[None]) for body in bodies]
    return (*centred, *constraints.matrices, *constraints.scalar_constraints(np.zeros(p), np.eye(p)))


def movable_directions(barrier: Barrier, rank: Rank) -> tuple[Barrier, Array]:
    """Return the constraints that matter, and the orthonormal directions (p, v) in which the parameters may move.

    What the data do not determine stays at the start, which may lie on a limit, unless a prior keeps it finite.
    """
    directions = rank.spanning_directions(barrier.centred_components)
    active = tuple(constraint for constraint in barrier.psd_constraints if (constraint.slopes @ directions).any())
    return replace(barrier, psd_constraints=active), directions


def _prior_inertia(body: BodyConstraint, model: Model, start: Array) -> Array:
    """Return the prior pseudo-inertia (4, 4) of a body: the nominal one, or else that of the start, regularised."""
    values = [model.parameters[k].value for k in body.columns]
    size = np.outer(body.size, body.size)
    if None not in values:
        nominal = to_pseudo(np.array(values, dtype=float))
        scale = np.sqrt(np.maximum(np.diag(nominal), 1e-300))
        # a nominal inertia that is nearly singular is no prior: a thin rod would fix the direction of the axis
        if np.linalg.eigvalsh(nominal / np.outer(scale, scale))[0] > MIN_PRIOR_EIGENVALUE:
            return np.asarray(nominal / size)
    inertia = to_pseudo(start[body.columns])
    moments = np.abs(np.diag(inertia))
    return np.asarray((inertia + MIN_PRIOR_EIGENVALUE * np.diag(np.maximum(moments, 1e-3 * moments.max()))) / size)


def move_into_constraints(
    theta: Array, problem: Problem, constraints: Sequence[PsdConstraint], margin: float = START_SLACK
) -> Array:
    """Return theta (p) moved into the constraints by the least change of the torque, with some slack.

    theta is returned unchanged where the solver finds no such point.
    """
    triangular = problem.regression.triangular_factors
    deviation = np.sqrt(triangular.residual(theta) / np.maximum(triangular.rows, 1))
    factor = triangular.stack(1.0 / np.maximum(deviation, 1e-12))
    # the least change of the torque is measured by the normal matrix of the weighted rows
    hessian = factor[:, :-1].T @ factor[:, :-1]
    matrices, slack = [], []
    for constraint in constraints:
        # scale each matrix to a diagonal of about one, so that the slack is relative
        size = np.abs(np.diagonal(constraint.slopes @ theta, axis1=1, axis2=2)).max(axis=0)
        size = np.maximum(size, 1e-6 * max(float(size.max()), 1e-12))
        scale = 1.0 / np.sqrt(size)
        matrices.append(constraint.slopes * np.multiply.outer(scale, scale)[None, :, :, None])
        slack.append(margin if constraint.centre is None else BODY_SLACK)
    if _has_slack(theta, matrices, slack):
        return theta
    point = nearest_feasible(theta, hessian, matrices, slack)
    # an inaccurate solution is not used where the start is feasible
    return point if _has_slack(point, matrices, [0.5 * min_slack for min_slack in slack]) else theta


def _has_slack(theta: Array, matrices: Sequence[Array], slack: Sequence[float]) -> bool:
    pairs = zip(matrices, slack, strict=True)
    return all(np.linalg.eigvalsh(M @ theta)[..., 0].min() >= min_slack for M, min_slack in pairs)
