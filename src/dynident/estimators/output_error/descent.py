"""Levenberg's and Marquardt's iteration for an output error: a step is tried by simulating, damped until it helps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError, MissingInputError, Note, Step, brief
from dynident.estimators.estimator import Problem
from dynident.estimators.notes import StartedElsewhere
from dynident.estimators.output_error.first import first_runs
from dynident.estimators.output_error.linear import Linear, linearised, normal
from dynident.estimators.output_error.notes import StillSimulating
from dynident.estimators.output_error.shots import Shots, Simulation
from dynident.estimators.output_error.spread import information_of
from dynident.simulation import Failure

__all__ = ["Descent", "Fitted"]

Array = NDArray[np.float64]
CLOSE = 0.01  # standard errors of a step that ends the iteration
FAR = 1.0  # standard errors that the solution may seem away where steps no longer help: sticking friction has edges
LITTLE, SLOW = 1e-7, 3e-4  # relative change of the cost that ends it, and after damped steps
ROUNDING = 1e-10  # by which the cost may rise
DAMPING, LEAST, MOST = 1e-3, 1e-9, 1e6
EXACT = 1e-9  # of the motion or torque: a residual below it is rounding


@dataclass(frozen=True, eq=False)
class Fitted:
    """The ``value`` (p), the ``information`` (r, r) of the directions from so many ``samples``, what is to be noted."""

    value: Array
    information: Array
    samples: int
    notes: tuple[Note, ...]

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class _State:
    """Where the iteration is: theta (p), the starts of the shots, and the simulations."""

    theta: Array
    shots: tuple[Shots, ...]
    runs: tuple[Simulation, ...]

    __repr__ = brief


@dataclass(eq=False)
class Descent:
    """One estimation in progress; ``turn`` (p, r) are the directions of the parameters that are sought."""

    problem: Problem
    turn: Array
    iterations: int
    notes: list[Note] = field(default_factory=list)

    def fit(self, start: Array, shots: tuple[Shots, ...]) -> Fitted:
        """Return the fit that begins with ``start`` (p); InputError where the parameters do not matter."""
        state, damping, fall = self.begun(start, shots), DAMPING, 1.0
        for steps in range(self.iterations + 1):
            self.problem.progress(Step("simulating", steps, self.iterations))
            sigma = noise(state)
            linear = self.linearised(state, sigma)
            information, far = self.judged(state, linear, sigma)
            samples = sum(one.samples for one in linear)
            if steps == self.iterations or far < CLOSE or fall < (LITTLE if damping < DAMPING else SLOW):
                break
            found, damping = self.stepped(state, linear, sigma, damping)
            del linear  # most of the memory, of which the next needs as much
            if found is None:
                break
            fall = 1.0 - cost(found.runs, sigma) / cost(state.runs, sigma)
            state, damping = found, max(damping / 10.0, LEAST)
        if far > FAR:
            self.notes.append(StillSimulating(steps, far))
        return Fitted(state.theta, information, samples, tuple(self.notes))

    def judged(self, state: _State, linear: Sequence[Linear], sigma: Array) -> tuple[Array, float]:
        """Return the information (r, r), and how many usual standard errors of a direction away the solution seems,
        none where residuals are rounding."""
        H, g = normal(linear)
        _check(self.problem, H)
        information, step = information_of(linear, len(self.problem.model.joints)), _solved(H, g, LEAST)
        exact = cost(state.runs, sigma) < 0.5 * sum(one.samples for one in linear)
        square = float(step @ information @ step) / len(step)
        return information, 0.0 if exact else np.sqrt(max(square, 0.0))

    def begun(self, start: Array, shots: tuple[Shots, ...]) -> _State:
        """Return the first simulation."""
        theta, runs, other = first_runs(self.problem, start, lambda value: self.simulated(shots, value), likely)
        if other is not None:
            self.notes.append(StartedElsewhere(other))
        return _State(theta, shots, runs)

    def simulated(self, shots: Sequence[Shots], theta: Array) -> tuple[Simulation, ...] | Failure:
        """Return the simulations of all stretches, or the first failure."""
        found = []
        for one in shots:
            run = one.simulated(self.problem.model, theta)
            if isinstance(run, Failure):
                return run
            found.append(run)
        return tuple(found)

    def linearised(self, state: _State, sigma: Array) -> tuple[Linear, ...]:
        """Return all stretches, linearised at a state, in units of sigma (n)."""
        found = []
        for shots, run in zip(state.shots, state.runs, strict=True):
            by_theta, by_start = shots.slopes(self.problem.model, state.theta, run, self.turn)
            found.append(linearised(by_theta, by_start, run.e, run.count, sigma))
        return tuple(found)

    def stepped(
        self, state: _State, linear: Sequence[Linear], sigma: Array, damping: float
    ) -> tuple[_State | None, float]:
        """Return the state after a step with so much damping, or ten times as much until it is no worse, and the
        damping; None where no step helps."""
        most = cost(state.runs, sigma) * (1 + ROUNDING)
        while damping < MOST:
            step = _solved(*normal(linear, damping), damping)
            shots = tuple(
                one.moved(run.run.rows[:, 0], some.moved(step, damping))
                for one, run, some in zip(state.shots, state.runs, linear, strict=True)
            )
            theta = state.theta + self.turn @ step
            runs = self.simulated(shots, theta)
            if not isinstance(runs, Failure) and cost(runs, sigma) <= most:
                return _State(theta, shots, runs), damping
            damping *= 10.0
        return None, damping


def noise(state: _State) -> Array:
    """Return the rms (n) of the residuals of each joint."""
    square: Array = np.sum([np.square(one.e).sum(axis=(0, 1)) for one in state.runs], axis=0)
    count: Array = np.sum([one.count.sum(axis=(0, 1)) for one in state.runs], axis=0)
    span: Array = np.max([np.ptp(one.measured[one.rows], axis=0) for one in state.shots], axis=0)
    least = EXACT * np.where(span > 0, span, span.max(initial=0.0) or 1.0)
    return np.asarray(np.maximum(np.sqrt(square / np.maximum(count, 1)), least))


def cost(runs: Sequence[Simulation], sigma: Array) -> float:
    """Return the weighted sum of squares."""
    return float(sum(np.square(one.e / sigma).sum() for one in runs))


def likely(runs: Sequence[Simulation]) -> float:
    """Return the cost where the noise of each joint is unknown: the geometric mean of the joints' sums of squares."""
    square: Array = np.sum([np.square(one.e).sum(axis=(0, 1)) for one in runs], axis=0)
    return float(np.exp(np.log(square + np.finfo(float).tiny).mean()))


def _solved(H: Array, g: Array, damping: float) -> Array:
    """Return the damped step (r)."""
    scale = np.sqrt(np.diag(H) + np.finfo(float).tiny)
    some = H / np.outer(scale, scale) + damping * np.eye(len(H))
    return np.asarray(np.linalg.solve(some, g / scale) / scale)


def _check(problem: Problem, H: Array) -> None:
    """Raise MissingInputError where no parameter changes what is simulated, InputError where some without bounds."""
    if np.isfinite(H).all() and H.any():
        return
    sources = ", ".join(one.source for one in problem.motions)
    if np.isfinite(H).all():
        raise MissingInputError(
            f"{sources}: no parameter of the model changes what is simulated: a controller that does not see the "
            "positions asks for the same torque whatever the robot is. Use output_error."
        )
    raise InputError(f"{sources}: the derivatives of the simulation are without bounds; use shorter segments.")
