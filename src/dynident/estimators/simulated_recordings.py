"""The stretches of recordings that are simulated, and what drives the model there."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from dynident.estimators.estimator import Estimator, Problem
from dynident.estimators.least_squares import LeastSquares
from dynident.estimators.maximum_likelihood.estimator import move_into_constraints
from dynident.estimators.notes import FirstModel
from dynident.estimators.physical_constraints import mass_constraints
from dynident.estimators.physically_consistent import PhysicallyConsistent
from dynident.models import Model
from dynident.models.simulation import (
    Failure,
    RunsAway,
    Sensitivity,
    SimulatedRecording,
    sensitivities,
    simulate_recording,
    ticks,
)
from dynident.motion.log import Controller, Motion
from dynident.motion.smoothers import KalmanSmoother, Smoother
from dynident.motion.splines import stretches
from dynident.regression import fitted_rows
from dynident.runtime import DynidentError, InputError, MissingInputError, ModelError, Noun, Step, report_progress
from dynident.runtime.arrays import Array

# times the range of the recorded motion; of the widest range, what counts as that of a joint
MAX_DISTANCE, MIN_RANGE_SHARE = 30.0, 0.1


def no_controller_error(motion: Motion, purpose: str, instead: str) -> MissingInputError:
    """Return the error for a recording without controller, where ``purpose`` is to be simulated.

    ``instead`` is a way out.
    """
    return MissingInputError(
        f"{motion.source}: {purpose} to be simulated, but the recording does not know its controller. Give its gains "
        "and reference in the section `simulation` (kinds cascade, pd, pid, file.py:function; in Python "
        f"Log.controller), or {instead}."
    )


def failure_of(run: SimulatedRecording, q: NDArray[np.float64]) -> Failure | None:
    """Return why a simulated loop is useless beside the recorded positions q (N, n), or None.

    It failed, or a joint is many times the range of its motion away, which limits of the drives may keep finite.
    """
    if run.failure is not None:
        return run.failure
    span = np.ptp(q, axis=0)
    # a joint that hardly moves is measured by the widest range, one of an arm at rest not at all
    size = np.where(span.max(initial=0.0) > 0, np.maximum(span, MIN_RANGE_SHARE * span.max(initial=0.0)), np.inf)
    away = np.flatnonzero((np.abs(run.q - q) > MAX_DISTANCE * size).any(axis=1))
    return RunsAway(float(run.t[away[0]] - run.t[0])) if len(away) else None


def not_simulated_error(motions: Sequence[Motion], failure: Failure, instead: str) -> InputError:
    """Return the error where no first model can be simulated; ``instead`` is a way out."""
    return InputError(
        f"{', '.join(motion.source for motion in motions)}: no first model can be simulated, neither that of "
        "least squares nor one of a Kalman smoother, a physically consistent one, that of the robot file, or one whose "
        f"mass matrix is made positive definite ({failure}). Check gains, units and reference of the "
        f"controller and the terms of the model, or use {instead}."
    )


def fit_resmoothed(problem: Problem, smoother: Smoother) -> Array:
    """Return least squares (p) of the problem's recordings after smoothing them with another smoother.

    Raises DynidentError where smoother or fit do.
    """
    motions = tuple(_smooth_motion(problem, k, smoother) for k in range(len(problem.motions)))
    regression = replace(problem.regression, motions=motions)
    return LeastSquares(weights="per_joint")(replace(problem, motions=motions, regression=regression)).value


def _smooth_motion(problem: Problem, k: int, smoother: Smoother) -> Motion:
    """Return the k-th motion, smoothed anew where its log is known; unused samples do not count."""
    motion, log = problem.motions[k], problem.log(k)
    if log is None:
        return motion
    stamped = motion.shift(-motion.time_offset)
    # samples that are not used keep the smoothed position, so that their errors do not spread
    masked_log = replace(log, q=np.where(motion.mask[:, None], log.q, stamped.q))
    new_motion = smoother(masked_log).shift(motion.time_offset)
    return replace(motion, q=new_motion.q, dq=new_motion.dq, ddq=new_motion.ddq, mask=motion.mask & new_motion.mask)


T = TypeVar("T")
MAX_ATTEMPTS = 4  # that are tried
POSES = 32  # at which the mass matrix must be positive definite
MAX_CONSTRAINED_RATIO = 1.1  # residual of a joint over that of least squares: noise alone does not leave so much more


def find_first_model(
    problem: Problem, failure: Failure, attempt: Callable[[Array], T | Failure]
) -> tuple[Array, T, FirstModel] | Failure:
    """Return the first parameters (p) for which ``attempt`` succeeds, its outcome, and what made them.

    The candidates are least squares of a Kalman smoother, whose acceleration has the least noise; the physically
    consistent fit; the values of the model's file; and least squares under the constraint that the mass matrix is
    positive definite where the robot was. Where none succeeds, return the ``failure`` of least squares.
    """
    for k, (kind, value) in enumerate(_alternative_models(problem)):
        report_progress(Step("trying other first models", k, MAX_ATTEMPTS))
        outcome = attempt(value)
        if not isinstance(outcome, Failure):
            return value, outcome, kind
    return failure


def _alternative_models(problem: Problem) -> Iterator[tuple[FirstModel, Array]]:
    with suppress(DynidentError):
        yield FirstModel.KALMAN, fit_resmoothed(problem, KalmanSmoother())
    # from the least to the most restrictive assumption about the arm
    consistent: Estimator = PhysicallyConsistent(costs=False)
    with suppress(DynidentError):
        yield FirstModel.CONSISTENT, consistent(problem).value
    values = problem.model.values
    if values is not None and np.isfinite(values).all():
        yield FirstModel.NOMINAL, np.asarray(values, dtype=float)
    with suppress(DynidentError):
        yield FirstModel.MASS, _fit_with_positive_mass(problem)


def _fit_with_positive_mass(problem: Problem) -> Array:
    """Return least squares (p) with a mass matrix that is positive definite at some of the poses.

    Raises ModelError where the data contradict that, as a torque of the wrong sign does.
    """
    model, triangular = problem.model, problem.regression.triangular_factors
    q = np.concatenate([motion.q[motion.mask] for motion in problem.motions])
    physical = mass_constraints(model, q[:: max(len(q) // POSES, 1)])
    size = len(model.names)
    constraints = (*physical.matrices, *physical.scalar_constraints(np.zeros(size), np.eye(size)))
    start = LeastSquares(weights="per_joint")(problem).value
    theta = move_into_constraints(start, problem, constraints)
    # the constraint costs far more than noise explains: a sign or a unit is wrong
    if (triangular.residual(theta) > MAX_CONSTRAINED_RATIO**2 * triangular.residual(start)).any():
        raise ModelError("the data contradict a positive definite mass matrix.")
    return theta


Output = Literal["q", "tau"]
BLOCK_SAMPLES = 2048  # samples


class Simulation(Noun):
    """A simulated stretch: the ``run``, its residuals ``e`` (B, K, n), and their ``count`` (B, K, n), 0 or 1."""

    run: SimulatedRecording
    e: Array
    count: Array


class Shots(Noun):
    """A stretch of a recording to be simulated.

    ``rows`` of a ``motion``, which gives the initial states of the pieces and drives the model with its torque;
    with a ``controller`` it is one piece, else pieces of ``segment`` s. ``measured`` (N, n) is the target: the
    positions (rad or m), or the torque (N m or N) ``after`` s after the positions; ``count`` (N, n) is 0 where it
    does not count, else 1.
    """

    motion: Motion
    measured: Array
    count: Array
    rows: slice
    segment: float
    controller: Controller | None = None
    output: Output = "q"
    after: float = 0.0

    @property
    def samples(self) -> int:
        """The number of samples that are simulated."""
        return len(range(*self.rows.indices(len(self.motion))))

    @property
    def restart(self) -> float | None:
        """The time (s) after which the simulation begins anew."""
        return None if self.controller is not None else self.segment

    def move_starts(self, at: NDArray[np.intp], change: Array) -> Shots:
        """Return the shots with the initial states of pieces, at samples ``at`` (B), moved by ``change`` (B, 2 n)."""
        q, dq = self.motion.q.copy(), self.motion.dq.copy()
        n = q.shape[1]
        q[at] += change[:, :n]
        dq[at] += change[:, n:]
        return replace(self, motion=replace(self.motion, q=q, dq=dq))

    def simulate(self, model: Model, theta: Array) -> Simulation | Failure:
        """Simulate with the parameters theta (p)."""
        run = simulate_recording(model, theta, self.motion, self.controller, rows=self.rows, restart=self.restart)
        failure = run.failure if self.controller is None else failure_of(run, self.motion.q[self.rows])
        if failure is not None:
            return failure
        count = self.count[run.rows]
        # the last sample of a piece is the first of the next one: count it once
        count[:-1, -1] = 0.0  # the first of the next piece
        if self.output == "tau":
            count *= _interpolation(run.t, self.after)[2][:, None]
        e = self.measured[run.rows] - self._select_output(run.t, run).reshape(count.shape)
        return Simulation(run, e * count, count)

    def derivatives(self, model: Model, theta: Array, simulation: Simulation, directions: Array) -> tuple[Array, Array]:
        """Return the derivatives of the output along ``directions`` (p, r), and by the starts.

        They are (B, K, n, r) and (B, K, n, 2 n).
        """
        sensitivity = sensitivities(model, theta, simulation.run, self.controller, directions, only=self.output)
        assert sensitivity.start is not None  # noqa: S101
        outputs = [self._select_output(simulation.run.t, derivative) for derivative in (sensitivity, sensitivity.start)]
        shaped = [derivative.reshape(*simulation.count.shape, derivative.shape[2]) for derivative in outputs]
        for derivative in shaped:
            derivative *= simulation.count[..., None]
        return shaped[0], shaped[1]

    def _select_output(self, t: Array, run: SimulatedRecording | Sensitivity) -> Array:
        """Return the positions, or the torque when it was measured, of a run or of its derivatives (N, n, ...)."""
        if self.output == "q":
            return run.q
        k, share, _ = _interpolation(t, self.after)
        share, out = share.reshape(-1, *[1] * (run.tau.ndim - 1)), np.empty_like(run.tau)
        for start in range(0, len(k), BLOCK_SAMPLES):  # derivatives of a long recording are most of the memory
            block = slice(start, start + BLOCK_SAMPLES)
            out[block] = (1 - share[block]) * run.tau[k[block]] + share[block] * run.tau[k[block] + 1]
        return out


def _interpolation(t: Array, after: float) -> tuple[NDArray[np.intp], Array, NDArray[np.bool_]]:
    """Return how to interpolate between the middles of steps at the times t (N) + ``after``.

    These are the step in whose middle, or after it, each time is, its share of the way to the middle of the next,
    and whether it is on that way. A torque held from one sample to the next is on average that of the middle.
    """
    gaps = np.diff(t)
    middle, at = t + 0.5 * np.append(gaps, gaps[-1]), t + after
    k = np.clip(np.searchsorted(middle, at + 1e-9, side="right") - 1, 0, len(t) - 2)
    share = (at - middle[k]) / (middle[k + 1] - middle[k])
    return k, np.clip(share, 0.0, 1.0), np.abs(share - 0.5) < 0.5 + 1e-6


MIN_SAMPLES, MIN_LENGTH_SHARE = 10, 0.1  # samples of a stretch, and its share of the longest one


def loop_shots(problem: Problem, k: int, controller: Controller, output: Output = "q") -> Shots:
    """Return the k-th recording in the loop of its controller, on the time grid of its references.

    The loop goes on where samples are not used. Torques do not count where their equations are left out of the
    regression.
    """
    motion = problem.motions[k]
    stamped = motion.shift(-motion.time_offset)  # a controller sees positions when they are stamped
    usable = np.flatnonzero(stamped.mask)
    if len(usable) < MIN_SAMPLES:
        raise _too_few_error(motion)
    rows = slice(int(usable[0]), int(usable[-1]) + 1)
    measured = _measured_positions(problem, k, stamped)
    shots = Shots(stamped, measured, _usable_counts(stamped), rows, np.inf, controller)
    if output == "tau":
        keep = fitted_rows(motion, problem.regression.min_speed)
        count = _usable_counts(motion) if keep is None else _usable_counts(motion) * keep
        shots = replace(shots, measured=motion.tau, count=count, output="tau", after=motion.time_offset)
    return _refine_grid(shots)


def open_shots(problem: Problem, k: int, segment: float, torque: Array | None = None) -> Iterator[Shots]:
    """Yield the stretches of the k-th recording, except short ones, cut into segments of ``segment`` s.

    Positions are simulated when they are stamped; ``torque`` (N, n) is that of then, by default the measured one.
    """
    motion = problem.motions[k]
    if torque is None:  # at the times when the positions are stamped, later by the time offset
        t, torque = motion.t - motion.time_offset, motion.tau
        if motion.time_offset:
            torque = np.column_stack([np.interp(t, motion.t, column) for column in torque.T])
    sharpened = torque.copy()
    # a twelfth of the second difference: then the mean between samples is that of the parabola through them
    sharpened[1:-1] -= np.diff(torque, 2, axis=0) / 12.0
    driving_motion = replace(motion.shift(-motion.time_offset), tau=sharpened)
    runs = stretches(driving_motion.mask)
    min_length = max(MIN_SAMPLES, MIN_LENGTH_SHARE * max((run.stop - run.start for run in runs), default=0))
    long_runs = [run for run in runs if run.stop - run.start >= min_length]
    if not long_runs:
        raise _too_few_error(motion)
    measured, count = _measured_positions(problem, k, driving_motion), np.ones(driving_motion.q.shape)
    for rows in long_runs:
        yield Shots(driving_motion, measured, count, rows, segment)


def _refine_grid(shots: Shots) -> Shots:
    """Return the shots at the times of the controller's references, where these are finer than the samples."""
    grid = ticks(shots.motion, shots.controller, shots.rows)
    if grid.motion is shots.motion:
        return shots
    measured, count = np.zeros_like(grid.motion.q), np.zeros_like(grid.motion.q)
    measured[grid.at], count[grid.at] = shots.measured[shots.rows], shots.count[shots.rows]
    return replace(shots, motion=grid.motion, measured=measured, count=count, rows=grid.rows)


def _measured_positions(problem: Problem, k: int, motion: Motion) -> Array:
    """Return the positions (N, n) as measured, or those of the motion without a log."""
    log = problem.log(k)
    return motion.q if log is None else log.q


def _usable_counts(motion: Motion) -> Array:
    """Return 1 where samples may be used, else 0 (N, n)."""
    return np.repeat(motion.mask[:, None], len(motion.joints), axis=1).astype(float)


def _too_few_error(motion: Motion) -> InputError:
    return InputError(
        f"{motion.source}: too few usable samples in a row to simulate: give at least {MIN_SAMPLES}, or an estimator "
        "that simulates nothing."
    )
