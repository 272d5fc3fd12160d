"""The optimised motion: what is asked of it, its problem, its search, and the motion from rest to rest."""

from __future__ import annotations

import math
from concurrent.futures import Executor
from contextlib import suppress
from dataclasses import replace

import numpy as np

from dynident.apps.excitation.clearance import refuse_contact
from dynident.apps.excitation.criterion import Criterion, InformationCriterion, base_information
from dynident.apps.excitation.family import ClampedSpline, Family, Fourier, LinearCourse
from dynident.apps.excitation.interior import GridReserve, Interior
from dynident.apps.excitation.limits import Feasibility
from dynident.apps.excitation.search import Plan, SearchResult, search
from dynident.apps.excitation.trajectory import STEP_TOLERANCE, Piece, Purpose
from dynident.apps.excitation.way import from_rest
from dynident.estimators.maximum_likelihood import with_smooth_signs
from dynident.models import Model
from dynident.regression import BaseParameters
from dynident.runtime import ConfigError, InputError, Note, Noun, WordedEnum, choices, join_names
from dynident.runtime.arrays import Array

SIGN_WIDTH = 0.02  # of the velocity limit: the width of the sign of Coulomb friction in the search
POINTS_PER_HARMONIC = 20  # points of the grid by harmonic
MIN_GRID_POINTS = 100  # points of the grid
SPANS_PER_HARMONIC = 2.0  # of a B-spline, by harmonic and period: as free as the series
TYPICAL_PATH_TIME = 4.0  # s that ways and ramps take, about
LARGE_TORQUE_RESERVE = 0.2  # of a torque limit, kept free: a lot
ROS_RATE = 100.0  # Hz: more points than its controllers need make large messages
MAX_RESTARTS = 2  # searches with more to spare, where the limits do not hold between the grid's points
MOTION_SIZES = (1.0, 0.9, 0.75, 0.5, 0.25, 0.1)  # of the motion found, which are tried


class Program(WordedEnum):
    """Pieces that the arm drives: the optimised motion, each joint at constant speeds, poses for gravity, or
    all of these."""

    MOTION = "motion", "An optimised motion"
    FRICTION = "friction", "Each joint at constant speeds"
    GRAVITY = "gravity", "Poses for gravity"
    ALL = "all", "An optimised motion, constant speeds and poses for gravity"


class MotionRequest(Noun):
    """Request for a motion of at most ``duration`` (s), recorded at ``rate`` (Hz) with torque noise ``sigma``
    (n), N m or N.

    ``family`` is "fourier" or "bspline"; ``period`` (s) and ``harmonics`` are those of the series. ``start``
    (n) is the pose at rest where the motion begins and ends (None: chosen). ``named`` are the parameters of
    the A-optimal criterion (none: all base parameters), ``prior`` (p, p) is prior information on the
    parameters, ``starts`` is the number of starts of the search, ``clearance`` (m) is kept from everything,
    and a series is repeated at most ``max_periods`` times. The files of the motion have ``file_rate`` (Hz).
    """

    sigma: Array
    program: Program = Program.MOTION
    criterion: Criterion = Criterion.D_OPTIMAL
    family: str = "fourier"
    duration: float = 30.0
    period: float = 5.0
    harmonics: int = 5
    rate: float = 250.0
    file_rate: float = 250.0
    start: Array | None = None
    named: tuple[str, ...] = ()
    prior: Array | None = None
    starts: int = 8
    clearance: float = 0.01
    max_periods: int | None = None

    @property
    def step(self) -> float:
        """Time (s) between the points for ROS 2, of which pieces take whole multiples."""
        return point_spacing(self.file_rate) / self.file_rate


def point_spacing(rate: float) -> int:
    """Return how many samples at a ``rate`` (Hz) lie between points for ROS 2, so that these are at most 100 per s."""
    return max(1, math.ceil(rate / ROS_RATE - STEP_TOLERANCE))


class LeftOut(Note):
    """Terms with memory, by their kind, were left out of the design: their information is not counted."""

    terms: tuple[str, ...]

    def __str__(self) -> str:
        return (
            f"Terms that remember the motion ({', '.join(self.terms)}) are left out of the design: what it tells of "
            "them is not known."
        )


def without_memory(
    model: Model, theta: Array, request: MotionRequest
) -> tuple[Model, Array, MotionRequest, tuple[Note, ...]]:
    """Return the model without terms that have memory, with the parameters (p) and the request that fit it."""
    keep_flags = [not term.memory for term in model.terms]
    if all(keep_flags):
        return model, theta, request, ()
    terms = list(zip(model.terms, keep_flags, strict=True))
    kept_columns = np.concatenate([np.full(len(term.parameters), keep) for term, keep in terms])
    reduced_model = replace(model, terms=tuple(term for term, keep in terms if keep), load=None)
    prior = None if request.prior is None else request.prior[np.ix_(kept_columns, kept_columns)]
    note = LeftOut(tuple(type(term).__name__ for term, keep in terms if not keep))
    return reduced_model, theta[kept_columns], replace(request, prior=prior), (note,)


