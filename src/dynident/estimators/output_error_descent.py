"""Levenberg's and Marquardt's iteration for an output error: each step is simulated, and damped until it helps."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import TypeVar

import numpy as np

from dynident.estimators.estimator import Problem
from dynident.estimators.instrument_moments import regularised_cholesky
from dynident.estimators.instrumental_variables import InstrumentalVariables
from dynident.estimators.notes import FirstModel, StartedElsewhere, StillMoving
from dynident.estimators.simulated_recordings import (
    Shots,
    Simulation,
    find_first_model,
    fit_resmoothed,
    not_simulated_error,
)
from dynident.models.simulation import Failure
from dynident.motion.smoothers import Spline
from dynident.regression.whitening import bandwidth, bartlett
from dynident.runtime import DynidentError, InputError, MissingInputError, Note, Noun, Step, report_progress
from dynident.runtime.arrays import Array

T = TypeVar("T")
CANDIDATES = 3  # that are tried
RIDGE = 1e-12  # of the start: a joint that rests has no sensitivity
MAX_CONDITION = 1e6  # condition above which a piece alone determines a direction
MIN_VARIANCE = 1e-6  # variance of J' e over that of white residuals: below are exact data
SCORE_BLOCK = 4096  # samples
MIN_PIECES = 3  # from which on what each segment adds is compared
CONVERGED_STEP = 0.01  # standard errors of a step that ends the iteration
ROUGH_STEP = 0.1  # the same after a step that had to be damped: sticking friction has edges, and steps gain little
MAX_REMAINING_STEP = 1.0  # standard errors left where steps no longer help
MIN_DECREASE, MIN_DAMPED_DECREASE = 1e-7, 3e-4  # relative change of the cost that ends it, and after damped steps
ROUNDING = 1e-10  # by which the cost may rise
INITIAL_DAMPING, MIN_DAMPING, MAX_DAMPING = 1e-3, 1e-9, 1e6
MIN_RELATIVE_NOISE = 1e-9  # of the motion or torque: a residual below it is rounding
MAX_COST_RATIO = 0.5  # of the cost: below it, another first model is worth it


def choose_first_model(
    problem: Problem, start: Array, simulate: Callable[[Array], T | Failure], cost: Callable[[T], float]
) -> tuple[Array, T, FirstModel | None]:
    """Return the first parameters (p), their simulation, and what made them where it is not ``start``.

    A simulation has several minima. Noise amplified by differentiation biases least squares away from the right
    one: least squares of a smoothing spline, and instrumental variables, which white noise does not bias, are
    tried besides, and the one of least cost is taken. Where none of these can be simulated, it is one of
    ``find_first_model``. Raises InputError where none can.
    """
    best: tuple[Array, T, FirstModel | None] | None = None
    lowest_cost = np.inf
    failures: list[Failure] = []
    for k, (kind, value) in enumerate(_candidate_fits(problem, start)):
        report_progress(Step("simulating first models", k, CANDIDATES))
        runs = simulate(value)
        if isinstance(runs, Failure):
            failures.append(runs)
        # a later candidate must be clearly better: each is further from the data than the one before
        elif best is None or cost(runs) < MAX_COST_RATIO * lowest_cost:
            best, lowest_cost = (value, runs, kind), cost(runs)
    if best is not None:
        return best
    alternative = find_first_model(problem, failures[0], simulate)
    if isinstance(alternative, Failure):
        raise not_simulated_error(problem.motions, alternative, "an estimator that simulates nothing")
    return alternative


def _candidate_fits(problem: Problem, start: Array) -> Iterator[tuple[FirstModel | None, Array]]:
    """Yield least squares, and other fits that differ from it."""
    yield None, start
    with suppress(DynidentError):
        value = fit_resmoothed(problem, Spline())
        if not np.allclose(value, start, rtol=1e-3):
            yield FirstModel.SMOOTHED, value
    with suppress(DynidentError):
        yield FirstModel.INSTRUMENTS, InstrumentalVariables(instruments="lagged")(problem).value


class LinearisedStretch(Noun):
    """A stretch linearised at its simulation.

    Weighted ``rows`` of theta (B, K n, r) and ``starts`` (B, K n, 2 n) of unit columns, which were ``size`` (B, 2
    n) times as long; ``residuals`` (B, K n), of which so many ``samples`` count.
    """

    rows: Array
    starts: Array
    size: Array
    residuals: Array
    samples: int

    @cached_property
    def _products(self) -> tuple[Array, Array]:
        """J_start' J_start (B, 2 n, 2 n), and J_start' [J_theta | e] (B, 2 n, r + 1)."""
        transposed = self.starts.transpose(0, 2, 1)
        return transposed @ self.starts, np.concatenate(
            (transposed @ self.rows, transposed @ self.residuals[..., None]), axis=2
        )

    @cached_property
    def _gram(self) -> Array:
        """[J_theta | e]' [J_theta | e] (r + 1, r + 1)."""
        J, e = self.rows.reshape(-1, self.rows.shape[2]), self.residuals.ravel()
        slope = J.T @ e
        return np.block([[J.T @ J, slope[:, None]], [slope, e @ e]])

    def _start_response(self, damping: float) -> Array:
        """Return the starts (B, 2 n, r + 1) as functions of theta, and of the residuals (last column)."""
        A, right_sides = self._products
        return np.asarray(np.linalg.solve(A + (RIDGE + damping) * np.eye(A.shape[1]), right_sides))

    def normal(self, damping: float) -> Array:
        """Return [J_theta | e]' [J_theta | e] (r + 1, r + 1) with the starts eliminated."""
        _, cross_products = self._products
        # the Schur complement of the starts, piece by piece
        return np.asarray(self._gram - np.einsum("bsi,bsj->ij", cross_products, self._start_response(damping)))

    def start_step(self, step: Array, damping: float) -> Array:
        """Return the step (B, 2 n) of the starts for a step of theta (r)."""
        response = self._start_response(damping)
        return np.asarray((response[..., -1] - response[..., :-1] @ step) / self.size)

    @property
    def without_starts(self) -> tuple[Array, Array]:
        """The rows (B, K n, r) and residuals (B, K n) without the part that the starts can explain."""
        response = self._start_response(0.0)
        explained = self.starts @ response[..., :-1]
        residuals = self.residuals - (self.starts @ response[..., -1:])[..., 0]
        return np.subtract(self.rows, explained, out=explained), residuals


