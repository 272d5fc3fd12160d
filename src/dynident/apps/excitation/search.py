"""Search for the most informative motion: a barrier that fades, with a limited-memory quasi-Newton method.

The steps are those of L-BFGS (Nocedal and Wright 2006, "Numerical optimization", sec. 7.2), from the
curvature of the limits on each joint, and end before any limit: every iterate keeps to all of them. Of
several random starts the better half goes on from stage to stage. The last stage polishes small problems.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from dynident.apps.excitation.criterion import Criterion, InformationCriterion
from dynident.apps.excitation.interior import BarrierPoint, Interior
from dynident.apps.excitation.polish import is_small_enough, polish_motion
from dynident.regression import one_thread
from dynident.runtime import ConfigError, InputError, Noun, Step, report_progress
from dynident.runtime.arrays import Array
from dynident.runtime.jobs import run_jobs

POSE_TRIALS = 20  # that are tried
SHRINK_FACTOR = 0.8
MIN_SIZE = 1e-3  # of the limits: a motion this small is none
SIZE_SHARE = 0.95  # of the largest size that keeps to the limits
HISTORY_LENGTH = 20  # pairs of L-BFGS
CENTRE_WEIGHT = 5.0  # weight of the curvature at the middle of the limits
MIN_GAIN, PATIENCE = 1e-4, 10  # of the criterion; steps: less than this gained in so many ends a stage
MAX_LINE_STEPS = 30


def random_motion(interior: Interior, rng: np.random.Generator) -> Array:
    """Return the coefficients (n, K) of a random motion that keeps to all limits, about as large as they allow.

    The motion is about a random pose. Each joint uses a random share of what its own limits allow, then all are
    shrunk together until torques and distances are kept. Raises ConfigError where the arm can stand in no pose,
    and InputError where it can move about none.
    """
    n, K = len(interior.limits.joints), interior.family.size
    for pose in interior.feasible.random_poses(POSE_TRIALS, rng):
        shape = rng.normal(size=(n, K))
        # the constant coefficient keeps the mean of the motion at the pose
        shape[:, 0] = -interior.functions[0, :, 1:].mean(axis=0) @ shape[:, 1:].T
        centre = np.zeros((n, K))
        centre[:, 0] = pose
        joint_shares = rng.uniform(0.3, 1.0, n)
        candidate = centre + shape * (joint_shares * _largest_sizes(interior, centre, shape))[:, None]
        x = _shrink_to_feasible(interior, centre, candidate)
        if x is not None:
            return x
    raise InputError("no random motion keeps to the limits; look at the obstacles, the clearance and the limits.")


def _largest_sizes(interior: Interior, centre: Array, shape: Array) -> Array:
    """Return the size (n) of a shape that each joint's own limits allow about a pose."""
    low, high = np.zeros(len(centre)), np.full(len(centre), 1e3)
    # bisection on a logarithmic scale, all joints at once: ranges do not couple them
    for _ in range(40):
        size = np.sqrt(np.maximum(low, 1e-9) * high)
        x = centre + size[:, None] * shape
        is_inside = (interior.range_slack(x) > 0).all(axis=(0, 1))
        low, high = np.where(is_inside, size, low), np.where(is_inside, high, size)
    return low


def _shrink_to_feasible(interior: Interior, centre: Array, candidate: Array) -> Array | None:
    """Shrink a motion towards a pose until it keeps to the limits; None where hardly any motion is left."""
    size = 1.0
    while not interior.is_inside(centre + size * (candidate - centre)):
        size *= SHRINK_FACTOR
        if size < MIN_SIZE:
            return None
    # refine between the last size that fits and the first that does not
    feasible_size, infeasible_size = size, min(size / SHRINK_FACTOR, 1.0)
    for _ in range(5):
        middle = (feasible_size + infeasible_size) / 2
        is_inside = interior.is_inside(centre + middle * (candidate - centre))
        feasible_size, infeasible_size = (middle, infeasible_size) if is_inside else (feasible_size, middle)
    return centre + SIZE_SHARE * feasible_size * (candidate - centre)


@dataclass(frozen=True)
class Stage:
    """At most ``steps`` with a ``weight`` of the barrier, from the best ``kept_share`` of the motions before.

    Without weight the steps are those of ``polish_motion``, where the problem is small enough for it.
    """

    weight: float
    steps: int
    kept_share: float = 1.0


