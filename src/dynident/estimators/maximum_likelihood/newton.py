"""Newton's method on eq. (7): the trajectory is eliminated, the parameters stay feasible."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from dynident.estimators.maximum_likelihood.equations import (
    Equations,
    Likelihood,
    RegressorColumns,
    SearchPoint,
    move_states,
)
from dynident.estimators.maximum_likelihood.segment import Segment, State
from dynident.estimators.maximum_likelihood.trajectory import Arrow
from dynident.runtime import ModelError, Noun
from dynident.runtime.arrays import Array

MIN_RELATIVE_INFORMATION = 1e-12  # relative information below which a direction counts as not excited
MIN_CURVATURE_RATIO = 0.02  # least eigenvalue of Newton's matrix, relative to that of Gauss and Newton's, to trust it
HESSIAN_REUSE_DECREMENT = 0.01  # expected fall of the cost below which second derivatives are kept from step to step
STEP_ACCURACY = 1e-4  # share of the tolerance to which a step is found
MIN_FALL_SHARE, MAX_STALLED_STEPS = 0.2, 5  # so small a share of the expected fall, so often in a row, is the end
MIN_STEP_LENGTH = 1e-3  # share of a step below which the search gives up
MIN_PARABOLA_GAIN = 0.05  # share of the fall so far that the minimum of a parabola must promise to be tried
MAX_STEP_LENGTH = 8.0  # length of a step, in its own
# steps of the trajectories after one that fails, and their lengths to try
MAX_CORRECTIONS, CORRECTION_LENGTHS = 2, (1.0, 0.4, 0.16)


class Elimination(Noun):
    """A segment after elimination of its trajectory, and then of its k torques after steps.

    ``information`` (r, r) and ``gradient`` (r) are those that remain for the parameters of the border;
    ``decrement`` is twice the predicted decrease of the cost by trajectory and torques alone. ``half`` (m n, b +
    1) is L^-1 of the border and of minus the gradient, ``inner`` (k, 1 + r) gives the torques.
    """

    arrow: Arrow
    half: Array
    inner: Array
    information: Array
    gradient: Array
    decrement: float

    @classmethod
    def of(cls, normal: Equations, arrow: Arrow, r: int, *, mixed_hessian: bool = False) -> Elimination:
        """Return the elimination of a segment's trajectory from its equations.

        ``arrow`` is the band with the whole ``side`` of the equations, which is solved once for steps with and
        without second derivatives.
        """
        b, half = len(normal.corner), arrow.half
        k, half_side = b - r, half[:, : b + 1]
        # the band is solved once: second derivatives only change the columns of the parameters
        if mixed_hessian:
            half_side = half_side.copy()
            half_side[:, k:b] += half[:, b + 1 :]
        # Schur complements: eliminate the trajectory first, then the torques after steps
        eliminated = half_side.T @ half_side
        S, g = normal.corner - eliminated[:b, :b], normal.by_border - eliminated[:b, b]
        inner = np.asarray(np.linalg.solve(S[:k, :k], np.column_stack([g[:k], S[:k, k:]])))
        decrement = float(eliminated[b, b] + g[:k] @ inner[:, 0])
        return cls(
            arrow, half_side, inner, S[k:, k:] - S[k:, :k] @ inner[:, 1:], g[k:] - S[k:, :k] @ inner[:, 0], decrement
        )

    def step(self, change: Array) -> tuple[Array, Array]:
        """Return the step of C (m n) and W (k) for a ``change`` (r) of the parameters."""
        k = len(self.inner)
        dW = self.inner[:, 0] - self.inner[:, 1:] @ change
        b = k + len(change)
        x = self.half[:, b] - self.half[:, :b] @ np.concatenate([dW, change])
        return self.arrow.solve_transposed(x[:, None])[:, 0], dW

    @cached_property
    def sensitivity(self) -> Array:
        """Minus the derivative (m n + k, r) of C and W by the parameters."""
        k = len(self.inner)
        half = self.half[:, k:-1] - self.half[:, :k] @ self.inner[:, 1:]
        return np.concatenate([self.arrow.solve_transposed(half), self.inner[:, 1:]])


class Quadratic(Noun):
    """Information (r, r) and gradient (r) of all segments, and the decrement by the trajectories alone."""

    information: Array
    gradient: Array
    decrement: float
    segments: tuple[Elimination, ...]

    @classmethod
    def of(cls, parts: Sequence[Equations], arrows: Sequence[Arrow], r: int, *, mixed_hessian: bool) -> Quadratic:
        """Sum the eliminations over the segments; raise ModelError where the equations are not finite."""
        pairs = zip(parts, arrows, strict=True)
        segments = tuple(Elimination.of(segment, arrow, r, mixed_hessian=mixed_hessian) for segment, arrow in pairs)
        information = sum((segment.information for segment in segments), np.zeros((r, r)))
        if not np.isfinite(information).all():
            raise ModelError("the normal equations of the parameters are not finite.")
        gradient = sum((segment.gradient for segment in segments), np.zeros(r))
        return cls(information, gradient, sum(segment.decrement for segment in segments), segments)


@dataclass(frozen=True)
class NewtonSettings:
    """When to stop: the expected fall of the cost (half squared standard deviations), and the number of steps.

    ``newton`` takes second derivatives by trajectory and theta, which cost 3 n regressors a step. Before the search the
    trajectories take ``hold`` steps at the theta given. The parameter with the index ``fixed`` stays as it is.
    """

    tolerance: float = 1e-4
    iterations: int = 60
    newton: bool = True
    hold: int = 2
    fixed: int | None = None


class LikelihoodFit(Noun):
    """The result of Newton's method; ``information`` (p, p) of theta has all other unknowns profiled out.

    ``before`` are theta and the states before the last step, whose predicted decrease of the cost is half the
    ``decrement``. ``gradient`` (p) is the data's gradient of the cost after it. ``segments`` give the last step
    of each trajectory, as a function of the parameters of ``columns``.
    """

    theta: Array
    states: tuple[State, ...]
    before: tuple[Array, tuple[State, ...]]
    information: Array
    segments: tuple[Elimination, ...]
    columns: RegressorColumns
    cost: float
    gradient: Array
    decrement: float
    iterations: int
    converged: bool

    def extrapolate(self, segments: Sequence[Segment], theta: Array) -> tuple[State, ...]:
        """Return the states for another theta nearby, to first order."""
        origin, states = self.before
        change = self.columns.combination @ (theta - origin)
        return move_states(segments, states, [elimination.step(change) for elimination in self.segments])


class _NewtonStep(Noun):
    """A step of theta, and of each segment's C and W; ``descent`` is minus the gradient by all of them."""

    theta: Array
    moves: tuple[tuple[Array, Array], ...]
    segments: tuple[Elimination, ...]
    decrement: float
    information: Array
    gradient: Array
    descent: Array

    @property
    def flat(self) -> Array:
        """The step of all unknowns, in the order of ``descent``."""
        return np.concatenate([*(part for move in self.moves for part in move), self.theta])

    def conjugate(self, previous: _NewtonStep | None) -> _NewtonStep:
        """Return the step made conjugate to the previous one: Hestenes and Stiefel (1952), nonlinear."""
        if previous is None:
            return self
        change, last_step = self.descent - previous.descent, previous.flat
        factor = -float(change @ self.flat) / (float(change @ last_step) or np.inf)
        if factor <= 0 or float(self.descent @ last_step) * factor <= -0.5 * self.decrement:
            return self
        moves = tuple(
            (dC + factor * oldC, dW + factor * oldW)
            for (dC, dW), (oldC, oldW) in zip(self.moves, previous.moves, strict=True)
        )
        return replace(self, theta=self.theta + factor * previous.theta, moves=moves)


