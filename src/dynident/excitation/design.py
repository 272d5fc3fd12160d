"""The design of a motion: the most informative one within the limits, and what it will tell."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError, Note, Severity, brief
from dynident.estimators.maximum_likelihood import with_smooth_signs
from dynident.excitation.bspline import Clamped
from dynident.excitation.criterion import InformationCriterion, base_information
from dynident.excitation.expected import Expected, expected, information_of, unexcited
from dynident.excitation.family import Family
from dynident.excitation.feasibility import Feasibility
from dynident.excitation.fourier import Fourier
from dynident.excitation.interior import Interior, Spare
from dynident.excitation.limits import MotionLimits
from dynident.excitation.ramp import from_rest
from dynident.excitation.request import Criterion, Request
from dynident.excitation.request_checks import check_request, named_rows, without_memory
from dynident.excitation.search import STAGES, Found, Stage, search
from dynident.excitation.space import Distances, Space
from dynident.excitation.trajectory import Purpose, Trajectory
from dynident.excitation.verify import Verified, verify
from dynident.models import Model
from dynident.regression import BaseParameters, structural_base_parameters

__all__ = ["Design", "Interrupted", "design", "interior_of"]

Array = NDArray[np.float64]
SMOOTH = 0.02  # of the velocity limit: the width of the sign of Coulomb friction in the search
FINE = 20  # points of the grid by harmonic
FEWEST = 100  # points of the grid
SPANS = 2.0  # of a B-spline, by harmonic and period: as free as the series
AROUND = 4.0  # s that ways and ramps take, about
ROUNDS = 4  # of the search, with more to spare where the limits do not hold between the grid's points
OTHER = 0.79  # of the period: the validation motion has other speeds
QUICK = (Stage(1.0, 40), Stage(0.1, 40))


class Plan(NamedTuple):
    """How many starts a search has, and its stages."""

    starts: int
    stages: tuple[Stage, ...] = STAGES


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
    interior = interior_of(model, theta, limits, space, request, basis)
    found, interior = _searched(interior, model, Plan(request.starts), rng, executor, say)
    say("finding the ways to it and back")
    trajectory = _trajectory(model, interior, found.x, request, rng)
    say("a second motion, for validation")
    validation = _validation(model, theta, limits, space, request, basis, rng)
    say("checking both")
    pair = trajectory, validation
    first, second = (verify(one, model, theta, limits, space, request.clearance, shapes=shapes) for one in pair)
    information = _information(model, trajectory, request)
    told = expected(model, theta, information, basis)
    stopped = (Interrupted(),) if found.interrupted else ()
    notes = (*left, *stopped, *unexcited(model, information, told))
    return Design(model, theta, request, limits, space, *pair, told, (first, second), notes)


def interior_of(
    model: Model, theta: Array, limits: MotionLimits, space: Space, request: Request, basis: BaseParameters
) -> Interior:
    """Return the motions that a request asks for, on their grid, with the criterion."""
    soft = with_smooth_signs(model, SMOOTH * limits.velocity)
    family = _family(request)
    points = _points(family)
    grid = (np.arange(points) + 0.5) * family.duration / points
    samples = request.rate * family.duration * _periods(request, family) / points
    prior = None if request.prior is None else base_information(basis, request.prior)
    weights = samples / np.square(request.sigma)
    information = InformationCriterion(soft, basis.independent, weights, request.criterion, prior)
    information = replace(information, named=named_rows(basis, theta, request, information.scale))
    unit = 1.0 if request.criterion is Criterion.D_OPTIMAL else 1.0 / basis.rank
    feasible = Feasibility(soft, theta, limits, space, request.clearance)
    return Interior(feasible, space, family, grid, information, Spare.least(feasible, space), unit)


def _family(request: Request) -> Family:
    if request.family == "fourier":
        return Fourier(request.period, request.harmonics)
    length = request.duration - (0.0 if request.start is None else AROUND)
    return Clamped(length, max(6, round(SPANS * request.harmonics * length / request.period)))


def _points(family: Family) -> int:
    wanted = FINE * family.harmonics if isinstance(family, Fourier) else FINE // 2 * family.size // 2
    return max(FEWEST, wanted)


def _periods(request: Request, family: Family, around: float = AROUND) -> int:
    """Return how many periods there is time for, beside ways that take ``around`` (s)."""
    return max(1, int((request.duration - around) / family.duration + 1e-9)) if request.family == "fourier" else 1


def _searched(
    interior: Interior,
    model: Model,
    plan: Plan,
    rng: np.random.Generator,
    executor: Executor | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> tuple[Found, Interior]:
    """Return the best motion that keeps to the limits also between the points of the grid."""
    found = search(interior, plan.starts, rng, stages=plan.stages, executor=executor, progress=say)
    for _ in range(ROUNDS):
        beyond = interior.between(found.x, model)
        if beyond is None:
            return found, interior
        interior = interior.wider(beyond)
        x = interior.smaller(found.x)
        if found.interrupted and x is not None:
            found = replace(found, x=x)
            continue
        first, stages = ((), plan.stages) if x is None else ((x,), plan.stages[-2:])
        again = search(interior, plan.starts, rng, first=first, stages=stages, executor=executor, progress=say)
        found = replace(again, interrupted=found.interrupted or again.interrupted)
    raise InputError("no motion was found that keeps to the limits at all times: allow more torque, or less clearance.")


def _trajectory(
    model: Model, interior: Interior, x: Array, request: Request, rng: np.random.Generator, most: int | None = None
) -> Trajectory:
    """Return the motion from rest to rest, with as many periods as there is time for."""
    feasible = replace(interior.feasible, model=model)
    around = 0.0
    for _ in range(3):
        periods = _periods(request, interior.family, around)
        periods = periods if most is None else min(most, periods)
        pieces = from_rest(feasible, interior.family, x, periods, request.start, rng)
        if pieces is None:
            raise InputError(
                "no way was found from the start pose to the motion that keeps to the limits; give another."
            )
        found = Trajectory(interior.limits.joints, pieces)
        if found.duration <= request.duration * (1 + 1e-9):
            return found
        around = sum(piece.course.duration for piece in pieces if piece.purpose is Purpose.WAY)
        if periods == 1:
            break
    raise InputError(
        f"the motion takes {found.duration:.1f} s with the ways to it and back, more than the duration of "
        f"{request.duration:g} s: give a longer one, or a shorter period."
    )


def _validation(
    model: Model,
    theta: Array,
    limits: MotionLimits,
    space: Space,
    request: Request,
    basis: BaseParameters,
    rng: np.random.Generator,
) -> Trajectory:
    """Return another motion, at other speeds: one period, from another start, with few steps."""
    other = replace(request, family="fourier", period=OTHER * request.period, starts=2)
    interior = interior_of(model, theta, limits, space, other, basis)
    found, interior = _searched(interior, model, Plan(2, QUICK), rng)
    return _trajectory(model, interior, found.x, other, rng, most=1)


def _information(model: Model, trajectory: Trajectory, request: Request) -> Array:
    """Return the information (p, p) of a recording of a motion, and of what is known before."""
    states = trajectory.states(trajectory.times(request.rate))
    found = information_of(model, states, 1 / np.square(request.sigma))
    return found if request.prior is None else found + request.prior