def linearise_stretch(by_theta: Array, by_start: Array, e: Array, count: Array, sigma: Array) -> LinearisedStretch:
    """Return the linearised stretch from derivatives by theta (B, K, n, r) and by the starts (B, K, n, 2 n).

    The residuals e (B, K, n) exist where ``count`` is 1; all is in units of ``sigma`` (n). The derivatives are
    overwritten.
    """
    is_counted = count[0].any(axis=1)
    if len(e) == 1 and not is_counted.all():  # samples that do not count would hide that the others are correlated
        by_theta, by_start, e = by_theta[:, is_counted], by_start[:, is_counted], e[:, is_counted]
    pieces = len(e)
    for derivatives in (by_theta, by_start):
        derivatives /= sigma.reshape(-1, 1)
    J, S = (derivatives.reshape(pieces, -1, derivatives.shape[3]) for derivatives in (by_theta, by_start))
    # unit columns, so that the ridge and the damping act alike on positions and velocities
    size = np.linalg.norm(S, axis=1)
    size = np.where(size > 0, size, 1.0)
    S = np.divide(S, size[:, None], out=S)
    return LinearisedStretch(J, S, size, (e / sigma).reshape(pieces, -1), int(count.sum()))


def normal_equations(linear: Sequence[LinearisedStretch], damping: float = 0.0) -> tuple[Array, Array]:
    """Return J' J (r, r) and J' e (r) of all stretches, with the starts eliminated."""
    total = np.asarray(sum(stretch.normal(damping) for stretch in linear))
    return total[:-1, :-1], total[:-1, -1]


def output_information(linear: Sequence[LinearisedStretch], joints: int) -> Array:
    """Return the inverse covariance (r, r) of a fit, H S^-1 H with H = J' J and the covariance S of J' e.

    For segments, S is the scatter of their contributions; in a closed loop it is the long-run covariance. In
    units of white residuals, correlations between directions are trusted the more, the more segments, or
    independent samples, there are per direction.
    """
    profiled_rows = [stretch.without_starts for stretch in linear]
    H = np.asarray(sum(J.reshape(-1, J.shape[2]).T @ J.reshape(-1, J.shape[2]) for J, _ in profiled_rows))
    half, r = regularised_cholesky(H), len(H)
    is_segmented = max(len(J) for J, _ in profiled_rows) > 1 and sum(len(J) for J, _ in profiled_rows) >= MIN_PIECES
    if is_segmented:
        white, independent = _jackknife_covariance(profiled_rows, half)
    else:
        white, independent = _long_run_covariance(profiled_rows, half, joints)
    # shrink correlations between directions to zero, the more the fewer independent scores there are
    variances = np.diag(np.maximum(np.diag(white), MIN_VARIANCE))
    covariance = half @ ((independent * white + r * variances) / (independent + r)) @ half.T
    information_root = np.linalg.solve(regularised_cholesky(covariance), H)
    samples = sum(stretch.samples for stretch in linear)
    return np.asarray(max(samples - r, 1) / max(samples, 1) * information_root.T @ information_root)