STAGES = (Stage(3.0, 40), Stage(0.5, 40, 0.5), Stage(0.1, 60, 0.5), Stage(0.0, 96))
LARGE_PROBLEM_STAGES = (Stage(0.02, 100), Stage(0.005, 150))  # of the last, for large problems


class Plan(NamedTuple):
    """Number of starts of a search, and its stages."""

    starts: int
    stages: tuple[Stage, ...] = STAGES


class SearchResult(Noun):
    """Best coefficients ``x`` (n, K) of a search with their ``criterion``, and whether it was ``interrupted``."""

    x: Array
    criterion: float
    interrupted: bool = False


class _SearchMotion(NamedTuple):
    """A motion of a search: its number, the seed of its start, its coefficients and their criterion, once known."""

    number: int
    seed: int = 0
    x: Array | None = None
    criterion: float = np.inf


def search(
    interior: Interior,
    plan: Plan,
    rng: np.random.Generator,
    *,
    initial: Sequence[Array] = (),
    executor: Executor | None = None,
) -> SearchResult:
    """Return the best motion from random ones, or from the ``initial`` ones where there are any.

    The steps that are reported name the best criterion so far. The result depends on the generator alone, not on
    the executor. Ctrl-C ends the search with the best motion so far, where there is one. Raises InputError where no
    start keeps to the limits.
    """
    stages = plan.stages
    seeds = rng.integers(2**32, size=plan.starts).tolist()
    motions = [_SearchMotion(k, x=x) for k, x in enumerate(initial)] or [
        _SearchMotion(k, seed) for k, seed in enumerate(seeds)
    ]
    best, interrupted = list[_SearchMotion](), False
    job_counts = [len(motions)]
    # each stage goes on with the best share of the motions, so that the expensive ones are few
    for stage in stages[1:]:
        job_counts.append(max(1, int(np.ceil(job_counts[-1] * stage.kept_share))))
    total, completed = sum(job_counts), 0
    try:
        for stage, job_count in zip(stages, job_counts, strict=True):
            results, reason = list[_SearchMotion](), ""
            for job_result in run_jobs(partial(_run_stage, interior, stage), motions[:job_count], executor):
                completed += 1
                if isinstance(job_result.value, _SearchMotion):
                    results.append(job_result.value)
                    # ties go to the lower number: the result does not depend on the order in which jobs end
                    best = [min([*best, job_result.value], key=_merit)]
                else:
                    reason = job_result.reason if job_result.value is None else job_result.value
                if best:
                    words = _criterion_words(interior.information, best[0].criterion)
                    report_progress(Step(f"searching, best so far: {words}", completed, total))
            if not results:
                raise InputError(f"no motion was found that keeps to the limits: {reason}")
            motions = sorted(results, key=_merit)
    # on Ctrl-C the best motion so far is as valid as the final one: all iterates keep to the limits
    except KeyboardInterrupt:
        if not best:
            raise
        interrupted = True
    return SearchResult(np.asarray(best[0].x), best[0].criterion, interrupted)


def _merit(motion: _SearchMotion) -> tuple[float, int]:
    return motion.criterion, motion.number


def _criterion_words(information: InformationCriterion, value: float) -> str:
    """Return the value of a criterion in its usual form."""
    match information.kind:
        case Criterion.D_OPTIMAL:
            return f"log det {2 * np.log(information.scale).sum() - value:.1f}"
        case Criterion.A_OPTIMAL:
            return f"variances {np.exp(value):.3g}"
        case Criterion.CONDITION:
            return f"condition number {np.exp(value):.1f}"


def _run_stage(interior: Interior, stage: Stage, motion: _SearchMotion) -> _SearchMotion | str:
    """Return a motion after a stage, or the reason why there is none."""
    with one_thread():
        try:
            x = random_motion(interior, np.random.default_rng(motion.seed)) if motion.x is None else motion.x
            if stage.weight:
                x, criterion = improve_motion(interior, x, stage)
            elif is_small_enough(interior):
                x, criterion = polish_motion(interior, x, stage.steps)
            else:
                for final_stage in LARGE_PROBLEM_STAGES:
                    x, criterion = improve_motion(interior, x, final_stage)
        except (ConfigError, InputError) as error:
            return str(error)
    return motion._replace(x=x, criterion=criterion)


