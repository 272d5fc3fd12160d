"""The design of a motion: the most informative one within the limits, and what it will tell."""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynident.errors import Note, Severity, brief
from dynident.excitation.expected import Expected, expected, information_of, unexcited
from dynident.excitation.motion import Plan, best_motion, interior_of, reached_motion
from dynident.excitation.program import home_of, slow_pieces
from dynident.excitation.request import Program, Request
from dynident.excitation.request_checks import check_request, without_memory
from dynident.excitation.search import Stage
from dynident.excitation.spaces.space import Distances, Space
from dynident.excitation.trajectories.dry_friction import slowest
from dynident.excitation.trajectories.feasibility import Feasibility
from dynident.excitation.trajectories.limits import MotionLimits
from dynident.excitation.trajectories.trajectory import Piece, Trajectory
from dynident.excitation.verify import Verified, verify
from dynident.models import Model
from dynident.regression import BaseParameters, structural_base_parameters

__all__ = ["Design", "Interrupted", "design"]

Array = NDArray[np.float64]
OTHER = 1.58  # periods: the validation motion is longer, with other speeds up to the same frequency
LONG = 1e4  # s: as long as the ways take
QUICK = Plan(2, (Stage(1.0, 40), Stage(0.1, 40)))


@dataclass(frozen=True)
class Interrupted(Note):
    """The search was stopped before its end; the motion is the best so far, within all limits."""

    severity = Severity.INFO


@dataclass(frozen=True, eq=False)
class Design:
    """A motion, another one for validation, and what the first is expected to tell.

    ``model``, ``theta`` (p), ``request`` and ``limits`` as used; ``checked`` is what the independent check of both
    motions has found.
    """

    model: Model
    theta: Array
    request: Request
    limits: MotionLimits
    space: Space
    trajectory: Trajectory
    validation: Trajectory
    expected: Expected
    checked: tuple[Verified, Verified]
    notes: tuple[Note, ...] = ()

    __repr__ = brief


def design(
    model: Model,
    theta: Array,
    limits: MotionLimits,
    space: Space,
    request: Request,
    rng: np.random.Generator,
    *,
    shapes: Distances | None = None,
    executor: Executor | None = None,
    progress: Callable[[str], None] | None = None,
) -> Design:
    """Return the most informative motion that keeps to the limits; ``theta`` (p) gives the torque.

    ``shapes`` are the real shapes, for the last check, where ``space`` has simpler ones. The same generator gives the
    same motion on any executor. Ctrl-C ends the search with the best motion so far. Raises ConfigError for a request
    that contradicts itself, the model or the limits, InputError for a start in collision, where no motion is found, and
    where one does not stand the last check.
    """
    say = progress or (lambda _: None)
    model, theta, request, left = without_memory(model, np.asarray(theta, dtype=float), request)
    check_request(model, theta, limits, space, request)
    say("finding base parameters")
    basis = structural_base_parameters(model)
    feasible = Feasibility(model, theta, limits, space, request.clearance)
    feasible.poses(1, np.random.default_rng(0))  # says what is in the way where the arm can stand nowhere
    slow = slow_pieces(feasible, request, rng)
    moving, interrupted = request.program in (Program.MOTION, Program.ALL), False
    pieces = slow
    if moving:
        rest = _beside(model, limits, request, slow)
        interior = interior_of(feasible, space, rest, basis)
        found = best_motion(interior, feasible, Plan(request.starts), rng, executor, say)
        say("finding the ways to it and back")
        pieces = (*slow, *reached_motion(interior, feasible, found.x, rest, rng))
        interrupted = found.interrupted
    say("a second motion, for validation")
    pair = Trajectory(limits.joints, pieces), _validation(feasible, space, request, basis, rng)
    say("checking both")
    first, second = (verify(one, model, theta, limits, space, request.clearance, shapes=shapes) for one in pair)
    information = _information(model, limits, pair[0], request)
    told = expected(model, theta, information, basis, request.prior)
    stopped = (Interrupted(),) if interrupted else ()
    notes = (*left, *stopped, *unexcited(model, information, told, request.prior))
    return Design(model, theta, request, limits, space, *pair, told, (first, second), notes)


def _beside(model: Model, limits: MotionLimits, request: Request, slow: tuple[Piece, ...]) -> Request:
    """Return what is asked of the motion where other pieces go before it: their information is known."""
    if not slow:
        return request
    before = Trajectory(limits.joints, slow)
    left = request.duration - before.duration
    known = _information(model, limits, before, request)
    prior = known if request.prior is None else known + request.prior
    return replace(request, duration=left, start=home_of(slow), prior=prior)


def _validation(
    feasible: Feasibility, space: Space, request: Request, basis: BaseParameters, rng: np.random.Generator
) -> Trajectory:
    """Return another motion, at other speeds: one period, from another start, with few steps."""
    period, harmonics = OTHER * min(request.period, request.duration), math.ceil(OTHER * request.harmonics)
    other = replace(request, family="fourier", period=period, harmonics=harmonics, duration=LONG)
    interior = interior_of(feasible, space, replace(other, duration=period), basis)
    found = best_motion(interior, feasible, QUICK, rng)
    return Trajectory(feasible.limits.joints, reached_motion(interior, feasible, found.x, other, rng, most=1))


def _information(model: Model, limits: MotionLimits, trajectory: Trajectory, request: Request) -> Array:
    """Return the information (p, p) of a recording of a motion, of which the fit leaves out slow samples."""
    states = trajectory.states(trajectory.times(request.rate))
    return information_of(model, states, 1 / np.square(request.sigma), slowest(model, limits))