def check_request(feasible: Feasibility, request: MotionRequest) -> None:
    """Raise ConfigError for a period longer than the motion, and a start that the limits do not allow.

    Raises InputError for a start pose in collision.
    """
    has_motion = request.program in (Program.MOTION, Program.ALL)
    if has_motion and request.family == "fourier" and request.period > request.duration:
        raise ConfigError(
            f"the period of {request.period:g} s is longer than the duration of {request.duration:g} s: give a shorter "
            "period, or a longer duration."
        )
    if request.start is None:
        return
    limits = feasible.limits
    for name, value, low, high in zip(limits.joints, request.start, limits.lower, limits.upper, strict=True):
        if not low <= value <= high:
            raise ConfigError(
                f"start: joint {name!r} is at {value:g}, outside of {low:.4g} to {high:.4g}, which are its limits less "
                "the margin."
            )
    refuse_contact(feasible.space, request.start, request.clearance, "the start")


def criterion_rows(basis: BaseParameters, theta: Array, request: MotionRequest, scale: Array) -> Array | None:
    """Return the rows (k, r) of the A-optimal criterion: the named parameters over the sizes of their values.

    A value of zero is replaced by what is typical by ``scale`` (r). None for another criterion, or no names.
    Raises ConfigError for a name that the model does not have, or that leads no base parameter.
    """
    leading = list(basis.leading)
    for name in request.named:
        if name not in basis.names:
            raise ConfigError(f"parameters: there is no parameter {name!r}; {choices(name, basis.names)}")
        if name not in leading:
            raise ConfigError(
                f"parameters: no motion shows {name!r} by itself; those that lead a base parameter are "
                f"{join_names(leading, 12)}."
            )
    if request.criterion is not Criterion.A_OPTIMAL or not request.named:
        return None
    indices = [leading.index(name) for name in request.named]
    # a parameter that is zero has no relative error: compare it with the typical effect of the others
    sizes = np.abs(basis.to_base(theta)[indices])
    effects = (sizes * scale[indices])[sizes > 0]
    typical_effect = float(np.exp(np.log(effects).mean())) if len(effects) else 1.0
    return np.asarray(
        np.eye(basis.rank)[indices] / np.where(sizes > 0, sizes, typical_effect / scale[indices])[:, None]
    )


class NoPathError(InputError):
    """There is no path from rest into a motion and back that keeps to the limits."""


def build_interior(feasible: Feasibility, request: MotionRequest, basis: BaseParameters) -> Interior:
    """Build the barrier problem of a request, on its grid and with its criterion; signs of friction are smoothed."""
    # the search needs derivatives, which the sign of Coulomb friction does not have at rest
    smooth = replace(feasible, model=with_smooth_signs(feasible.model, SIGN_WIDTH * feasible.limits.velocity))
    family = _make_family(request)
    # enough points for the highest harmonic, or for each span of a spline
    least = (
        POINTS_PER_HARMONIC * family.harmonics
        if isinstance(family, Fourier)
        else POINTS_PER_HARMONIC // 4 * family.size
    )
    points = max(MIN_GRID_POINTS, least)
    grid = (np.arange(points) + 0.5) * family.duration / points
    samples = request.rate * family.duration * _period_count(request, family, TYPICAL_PATH_TIME) / points
    prior = None if request.prior is None else base_information(basis, request.prior)
    weights = samples / np.square(request.sigma)
    information = InformationCriterion(smooth.model, basis.independent, weights, request.criterion, prior)
    information = replace(information, named=criterion_rows(basis, feasible.theta, request, information.scale))
    # log det sums over the parameters, the other criteria do not: scale the barrier to match
    unit = 1.0 if request.criterion is Criterion.D_OPTIMAL else 1.0 / basis.rank
    return Interior(smooth, family, grid, information, GridReserve.minimum(smooth), unit)


def find_best_motion(
    interior: Interior, feasible: Feasibility, plan: Plan, rng: np.random.Generator, executor: Executor | None = None
) -> SearchResult:
    """Find the best motion that keeps to the limits, also between the points of the grid, by the torque of
    ``feasible``.

    Raises InputError where none is found.
    """
    result = search(interior, plan, rng, executor=executor)
    # where limits fail between the points of the grid, search again with a larger reserve
    for _ in range(MAX_RESTARTS):
        reserve = interior.between(result.x, feasible.model)
        if reserve is None or result.interrupted:
            break
        interior = interior.with_reserve(reserve)
        x = interior.shrink(result.x)
        # go on from the motion made smaller by the last stages alone; search anew where that is not possible
        first, next_plan = ((), plan) if x is None else ((x,), plan._replace(stages=plan.stages[-2:]))
        result = search(interior, next_plan, rng, initial=first, executor=executor)
    return _shrink_to_limits(interior, feasible, result)