def improve_motion(interior: Interior, x: Array, stage: Stage) -> tuple[Array, float]:
    """Return the best motion of a stage and its criterion, from a motion that keeps to the limits.

    Raises InputError where that does not keep to them.
    """
    point = interior.at(x, stage.weight)
    if point is None:
        raise InputError("the motion that a search begins with does not keep to the limits, or shows nothing.")
    best, values = point, [point.value]
    history = deque[tuple[Array, Array, float]](maxlen=HISTORY_LENGTH)
    metric = interior.barrier_curvature(x, stage.weight, CENTRE_WEIGHT)
    for _ in range(stage.steps):
        step = _direction(metric, history, point.gradient)
        # not a direction of descent: forget the history, and take the step by the barrier's curvature alone
        if float((step * point.gradient).sum()) >= 0:
            history.clear()
            step = _direction(metric, history, point.gradient)
        next_point = _line_search(interior, point, step, stage.weight)
        # no point along the step is good enough: try once more without history, from the curvature here
        if next_point is None:
            if not history:
                break
            history.clear()
            metric = interior.barrier_curvature(point.x, stage.weight, CENTRE_WEIGHT)
            continue
        change, gradient_change = next_point.x - point.x, next_point.gradient - point.gradient
        # pairs with little curvature would make the quasi-Newton matrix indefinite
        size = np.linalg.norm(change) * np.linalg.norm(gradient_change)
        if (curvature := float((change * gradient_change).sum())) > 1e-10 * size:
            history.append((change, gradient_change, 1.0 / curvature))
        point = next_point
        best = min(best, point, key=attrgetter("criterion"))
        values.append(point.value)
        if len(values) > PATIENCE and values[-PATIENCE - 1] - values[-1] < MIN_GAIN * interior.unit:
            break
    return best.x, best.criterion


def _direction(metric: Array, history: Sequence[tuple[Array, Array, float]], gradient: Array) -> Array:
    """Return the step of L-BFGS (n, K) by the two loops over its pairs."""
    q, shares = gradient.copy(), list[float]()
    for change, bend, inverse in reversed(history):
        shares.append(inverse * float((change * q).sum()))
        q -= shares[-1] * bend
    # the curvature of the limits on each joint stands for the initial Hessian
    r = np.linalg.solve(metric, q[..., None])[..., 0]
    for (change, bend, inverse), share in zip(history, reversed(shares), strict=True):
        r += change * (share - inverse * float((bend * r).sum()))
    return np.asarray(-r)


def _line_search(interior: Interior, point: BarrierPoint, step: Array, weight: float) -> BarrierPoint | None:
    """Return the first point along a step at which the value is low enough; None without one."""
    slope = float((step * point.gradient).sum())
    # stop short of the ranges, beyond which the barrier does not exist; torques and distances are tried
    size = min(1.0, _free_step(interior, point.x, step))
    for _ in range(MAX_LINE_STEPS):
        next_point = interior.at(point.x + size * step, weight)
        # sufficient decrease (Armijo)
        if next_point is not None and next_point.value <= point.value + 1e-4 * size * slope:
            return next_point
        size *= 0.5 if next_point is None else _step_reduction(point.value, slope, next_point.value, size)
    return None


def _step_reduction(value: float, slope: float, new_value: float, size: float) -> float:
    """Return the factor by which a step is shortened, by the parabola through the known values."""
    # minimum of the parabola through value, slope and the new value, kept away from both ends
    excess = new_value - value - slope * size
    return float(np.clip(-slope * size / (2 * excess), 0.1, 0.6)) if excess > 0 else 0.5


def _free_step(interior: Interior, x: Array, step: Array) -> float:
    """Return the share of a step that is free of the limits of q, dq, ddq and jerk, less a little."""
    room, rate = interior.range_slack(x), interior.constraint_values(step)
    rates = np.array([rate, -rate])
    with np.errstate(divide="ignore"):
        return 0.98 * float(np.where(rates > 0, room / np.where(rates > 0, rates, 1.0), np.inf).min())
