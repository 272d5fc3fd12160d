"""Newton's method on eq. (7): the trajectory is eliminated, the parameters stay feasible."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ModelError, brief
from dynident.estimators.maximum_likelihood.arrow import Arrow
from dynident.estimators.maximum_likelihood.columns import Columns
from dynident.estimators.maximum_likelihood.elimination import Elimination, Quadratic
from dynident.estimators.maximum_likelihood.equations import Equations
from dynident.estimators.maximum_likelihood.likelihood import Likelihood, Point, carried
from dynident.estimators.maximum_likelihood.segment import Segment, State

__all__ = ["LikelihoodFit", "NewtonSettings", "maximise"]

Array = NDArray[np.float64]
NULL = 1e-12  # relative information below which a direction counts as not excited
SAFE = 0.02  # least eigenvalue of Newton's matrix, relative to that of Gauss and Newton's, to trust it
NEAR = 0.01  # expected fall of the cost below which second derivatives are kept from step to step
INEXACT = 1e-4  # share of the tolerance to which a step is found
STALLED, PATIENCE = 0.2, 5  # so small a share of the expected fall, so many times in a row, ends the search
SHORTEST = 1e-3  # share of a step below which the search gives up
WORTH = 0.05  # share of the fall so far that the minimum of a parabola must promise to be tried
LONGEST = 8.0  # length of a step, in its own
FOLLOWED, SHARES = 2, (1.0, 0.4, 0.16)  # steps of the trajectories after one that fails, and their lengths to try


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


@dataclass(frozen=True, eq=False)
class LikelihoodFit:
    """The result of Newton's method; ``information`` (p, p) of theta with all else profiled out.

    ``before`` are theta and the states before the last step, whose expected fall of the cost is half the ``decrement``.
    ``gradient`` (p) is the data's gradient of the cost after it. ``segments`` give the last step of each trajectory, as
    a function of the parameters of ``columns``.
    """

    theta: Array
    states: tuple[State, ...]
    before: tuple[Array, tuple[State, ...]]
    information: Array
    segments: tuple[Elimination, ...]
    columns: Columns
    cost: float
    gradient: Array
    decrement: float
    iterations: int
    converged: bool

    __repr__ = brief

    def extrapolated(self, segments: Sequence[Segment], theta: Array) -> tuple[State, ...]:
        """Return the states for another theta nearby, to first order."""
        origin, states = self.before
        change = self.columns.combination @ (theta - origin)
        return carried(segments, states, [one.step(change) for one in self.segments])


@dataclass(frozen=True, eq=False)
class _Step:
    """A step of theta, and of each segment's C and W; ``pull`` is minus the gradient by all of them."""

    theta: Array
    moves: tuple[tuple[Array, Array], ...]
    segments: tuple[Elimination, ...]
    decrement: float
    information: Array
    gradient: Array
    pull: Array

    @property
    def flat(self) -> Array:
        """The step of all unknowns, as in ``pull``."""
        return np.concatenate([*(part for move in self.moves for part in move), self.theta])

    def conjugate(self, before: _Step | None) -> _Step:
        """Return the step that does not undo the one before: Hestenes and Stiefel (1952), nonlinear."""
        if before is None:
            return self
        change, last = self.pull - before.pull, before.flat
        share = -float(change @ self.flat) / (float(change @ last) or np.inf)
        if share <= 0 or float(self.pull @ last) * share <= -0.5 * self.decrement:
            return self
        moves = tuple(
            (dC + share * oldC, dW + share * oldW)
            for (dC, dW), (oldC, oldW) in zip(self.moves, before.moves, strict=True)
        )
        return replace(self, theta=self.theta + share * before.theta, moves=moves)


def _step(found: Sequence[Equations], theta: Array, likelihood: Likelihood, settings: NewtonSettings) -> _Step:
    """Solve for the step: Newton's where its matrix is safely positive definite, else that of Gauss and Newton."""
    K = likelihood.columns.combination
    arrows = [Arrow(one.band, one.side) for one in found]
    gauss = used = Quadratic.of(found, arrows, len(K), mixed_hessian=False)
    if settings.newton:
        bent = Quadratic.of(found, arrows, len(K), mixed_hessian=True)
        if _safe(bent.information, gauss.information):
            used = bent
    H, g = _positive(K.T @ used.information @ K), used.gradient @ K
    barrier = likelihood.barrier
    ways = likelihood.open_directions(H, theta, settings.fixed)
    along = barrier.along(theta, ways)
    dtheta = ways @ along.minimum(ways.T @ H @ ways, ways.T @ g, INEXACT * settings.tolerance)
    gain = float(g @ dtheta) - 0.5 * float(dtheta @ H @ dtheta) - barrier.value(theta + dtheta) + barrier.value(theta)
    moves, change = tuple(one.step(K @ dtheta) for one in used.segments), H @ dtheta - g
    parts = [part for one in found for part in (one.by_coefficients, one.by_border[: len(one.by_border) - len(K)])]
    by_theta = sum((one.by_border[len(one.by_border) - len(K) :] for one in found), np.zeros(len(K))) @ K
    pull = np.concatenate([*parts, by_theta - barrier.slopes(theta)[0]])
    return _Step(dtheta, moves, used.segments, used.fall + 2 * gain, K.T @ gauss.information @ K, change, pull)


def _positive(H: Array) -> Array:
    """Return H (p, p) without what rounding has made negative, or of nothing."""
    scale = np.sqrt(np.maximum(np.diag(H), 1e-200))
    values, vectors = np.linalg.eigh(H / np.outer(scale, scale))
    if values[0] > NULL * values[-1]:
        return H
    half = vectors * np.sqrt(np.where(values > NULL * values[-1], values, 0.0)) * scale[:, None]
    return np.asarray(half @ half.T)