def _newton_step(
    normal: Sequence[Equations], theta: Array, likelihood: Likelihood, settings: NewtonSettings
) -> _NewtonStep:
    """Solve for the step: Newton's where its matrix is safely positive definite, else that of Gauss and Newton."""
    # Newton's matrix adds the mixed second derivatives; it is used only where it is safely positive definite
    K = likelihood.columns.combination
    arrows = [Arrow(segment.band, segment.side) for segment in normal]
    gauss = quadratic = Quadratic.of(normal, arrows, len(K), mixed_hessian=False)
    if settings.newton:
        observed = Quadratic.of(normal, arrows, len(K), mixed_hessian=True)
        if _safe(observed.information, gauss.information):
            quadratic = observed
    H, g = _positive(K.T @ quadratic.information @ K), quadratic.gradient @ K
    barrier = likelihood.barrier
    # the barrier makes the step of theta a problem of its own, solved inside the feasible set
    directions = likelihood.open_directions(H, theta, settings.fixed)
    restricted_barrier = barrier.restrict(theta, directions)
    dtheta = directions @ restricted_barrier.minimum(
        directions.T @ H @ directions, directions.T @ g, STEP_ACCURACY * settings.tolerance
    )
    gain = float(g @ dtheta) - 0.5 * float(dtheta @ H @ dtheta) - barrier.value(theta + dtheta) + barrier.value(theta)
    moves, change = tuple(segment.step(K @ dtheta) for segment in quadratic.segments), H @ dtheta - g
    parts, by_columns = [], np.zeros(len(K))
    for segment in normal:
        by_torques, by_parameters = np.split(segment.by_border, [len(segment.by_border) - len(K)])
        parts += [segment.by_coefficients, by_torques]
        by_columns = by_columns + by_parameters
    descent = np.concatenate([*parts, by_columns @ K - barrier.derivatives(theta)[0]])
    return _NewtonStep(
        dtheta, moves, quadratic.segments, quadratic.decrement + 2 * gain, K.T @ gauss.information @ K, change, descent
    )


