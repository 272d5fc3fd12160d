"""The optimised motion of a design: what is sought, the search, and the motion from rest to rest."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError, Step
from dynident.estimators.maximum_likelihood import with_smooth_signs
from dynident.excitation.criterion import InformationCriterion, base_information
from dynident.excitation.interior import Interior, Spare
from dynident.excitation.request import Criterion, Request
from dynident.excitation.request_checks import named_rows
from dynident.excitation.search import STAGES, Found, Stage, search
from dynident.excitation.spaces.space import Space
from dynident.excitation.trajectories.bspline import Clamped
from dynident.excitation.trajectories.family import Family
from dynident.excitation.trajectories.feasibility import Feasibility
from dynident.excitation.trajectories.fourier import Fourier
from dynident.excitation.trajectories.ramp import from_rest
from dynident.excitation.trajectories.trajectory import Piece, Purpose
from dynident.regression import BaseParameters

__all__ = ["NoWayError", "Plan", "best_motion", "interior_of", "motion_pieces", "reached_motion"]

Array = NDArray[np.float64]
SMOOTH = 0.02  # of the velocity limit: the width of the sign of Coulomb friction in the search
FINE = 20  # points of the grid by harmonic
FEWEST = 100  # points of the grid
SPANS = 2.0  # of a B-spline, by harmonic and period: as free as the series
AROUND = 4.0  # s that ways and ramps take, about
WIDE = 0.2  # of a torque limit, kept free: a lot
AGAIN = 2  # searches with more to spare, where the limits do not hold between the grid's points
SIZES = (1.0, 0.9, 0.75, 0.5, 0.25, 0.1)  # of the motion found, which are tried


class NoWayError(InputError):
    """From rest into a motion and back there is no way that keeps to the limits."""


class Plan(NamedTuple):
    """How many starts a search has, and its stages."""

    starts: int
    stages: tuple[Stage, ...] = STAGES


def interior_of(feasible: Feasibility, space: Space, request: Request, basis: BaseParameters) -> Interior:
    """Return the motions that a request asks for, on their grid, with the criterion; signs of friction are smooth."""
    soft = replace(feasible, model=with_smooth_signs(feasible.model, SMOOTH * feasible.limits.velocity))
    family = _family(request)
    points = max(FEWEST, FINE * family.harmonics if isinstance(family, Fourier) else FINE // 4 * family.size)
    grid = (np.arange(points) + 0.5) * family.duration / points
    samples = request.rate * family.duration * _periods(request, family, AROUND) / points
    prior = None if request.prior is None else base_information(basis, request.prior)
    weights = samples / np.square(request.sigma)
    information = InformationCriterion(soft.model, basis.independent, weights, request.criterion, prior)
    information = replace(information, named=named_rows(basis, feasible.theta, request, information.scale))
    unit = 1.0 if request.criterion is Criterion.D_OPTIMAL else 1.0 / basis.rank
    return Interior(soft, space, family, grid, information, Spare.least(soft, space), unit)


def best_motion(
    interior: Interior,
    feasible: Feasibility,
    plan: Plan,
    rng: np.random.Generator,
    executor: Executor | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> Found:
    """Return the best motion that keeps to the limits, also between the points of the grid and by the torque of
    ``feasible``; InputError where none is found."""

    def say(best: float, done: int, total: int) -> None:
        progress(Step(f"searching, best so far: {_worded(interior.information, best)}", done, total))

    found = search(interior, plan.starts, rng, stages=plan.stages, executor=executor, progress=say)
    for _ in range(AGAIN):
        beyond = interior.between(found.x, feasible.model)
        if beyond is None or found.interrupted:
            break
        interior = interior.wider(beyond)
        x = interior.smaller(found.x)
        first, stages = ((), plan.stages) if x is None else ((x,), plan.stages[-2:])
        found = search(interior, plan.starts, rng, first=first, stages=stages, executor=executor, progress=say)
    return _kept(interior, feasible, found)


def _kept(interior: Interior, feasible: Feasibility, found: Found) -> Found:
    """Return a motion made smaller until it keeps to the limits at all times; InputError where it does not."""
    x, beyond = found.x, interior.between(found.x, feasible.model)
    if beyond is None:
        return found
    while beyond is not None:
        interior = interior.wider(beyond)
        smaller = interior.smaller(x)
        if smaller is None:
            raise InputError(f"no motion was found that keeps to the limits at all times: {_in_the_way(interior)}.")
        x, beyond = smaller, interior.between(smaller, feasible.model)
    return replace(found, x=x, criterion=interior.information.value(*interior.states(x)[:3]))


def _in_the_way(interior: Interior) -> str:
    """Return which limit most must be kept free of, for what lies between the points of the grid."""
    spare = interior.spare
    if spare.torque.max() > WIDE or not spare.distance.size:
        name = interior.limits.joints[int(spare.torque.argmax())]
        return f"the torque of joint {name!r} changes too quickly; allow it more, or less velocity"
    one, other = interior.space.pairs[int(spare.distance.argmax())]
    return f"{one!r} and {other!r} come too close; allow less clearance, or look at what stands there"


def motion_pieces(
    feasible: Feasibility, family: Family, x: Array, request: Request, rng: np.random.Generator, most: int | None = None
) -> tuple[Piece, ...]:
    """Return the motion of coefficients x (n, K) from rest to rest, with as many periods, ``most`` at the most, as
    there is time for.

    Raises ``NoWayError`` where there is none, InputError where there is not the time.
    """
    around = 0.0
    while True:
        periods = _periods(request, family, around)
        periods = periods if most is None else min(most, periods)
        pieces = from_rest(feasible, family, x, periods, request.start, rng)
        if pieces is None:
            raise NoWayError(_no_way(request))
        taken = sum(piece.course.duration for piece in pieces)
        if taken <= request.duration * (1 + 1e-9):
            return pieces
        if periods == 1:
            raise InputError(
                f"the motion takes {taken:.1f} s with the ways to it and back, more than the {request.duration:.4g} s "
                "that there are: give a longer duration, or a shorter period."
            )
        around = max(around + 0.1, sum(one.course.duration for one in pieces if one.purpose is Purpose.WAY))


def reached_motion(
    interior: Interior,
    feasible: Feasibility,
    x: Array,
    request: Request,
    rng: np.random.Generator,
    most: int | None = None,
) -> tuple[Piece, ...]:
    """Return ``motion_pieces``, of a smaller motion where there is no way into a large one and back: an arm may swing
    to where it can neither rest nor stop."""
    pose = interior.middle_of(x)
    for share in SIZES:
        smaller = x if share == 1.0 else pose + share * (x - pose)
        if share < 1.0 and not (interior.keeps(smaller) and interior.between(smaller, feasible.model) is None):
            continue
        with suppress(NoWayError):
            return motion_pieces(feasible, interior.family, smaller, request, rng, most)
    raise NoWayError(_no_way(request))


def _no_way(request: Request) -> str:
    what = "no way from rest into the motion and back was found that keeps to the limits"
    if request.start is None:
        return f"{what}; look whether the torque limits hold the arm, and what is in its way."
    return f"{what}; give another start pose, or none."


def _family(request: Request) -> Family:
    if request.family == "fourier":
        return Fourier(request.period, request.harmonics)
    length = request.duration - (0.0 if request.start is None else AROUND)
    return Clamped(length, max(6, round(SPANS * request.harmonics * length / request.period)))


def _periods(request: Request, family: Family, around: float) -> int:
    """Return how many periods there is time for, beside ways that take ``around`` (s)."""
    return max(1, int((request.duration - around) / family.duration + 1e-9)) if request.family == "fourier" else 1


def _worded(information: InformationCriterion, value: float) -> str:
    """Return the value of a criterion as it is known."""
    match information.kind:
        case Criterion.D_OPTIMAL:
            return f"log det {2 * np.log(information.scale).sum() - value:.1f}"
        case Criterion.A_OPTIMAL:
            return f"variances {np.exp(value):.3g}"
        case Criterion.CONDITION:
            return f"condition number {np.exp(value):.1f}"