def _jackknife_covariance(profiled_rows: Sequence[tuple[Array, Array]], half: Array) -> tuple[Array, float]:
    """Return S in units of H = half half' (r, r) and the number of pieces, by the jackknife.

    Pieces are independent of each other, with any correlation within them; S follows from the change of the fit
    when each is left out (MacKinnon and White, 1985).
    """
    total, count = np.zeros_like(half), 0
    for rows, e in profiled_rows:
        size = max(SCORE_BLOCK // rows.shape[1], 1)  # copies of all derivatives would not fit into memory
        for block in (slice(start, start + size) for start in range(0, len(rows), size)):
            J = np.linalg.solve(half, rows[block].reshape(-1, len(half)).T).T.reshape(rows[block].shape)
            scores = np.einsum("bkr,bk->br", J, e[block])
            # what the other pieces determine; where one piece alone determines a direction it cannot be left out
            complement = np.eye(len(half)) - J.transpose(0, 2, 1) @ J
            is_determined = np.linalg.cond(complement) < MAX_CONDITION
            scores[is_determined] = np.linalg.solve(complement[is_determined], scores[is_determined][..., None])[..., 0]
            total, count = total + scores.T @ scores, count + len(scores)
    return total, float(count)


def _long_run_covariance(profiled_rows: Sequence[tuple[Array, Array]], half: Array, joints: int) -> tuple[Array, float]:
    """Return S in units of H (r, r), the long-run covariance of each stretch, and the number of independent samples."""
    total, independent = np.zeros_like(half), 0.0
    for J, e in profiled_rows:
        length = bandwidth(iter([_score_blocks(J, e, half, joints, SCORE_BLOCK)]))
        count, part = bartlett(_score_blocks(J, e, half, joints, max(SCORE_BLOCK, length)), length, len(half))
        total, independent = total + part, independent + count / length
    return total, independent


def _score_blocks(J: Array, e: Array, half: Array, joints: int, size: int) -> Iterator[Array]:
    """Yield J_t' e_t of the samples in units of H, in blocks of ``size``."""
    rows, residuals = J.reshape(-1, joints, J.shape[2]), e.reshape(-1, joints)
    for block in (slice(start, start + size) for start in range(0, len(rows), size)):
        yield np.linalg.solve(half, np.einsum("kjr,kj->kr", rows[block], residuals[block]).T).T


class DescentResult(Noun):
    """The ``value`` (p), the ``information`` (r, r) of the directions from so many ``samples``, and notes."""

    value: Array
    information: Array
    samples: int
    notes: tuple[Note, ...]


class _State(Noun):
    """The state of the iteration: theta (p), the starts of the shots, and the simulations."""

    theta: Array
    shots: tuple[Shots, ...]
    runs: tuple[Simulation, ...]


@dataclass(eq=False)
class Descent:
    """One estimation in progress; ``basis`` (p, r) are the directions of the parameters that are estimated."""

    problem: Problem
    basis: Array
    iterations: int
    notes: list[Note] = field(default_factory=list)

    def fit(self, start: Array, shots: tuple[Shots, ...]) -> DescentResult:
        """Return the fit that begins with ``start`` (p); raise InputError where the parameters have no effect."""
        theta, runs, first_model = choose_first_model(self.problem, start, partial(self.simulate, shots), joint_cost)
        self.notes += [] if first_model is None else [StartedElsewhere(first_model)]
        state, damping, decrease = _State(theta, shots, runs), INITIAL_DAMPING, 1.0
        converged_step = CONVERGED_STEP
        # each step is linearised at the last simulation, with the noise of its residuals
        for steps in range(self.iterations + 1):
            report_progress(Step("simulating", steps, self.iterations))
            sigma = residual_rms(state)
            linear = self.linearise(state, sigma)
            information, remaining = self.assess_state(state, linear, sigma)
            samples = sum(stretch.samples for stretch in linear)
            min_decrease = MIN_DECREASE if damping < INITIAL_DAMPING else MIN_DAMPED_DECREASE
            if steps == self.iterations or remaining < converged_step or decrease < min_decrease:
                break
            next_state, next_damping = self.try_steps(state, linear, sigma, damping)
            del linear  # most of the memory, of which the next needs as much
            if next_state is None:
                break
            decrease = 1.0 - cost(next_state.runs, sigma) / cost(state.runs, sigma)
            converged_step = ROUGH_STEP if next_damping > damping else CONVERGED_STEP
            # a step that helped lets the next one be less damped
            state, damping = next_state, max(next_damping / 10.0, MIN_DAMPING)
        if remaining > MAX_REMAINING_STEP:
            self.notes.append(StillMoving(steps, remaining))
        return DescentResult(state.theta, information, samples, tuple(self.notes))

    def assess_state(self, state: _State, linear: Sequence[LinearisedStretch], sigma: Array) -> tuple[Array, float]:
        """Return the information (r, r), and the distance of the solution in rms standard errors of a direction.

        The distance is zero where residuals are rounding.
        """
        H, g = normal_equations(linear)
        _check_derivatives(self.problem, H)
        information, step = output_information(linear, len(self.problem.model.joints)), _solve_damped(H, g, MIN_DAMPING)
        # residuals as small as rounding say nothing about how far the solution is
        is_exact = cost(state.runs, sigma) < 0.5 * sum(stretch.samples for stretch in linear)
        square = float(step @ information @ step) / len(step)
        return information, 0.0 if is_exact else np.sqrt(max(square, 0.0))

    def simulate(self, shots: Sequence[Shots], theta: Array) -> tuple[Simulation, ...] | Failure:
        """Return the simulations of all stretches, or the first failure."""
        simulations = []
        for stretch in shots:
            run = stretch.simulate(self.problem.model, theta)
            if isinstance(run, Failure):
                return run
            simulations.append(run)
        return tuple(simulations)

    def linearise(self, state: _State, sigma: Array) -> tuple[LinearisedStretch, ...]:
        """Return all stretches, linearised at a state, in units of sigma (n)."""
        linearisations = []
        for shots, run in zip(state.shots, state.runs, strict=True):
            by_theta, by_start = shots.derivatives(self.problem.model, state.theta, run, self.basis)
            linearisations.append(linearise_stretch(by_theta, by_start, run.e, run.count, sigma))
        return tuple(linearisations)

    def try_steps(
        self, state: _State, linear: Sequence[LinearisedStretch], sigma: Array, damping: float
    ) -> tuple[_State | None, float]:
        """Return the state after a step, and its damping; None where no step helps.

        The damping is raised tenfold from ``damping`` until the step is no worse.
        """
        max_cost = cost(state.runs, sigma) * (1 + ROUNDING)
        # raise the damping until the simulation no longer gets worse, which also ends runs that fail
        while damping < MAX_DAMPING:
            step = _solve_damped(*normal_equations(linear, damping), damping)
            shots = tuple(
                stretch.move_starts(run.run.rows[:, 0], linearisation.start_step(step, damping))
                for stretch, run, linearisation in zip(state.shots, state.runs, linear, strict=True)
            )
            theta = state.theta + self.basis @ step
            runs = self.simulate(shots, theta)
            if not isinstance(runs, Failure) and cost(runs, sigma) <= max_cost:
                return _State(theta, shots, runs), damping
            damping *= 10.0
        return None, damping


def residual_rms(state: _State) -> Array:
    """Return the rms (n) of the residuals of each joint, not below rounding."""
    square: Array = np.sum([np.square(stretch.e).sum(axis=(0, 1)) for stretch in state.runs], axis=0)
    count: Array = np.sum([stretch.count.sum(axis=(0, 1)) for stretch in state.runs], axis=0)
    span: Array = np.max([np.ptp(stretch.measured[stretch.rows], axis=0) for stretch in state.shots], axis=0)
    floor = MIN_RELATIVE_NOISE * np.where(span > 0, span, span.max(initial=0.0) or 1.0)
    return np.asarray(np.maximum(np.sqrt(square / np.maximum(count, 1)), floor))


def cost(runs: Sequence[Simulation], sigma: Array) -> float:
    """Return the weighted sum of squares."""
    return float(sum(np.square(run.e / sigma).sum() for run in runs))


def joint_cost(runs: Sequence[Simulation]) -> float:
    """Return the cost where the noise of each joint is unknown: the geometric mean of the joints' sums of squares."""
    square: Array = np.sum([np.square(run.e).sum(axis=(0, 1)) for run in runs], axis=0)
    return float(np.exp(np.log(square + np.finfo(float).tiny).mean()))


def _solve_damped(H: Array, g: Array, damping: float) -> Array:
    """Return the damped step (r)."""
    # a unit diagonal makes the damping independent of the units of the parameters
    scale = np.sqrt(np.diag(H) + np.finfo(float).tiny)
    damped_hessian = H / np.outer(scale, scale) + damping * np.eye(len(H))
    return np.asarray(np.linalg.solve(damped_hessian, g / scale) / scale)


def _check_derivatives(problem: Problem, H: Array) -> None:
    """Raise MissingInputError where no parameter has an effect, InputError where derivatives are not finite."""
    if np.isfinite(H).all() and H.any():
        return
    sources = ", ".join(motion.source for motion in problem.motions)
    if np.isfinite(H).all():
        raise MissingInputError(
            f"{sources}: no parameter of the model changes what is simulated: a controller that does not see the "
            "positions asks for the same torque whatever the robot is. Use output_error."
        )
    raise InputError(f"{sources}: the derivatives of the simulation are without bounds; use shorter segments.")
