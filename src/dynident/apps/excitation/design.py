"""Design of a motion: the most informative one within the limits, and the accuracy that it promises."""

from __future__ import annotations

import math
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import replace

import numpy as np

from dynident.apps.excitation.criterion import base_information
from dynident.apps.excitation.limits import Feasibility, MotionLimits, min_fit_speeds
from dynident.apps.excitation.motion import (
    MotionRequest,
    Program,
    build_interior,
    check_request,
    find_best_motion,
    reachable_motion,
    without_memory,
)
from dynident.apps.excitation.programs import TooShortError, friction_program, gravity_program
from dynident.apps.excitation.search import Plan, Stage
from dynident.apps.excitation.trajectory import Piece, Trajectory
from dynident.apps.excitation.verify import TrajectoryCheck, verify
from dynident.models import Distances, Model, Space
from dynident.regression import (
    BaseParameters,
    UnexcitedParameters,
    base_parameters,
    find_unexcited,
    rank_of_information,
    structural_base_parameters,
)
from dynident.runtime import ConfigError, Note, Noun, Severity, report_progress
from dynident.runtime.arrays import Array

FRICTION_SHARE, GRAVITY_SHARE = 0.4, 0.2  # shares of the duration of ``Program.ALL``; the motion has the rest
SPEED_COUNTS = (5, 4, 3, 2)  # of each joint: fewer where there is no time for more
BLOCK_SAMPLES = 2000  # samples at once

VALIDATION_PERIOD_FACTOR = 1.58  # periods: the validation motion is longer, with other speeds up to the same frequency
UNLIMITED_DURATION = 1e4  # s: as long as the ways take
QUICK = Plan(2, (Stage(1.0, 40), Stage(0.1, 40)))


def slow_pieces(feasible: Feasibility, request: MotionRequest, rng: np.random.Generator) -> tuple[Piece, ...]:
    """Return the pieces of a request's program that are not the optimised motion, from rest to rest in one pose.

    There are none for ``Program.MOTION``. Raises ConfigError where the time does not suffice.
    """
    match request.program:
        case Program.FRICTION:
            return _friction_pieces(feasible, request.duration, request.start, rng)
        case Program.GRAVITY:
            return gravity_program(feasible, request, rng)
        case Program.ALL:
            try:
                friction = _friction_pieces(feasible, FRICTION_SHARE * request.duration, request.start, rng)
                gravity_request = replace(request, duration=GRAVITY_SHARE * request.duration, start=home_pose(friction))
                return (*friction, *gravity_program(feasible, gravity_request, rng))
            except ConfigError as error:
                shares = (
                    f"of the duration of {request.duration:g} s, {FRICTION_SHARE:.0%} are for friction and "
                    f"{GRAVITY_SHARE:.0%} for poses: "
                )
                if isinstance(error, TooShortError):
                    raise TooShortError(f"{shares}{error.program}", error.shortest / FRICTION_SHARE) from error
                raise ConfigError(f"{shares}{error}") from error
    return ()


def home_pose(pieces: tuple[Piece, ...]) -> Array:
    """Return the pose (n) in which the pieces begin."""
    return np.asarray(pieces[0].course.states(np.zeros(1))[0, 0])


def _friction_pieces(
    feasible: Feasibility, duration: float, start: Array | None, rng: np.random.Generator
) -> tuple[Piece, ...]:
    """Return each joint moving at as many speeds as there is time for."""
    state = rng.bit_generator.state
    for speeds in SPEED_COUNTS[:-1]:
        with suppress(ConfigError):
            return friction_program(feasible, duration, start, rng, speeds)
        # every try begins with the same random numbers, so that the result does not depend on failed ones
        rng.bit_generator.state = state
    return friction_program(feasible, duration, start, rng, SPEED_COUNTS[-1])