def _safe(observed: Array, gauss: Array) -> bool:
    """Return whether the observed information is no less than a small share of the expected one, in any direction."""
    scale = np.sqrt(np.maximum(np.diag(gauss), 1e-200))
    weakest = [float(np.linalg.eigvalsh(S / np.outer(scale, scale))[0]) for S in (observed, gauss)]
    return weakest[0] > SAFE * weakest[1]


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
    at, near, slow = _begun(likelihood, states, theta, settings.hold), False, 0
    found: list[Equations] = []
    before: _Step | None = None
    for iteration in itertools.count():
        found = likelihood.linearised(at.states, at.theta, found if near else [], mixed_hessian=settings.newton)
        step = _step(found, at.theta, likelihood, settings)
        trace(iteration, at.cost, step.decrement, at.theta)
        converged = abs(step.decrement) < settings.tolerance
        if converged or iteration >= settings.iterations or slow >= PATIENCE:
            break
        before, better = _improved(likelihood, at, step, before, found, settings)
        if better is None:
            break
        slow = slow + 1 if at.cost - better.cost < STALLED * 0.5 * step.decrement else 0
        at, near = better, step.decrement < NEAR
    end = (converged and _whole(likelihood, at, step, before, at.cost)[1]) or at
    left = (step.information, step.segments, likelihood.columns, end.cost, step.gradient, step.decrement)
    return LikelihoodFit(end.theta, end.states, (at.theta, at.states), *left, iteration, converged)


def _begun(likelihood: Likelihood, states: Sequence[State], theta: Array, hold: int) -> Point:
    """Return the start after ``hold`` steps of the states alone; ModelError for an infeasible start."""
    states = tuple(states)
    for _ in range(hold):
        states = carried(likelihood.segments, states, likelihood.trajectory_step(states, theta))
    cost = likelihood.cost(states, theta)
    if not np.isfinite(cost):
        raise ModelError(f"{likelihood.model.name}: the start violates the physical constraints.")
    return Point(states, theta, cost)


def _improved(
    likelihood: Likelihood,
    at: Point,
    step: _Step,
    before: _Step | None,
    found: Sequence[Equations],
    settings: NewtonSettings,
) -> tuple[_Step | None, Point | None]:
    """Return the step that was taken whole, if one was, and the new point, None where no step lowers the cost."""
    better = None
    if step.decrement > 0:
        way, trial = _whole(likelihood, at, step, before, at.cost - STALLED * 0.5 * step.decrement)
        if trial:
            return way, _adjusted(likelihood, at, way, trial)
        better = _descend(likelihood, at, step)
    if better is None and settings.newton:  # far from the solution Newton's matrix may mislead
        step = _step(found, at.theta, likelihood, replace(settings, newton=False))
        better = _descend(likelihood, at, step)
    return None, better


def _along(likelihood: Likelihood, at: Point, step: _Step, size: float) -> Point | None:
    """Return the point after ``size`` times a step; None outside the feasible set."""
    return likelihood.point(carried(likelihood.segments, at.states, step.moves, size), at.theta + size * step.theta)


def _whole(
    likelihood: Likelihood, at: Point, step: _Step, before: _Step | None, needed: float
) -> tuple[_Step, Point | None]:
    """Return the conjugate step or else the step itself, and the point after it where the cost is below ``needed``."""
    for way in [step] if before is None else [step.conjugate(before), step]:
        with suppress(ModelError, np.linalg.LinAlgError):  # a trial may overflow
            trial = _along(likelihood, at, way, 1.0)
            if trial and trial.cost < needed:
                return way, trial
    return step, None


def _descend(likelihood: Likelihood, at: Point, step: _Step) -> Point | None:
    """Return the point after a share of the step that lowers the cost; None where there is none."""
    size = 1.0
    while size > SHORTEST:
        needed = at.cost - 1e-2 * size * min(step.decrement, 1.0)
        with suppress(ModelError, np.linalg.LinAlgError):  # a trial may overflow
            trial = _along(likelihood, at, step, size)
            if trial and trial.cost < needed:
                return trial
            for _ in range(FOLLOWED):
                trial = _followed(likelihood, trial) if trial else None
                if trial and trial.cost < needed:
                    return trial
        size *= 0.4
    return None


def _adjusted(likelihood: Likelihood, at: Point, step: _Step, found: Point) -> Point:
    """Return the point at the minimum of the parabola along the step, or ``found``, the point after the step, where
    that is as good.
    """
    slope, fall = float(step.pull @ step.flat), at.cost - found.cost
    bend = 2 * (slope - fall)
    if bend <= 0 or (slope - bend) ** 2 > 2 * bend * WORTH * fall:
        with suppress(ModelError, np.linalg.LinAlgError):
            size = min(slope / bend, LONGEST) if bend > 0 else LONGEST
            other = _along(likelihood, at, step, size)
            if other and other.cost < found.cost:
                return other
    return found


def _followed(likelihood: Likelihood, at: Point) -> Point | None:
    """Return the point after a step of the trajectories alone: the first that lowers the cost, else the best."""
    moves, tried = likelihood.trajectory_step(at.states, at.theta), []
    for size in SHARES:
        found = likelihood.point(carried(likelihood.segments, at.states, moves, size), at.theta)
        if found and found.cost < at.cost:
            return found
        tried += [found] if found else []
    return min(tried, key=lambda one: one.cost, default=None)