def _shrink_to_limits(interior: Interior, feasible: Feasibility, result: SearchResult) -> SearchResult:
    """Shrink a motion until it keeps to the limits at all times; InputError where it never does."""
    x, reserve = result.x, interior.between(result.x, feasible.model)
    if reserve is None:
        return result
    # each round adds what the finer grid has found to the reserve, until the motion fits
    while reserve is not None:
        interior = interior.with_reserve(reserve)
        smaller = interior.shrink(x)
        if smaller is None:
            raise InputError(f"no motion was found that keeps to the limits at all times: {_tightest_limit(interior)}.")
        x, reserve = smaller, interior.between(smaller, feasible.model)
    return replace(result, x=x, criterion=interior.information.value(*interior.states(x)[:3]))


def _tightest_limit(interior: Interior) -> str:
    """Name the limit that needs the largest reserve for what lies between the points of the grid."""
    reserve = interior.spare
    if reserve.torque.max() > LARGE_TORQUE_RESERVE or not reserve.distance.size:
        name = interior.limits.joints[int(reserve.torque.argmax())]
        return f"the torque of joint {name!r} changes too quickly; allow it more, or less velocity"
    first, second = interior.feasible.space.pairs[int(reserve.distance.argmax())]
    return f"{first!r} and {second!r} come too close; allow less clearance, or look at what stands there"


def motion_pieces(
    feasible: Feasibility, family: Family, x: Array, request: MotionRequest, rng: np.random.Generator
) -> tuple[Piece, ...]:
    """Return the motion with coefficients x (n, K) from rest to rest, with as many periods as there is time for.

    Raises ``NoPathError`` where there is no path into the motion and
    back, and InputError where the time does not suffice.
    """
    # the time of the paths is known only once they are found: drop periods until all fits into the duration
    path_time = 0.0
    while True:
        periods = _period_count(request, family, path_time)
        periods = periods if request.max_periods is None else min(request.max_periods, periods)
        pieces = from_rest(feasible, LinearCourse(family, x), periods, request.start, rng)
        if pieces is None:
            raise NoPathError(_no_path_message(request))
        duration = sum(piece.course.duration for piece in pieces)
        if duration <= request.duration * (1 + 1e-9):
            return pieces
        if periods == 1:
            raise InputError(
                f"the motion takes {duration:.1f} s with the ways to it and back, more than the {request.duration:.4g} "
                "s that there are: give a longer duration, or a shorter period."
            )
        way_time = sum(piece.course.duration for piece in pieces if piece.purpose is Purpose.WAY)
        path_time = max(path_time + 0.1, way_time)


def reachable_motion(
    interior: Interior, feasible: Feasibility, x: Array, request: MotionRequest, rng: np.random.Generator
) -> tuple[Piece, ...]:
    """Return ``motion_pieces``, of a smaller motion where there is no path into the full one and back.

    An arm may swing to where it can neither rest nor stop.
    """
    pose = interior.mean_pose(x)
    for share in MOTION_SIZES:
        smaller = x if share == 1.0 else pose + share * (x - pose)
        if share < 1.0 and not (interior.is_inside(smaller) and interior.between(smaller, feasible.model) is None):
            continue
        with suppress(NoPathError):
            return motion_pieces(feasible, interior.family, smaller, request, rng)
    raise NoPathError(_no_path_message(request))


def _no_path_message(request: MotionRequest) -> str:
    message = "no way from rest into the motion and back was found that keeps to the limits"
    if request.start is None:
        return f"{message}; look whether the torque limits hold the arm, and what is in its way."
    return f"{message}; give another start pose, or none."


def _make_family(request: MotionRequest) -> Family:
    # in whole steps, so that a motion ends at a point
    if request.family == "fourier":
        return Fourier(_whole_steps(request.period, request.step), request.harmonics)
    length = _whole_steps(request.duration - (0.0 if request.start is None else TYPICAL_PATH_TIME), request.step)
    return ClampedSpline(length, max(6, round(SPANS_PER_HARMONIC * request.harmonics * length / request.period)))


def _whole_steps(duration: float, step: float) -> float:
    return step * max(1, math.floor(duration / step + STEP_TOLERANCE))


def _period_count(request: MotionRequest, family: Family, path_time: float) -> int:
    """Return the number of periods that there is time for, besides paths that take ``path_time`` (s)."""
    return max(1, int((request.duration - path_time) / family.duration + 1e-9)) if request.family == "fourier" else 1