class ExpectedAccuracy(Noun):
    """Accuracy that a recording of a motion is expected to give.

    Of the base parameters ``basis`` (r): the ``value`` (r) and the standard errors ``std`` (r), infinite for
    parameters that stay open; further log det of the information, in SI units, and the condition number of
    the weighted regressor with columns of length one, both infinite where parameters stay open.
    """

    basis: BaseParameters
    value: Array
    std: Array
    log_det: float
    condition: float

    @property
    def open_parameters(self) -> tuple[str, ...]:
        """Names of the parameters that lead a base parameter that stays open."""
        return tuple(name for name, std in zip(self.basis.leading, self.std, strict=True) if not np.isfinite(std))

    @property
    def relative(self) -> Array:
        """Standard errors (r) in % of the values; infinite where that is zero."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(np.where(self.value == 0, np.inf, 100 * self.std / np.abs(self.value)))


def torque_information(model: Model, states: Array, weights: Array, min_speed: Array | None = None) -> Array:
    """Return the information (p, p) of the torque along states (at least 3, N, n): the sum of Y' W Y over samples.

    ``weights`` (n) are one over the variance of each joint's torque. The torque of a joint does not count
    where it is slower than its ``min_speed`` (n).
    """
    p = len(model.parameters)
    out, root = np.zeros((p, p)), np.sqrt(weights)[:, None]
    # in blocks, so that the regressor of a long recording need not fit into memory
    for k in range(0, states.shape[1], BLOCK_SAMPLES):
        rows = model.regressor(*states[:3, k : k + BLOCK_SAMPLES]) * root
        if min_speed is not None:
            rows[np.abs(states[1, k : k + BLOCK_SAMPLES]) < min_speed] = 0.0
        rows = rows.reshape(-1, p)
        out += rows.T @ rows
    return out


def expected_accuracy(
    model: Model, theta: Array, information: Array, basis: BaseParameters | None = None, prior: Array | None = None
) -> ExpectedAccuracy:
    """Return the accuracy that the information (p, p) of a motion gives together with a ``prior`` (p, p), at theta (p).

    ``basis`` are the base parameters that any motion could show; None computes them.
    """
    basis = structural_base_parameters(model) if basis is None else basis
    base_value, total_information = basis.to_base(theta), _total_base_information(basis, information, prior)
    rank = rank_of_information(total_information)
    std = np.sqrt(np.diag(rank.covariance()))
    # a direction without information has no finite variance: determinant and condition number are infinite
    if rank.rank < basis.rank:
        return ExpectedAccuracy(basis, base_value, std, -np.inf, np.inf)
    log_det = 2 * float(np.log(rank.values).sum() + np.log(rank.scale).sum())
    return ExpectedAccuracy(basis, base_value, std, log_det, rank.condition)


def unexcited_parameters(
    model: Model, information: Array, accuracy: ExpectedAccuracy, prior: Array | None = None
) -> tuple[UnexcitedParameters, ...]:
    """Return the base parameters that stay open, with the joints whose motion would show them."""
    if np.isfinite(accuracy.std).all():
        return ()
    # back to the standard parameters: the directions that are known become combinations with names
    B = accuracy.basis.combination
    rank = rank_of_information(B.T @ _total_base_information(accuracy.basis, information, prior) @ B, model.parameters)
    return find_unexcited(accuracy.basis, base_parameters(rank, model.parameters), model)


def _total_base_information(basis: BaseParameters, information: Array, prior: Array | None) -> Array:
    """Return the information (r, r) on the base parameters, with the prior."""
    independent = list(basis.independent)
    base = information[np.ix_(independent, independent)]
    return np.asarray(base if prior is None else base + base_information(basis, prior))


class Interrupted(Note):
    """The search was stopped before its end; the motion is the best so far, within all limits."""

    severity = Severity.INFO

    def __str__(self) -> str:
        return "The search was stopped before its end: the motion is the best until then, and keeps to all limits."


class Design(Noun):
    """A motion, a second one for validation, and the accuracy that is expected of the first.

    ``model``, ``theta`` (p), ``request`` and ``limits`` are those that were used; ``checks`` are the results
    of the independent check of both motions.
    """

    model: Model
    theta: Array
    request: MotionRequest
    limits: MotionLimits
    space: Space
    trajectory: Trajectory
    validation: Trajectory
    expected: ExpectedAccuracy
    checks: tuple[TrajectoryCheck, TrajectoryCheck]
    notes: tuple[Note, ...] = ()


def design(
    model: Model,
    theta: Array,
    limits: MotionLimits,
    space: Space,
    request: MotionRequest,
    rng: np.random.Generator,
    *,
    shapes: Distances | None = None,
    executor: Executor | None = None,
) -> Design:
    """Return the most informative motion within the limits; ``theta`` (p) gives the torque.

    ``shapes`` are the real shapes for the last check, where those of ``space`` are simplified. A generator
    gives the same motion on any executor. Ctrl-C ends the search with the best motion so far.

    Raises ConfigError for a request that contradicts itself, the model or the limits, and InputError for a
    start in collision, where no motion is found, and where a motion fails the last check.
    """
    model, theta, request, memory_notes = without_memory(model, np.asarray(theta, dtype=float), request)
    feasible = Feasibility(model, theta, limits, space, request.clearance, request.step)
    check_request(feasible, request)
    report_progress("finding base parameters")
    basis = structural_base_parameters(model)
    feasible.random_poses(1, np.random.default_rng(0))  # says what is in the way where the arm can stand nowhere
    first_pieces = slow_pieces(feasible, request, rng)
    has_motion, interrupted = request.program in (Program.MOTION, Program.ALL), False
    pieces = first_pieces
    if has_motion:
        # the other pieces come first: their information is a prior for the optimised motion, which has the remaining
        # time
        motion_request = _remaining_request(feasible, request, first_pieces)
        interior = build_interior(feasible, motion_request, basis)
        result = find_best_motion(interior, feasible, Plan(request.starts), rng, executor)
        report_progress("finding the ways to it and back")
        pieces = (*first_pieces, *reachable_motion(interior, feasible, result.x, motion_request, rng))
        interrupted = result.interrupted
    report_progress("a second motion, for validation")
    trajectories = Trajectory(limits.joints, pieces), _validation(feasible, request, basis, rng)
    report_progress("checking both")
    # the check shares no bounds or working sets with the search, and uses the real shapes where they are known
    check, validation_check = (verify(trajectory, feasible, shapes) for trajectory in trajectories)
    information = _recorded_information(feasible, trajectories[0], request)
    accuracy = expected_accuracy(model, theta, information, basis, request.prior)
    interruption_notes = (Interrupted(),) if interrupted else ()
    notes = (*memory_notes, *interruption_notes, *unexcited_parameters(model, information, accuracy, request.prior))
    return Design(model, theta, request, limits, space, *trajectories, accuracy, (check, validation_check), notes)


def _remaining_request(feasible: Feasibility, request: MotionRequest, pieces: tuple[Piece, ...]) -> MotionRequest:
    """Return the request for the motion after other pieces, whose information is added to the prior."""
    if not pieces:
        return request
    trajectory = Trajectory(feasible.limits.joints, pieces)
    remaining_time = request.duration - trajectory.duration
    information = _recorded_information(feasible, trajectory, request)
    prior = information if request.prior is None else information + request.prior
    return replace(request, duration=remaining_time, start=home_pose(pieces), prior=prior)


def _validation(
    feasible: Feasibility, request: MotionRequest, basis: BaseParameters, rng: np.random.Generator
) -> Trajectory:
    """Return a second motion at other speeds: one period, from other starts, with a short search."""
    # other frequencies and speeds: validation on the same motion would not reveal an overfit
    period = VALIDATION_PERIOD_FACTOR * min(request.period, request.duration)
    harmonics = math.ceil(VALIDATION_PERIOD_FACTOR * request.harmonics)
    validation_request = replace(
        request, family="fourier", period=period, harmonics=harmonics, duration=UNLIMITED_DURATION, max_periods=1
    )
    interior = build_interior(feasible, replace(validation_request, duration=period), basis)
    result = find_best_motion(interior, feasible, QUICK, rng)
    return Trajectory(feasible.limits.joints, reachable_motion(interior, feasible, result.x, validation_request, rng))


def _recorded_information(feasible: Feasibility, trajectory: Trajectory, request: MotionRequest) -> Array:
    """Return the information (p, p) of a recording of a motion, without the slow samples that the fit leaves out."""
    model, states = feasible.model, trajectory.states(trajectory.times(request.rate))
    return torque_information(model, states, 1 / np.square(request.sigma), min_fit_speeds(model, feasible.limits))