def _positive(H: Array) -> Array:
    """Return H (p, p) with eigenvalues that are negative or negligible set to zero."""
    scale = np.sqrt(np.maximum(np.diag(H), 1e-200))
    values, vectors = np.linalg.eigh(H / np.outer(scale, scale))
    if values[0] > MIN_RELATIVE_INFORMATION * values[-1]:
        return H
    half = vectors * np.sqrt(np.where(values > MIN_RELATIVE_INFORMATION * values[-1], values, 0.0)) * scale[:, None]
    return np.asarray(half @ half.T)


def _safe(observed: Array, gauss: Array) -> bool:
    """Return whether the observed information is at least a small share of the expected one, in any direction."""
    scale = np.sqrt(np.maximum(np.diag(gauss), 1e-200))
    weakest = [float(np.linalg.eigvalsh(S / np.outer(scale, scale))[0]) for S in (observed, gauss)]
    return weakest[0] > MIN_CURVATURE_RATIO * weakest[1]


def maximise(
    likelihood: Likelihood,
    states: Sequence[State],
    theta: Array,
    settings: NewtonSettings | None = None,
    trace: Callable[[int, float, float, Array], None] = lambda *_: None,
) -> LikelihoodFit:
    """Minimise the cost over trajectories, torques after steps, and theta (p), from a feasible start.

    Steps are conjugate, which makes up for the second derivatives that are left out; a parabola adjusts their length. A
    failing one is corrected by steps of the trajectory at fixed theta before it is shortened. The last step, whose
    expected fall is below the tolerance, is taken too.
    ``trace`` is called with each iteration's number, cost, expected fall and theta. Raises ModelError where the
    equations cannot be solved.
    """
    settings = settings or NewtonSettings()
    point, is_near, stalled = _start_point(likelihood, states, theta, settings.hold), False, 0
    normal: list[Equations] = []
    previous: _NewtonStep | None = None
    for iteration in itertools.count():
        # near the solution the second derivatives hardly change: they are kept from step to step
        previous_normal = normal if is_near else []
        normal = likelihood.linearise(point.states, point.theta, previous_normal, mixed_hessian=settings.newton)
        step = _newton_step(normal, point.theta, likelihood, settings)
        trace(iteration, point.cost, step.decrement, point.theta)
        converged = abs(step.decrement) < settings.tolerance
        if converged or iteration >= settings.iterations or stalled >= MAX_STALLED_STEPS:
            break
        previous, improved = _improve(likelihood, point, step, previous)
        if improved is None and settings.newton:  # far from the solution Newton's matrix may mislead
            gauss = _newton_step(normal, point.theta, likelihood, replace(settings, newton=False))
            improved = _descend(likelihood, point, gauss)
        if improved is None:
            break
        # several steps in a row with a small share of the expected fall: rounding or a kink ends the search
        stalled = stalled + 1 if point.cost - improved.cost < MIN_FALL_SHARE * 0.5 * step.decrement else 0
        point, is_near = improved, step.decrement < HESSIAN_REUSE_DECREMENT
    # the last step is taken where it helps, without shortening
    end = (converged and _try_full_step(likelihood, point, step, previous, point.cost)[1]) or point
    details = (step.information, step.segments, likelihood.columns, end.cost, step.gradient, step.decrement)
    return LikelihoodFit(end.theta, end.states, (point.theta, point.states), *details, iteration, converged)


def _start_point(likelihood: Likelihood, states: Sequence[State], theta: Array, hold: int) -> SearchPoint:
    """Return the start after ``hold`` steps of the states alone; raise ModelError for an infeasible start."""
    states = tuple(states)
    for _ in range(hold):
        states = move_states(likelihood.segments, states, _trajectory_step(likelihood, states, theta))
    cost = likelihood.cost(states, theta)
    if not np.isfinite(cost):
        raise ModelError(f"{likelihood.model.name}: the start violates the physical constraints.")
    return SearchPoint(states, theta, cost)


def _improve(
    likelihood: Likelihood, point: SearchPoint, step: _NewtonStep, previous: _NewtonStep | None
) -> tuple[_NewtonStep | None, SearchPoint | None]:
    """Return the step if it was taken in full, and the new point, None where no step lowers the cost."""
    if step.decrement <= 0:
        return None, None
    needed = point.cost - MIN_FALL_SHARE * 0.5 * step.decrement
    direction, trial = _try_full_step(likelihood, point, step, previous, needed)
    if trial:
        return direction, _refine_length(likelihood, point, direction, trial)
    return None, _descend(likelihood, point, step)


def _point_along(likelihood: Likelihood, point: SearchPoint, step: _NewtonStep, size: float) -> SearchPoint | None:
    """Return the point after ``size`` times a step; None outside the feasible set."""
    return likelihood.point(
        move_states(likelihood.segments, point.states, step.moves, size), point.theta + size * step.theta
    )


def _try_full_step(
    likelihood: Likelihood, point: SearchPoint, step: _NewtonStep, previous: _NewtonStep | None, needed: float
) -> tuple[_NewtonStep, SearchPoint | None]:
    """Return the conjugate or the plain step, and the point after it where the cost is below ``needed``."""
    for direction in [step] if previous is None else [step.conjugate(previous), step]:
        with suppress(ModelError, np.linalg.LinAlgError):  # a trial may overflow
            # conjugate directions first: they make up for second derivatives that are left out
            trial = _point_along(likelihood, point, direction, 1.0)
            if trial and trial.cost < needed:
                return direction, trial
    return step, None


def _descend(likelihood: Likelihood, point: SearchPoint, step: _NewtonStep) -> SearchPoint | None:
    """Return the point after a share of the step that lowers the cost; None where there is none."""
    size = 1.0
    while size > MIN_STEP_LENGTH:
        needed = point.cost - 1e-2 * size * min(step.decrement, 1.0)
        with suppress(ModelError, np.linalg.LinAlgError):  # a trial may overflow
            trial = _point_along(likelihood, point, step, size)
            if trial and trial.cost < needed:
                return trial
            # a long step of theta leaves the trajectory behind: let it follow before shortening the step
            for _ in range(MAX_CORRECTIONS):
                trial = _correct_trajectories(likelihood, trial) if trial else None
                if trial and trial.cost < needed:
                    return trial
        size *= 0.4
    return None


def _refine_length(
    likelihood: Likelihood, point: SearchPoint, step: _NewtonStep, full_step: SearchPoint
) -> SearchPoint:
    """Return the point at the minimum of the parabola along the step, or ``full_step`` where that is as good.

    ``full_step`` is the point after the step.
    """
    # the parabola through both costs with the slope at the point
    slope, decrease = float(step.descent @ step.flat), point.cost - full_step.cost
    curvature = 2 * (slope - decrease)
    if curvature <= 0 or (slope - curvature) ** 2 > 2 * curvature * MIN_PARABOLA_GAIN * decrease:
        with suppress(ModelError, np.linalg.LinAlgError):
            size = min(slope / curvature, MAX_STEP_LENGTH) if curvature > 0 else MAX_STEP_LENGTH
            refined = _point_along(likelihood, point, step, size)
            if refined and refined.cost < full_step.cost:
                return refined
    return full_step


def _correct_trajectories(likelihood: Likelihood, point: SearchPoint) -> SearchPoint | None:
    """Return the point after a step of the trajectories alone: the first that lowers the cost, else the best."""
    moves, candidates = _trajectory_step(likelihood, point.states, point.theta), []
    for size in CORRECTION_LENGTHS:
        candidate = likelihood.point(move_states(likelihood.segments, point.states, moves, size), point.theta)
        if candidate and candidate.cost < point.cost:
            return candidate
        candidates += [candidate] if candidate else []
    return min(candidates, key=lambda trial: trial.cost, default=None)


def _trajectory_step(likelihood: Likelihood, states: Sequence[State], theta: Array) -> tuple[tuple[Array, Array], ...]:
    """Return the Gauss-Newton step of each C and W at this theta, which needs no regressor."""
    return tuple(
        Elimination.of(normal, Arrow(normal.band, normal.side), 0).step(np.zeros(0))
        for normal in likelihood.trajectory_equations(states, theta)
    )
