"""The search for the most informative motion: a barrier that fades, by a limited-memory quasi-Newton method.

Steps are by L-BFGS (Nocedal and Wright 2006, "Numerical optimization", sec. 7.2) from the curvature of the limits on
each joint, and end before any limit: every iterate keeps to all of them. Of several random starts the best half goes on
from stage to stage. The last stage is by ``polish.py``.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError, InputError, brief
from dynident.excitation.interior import Interior, Point
from dynident.excitation.polish import fits, polished
from dynident.excitation.random_motion import random_motion
from dynident.jobs import run_jobs
from dynident.regression.triangular import one_thread

__all__ = ["Found", "Stage", "improved", "search"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Stage:
    """At most ``steps`` with a ``weight`` of the barrier, from the best ``kept`` share of the motions before; with none
    they are by ``polished``, where the problem is small enough for it.
    """

    weight: float
    steps: int
    kept: float = 1.0


STAGES = (Stage(3.0, 40), Stage(0.5, 40, 0.5), Stage(0.1, 60, 0.5), Stage(0.0, 20))
INSTEAD = (Stage(0.02, 100), Stage(0.005, 150))  # of the last, for large problems
MEMORY = 20  # pairs of L-BFGS
LEAST = 5.0  # weight of the curvature at the middle of the limits
ENOUGH = 1e-4  # of the criterion: less than this gained in PATIENCE steps ends a stage
PATIENCE = 10
HALVINGS = 30


@dataclass(frozen=True, eq=False)
class Found:
    """The best coefficients ``x`` (n, K) of a search with their ``criterion``, its number of ``starts``, and whether
    it was ``interrupted``."""

    x: Array
    criterion: float
    starts: int
    interrupted: bool = False

    __repr__ = brief


class _Job(NamedTuple):
    """A motion on its way: its number, the seed of its start or its coefficients, and the stage it is at."""

    number: int
    seed: int
    x: Array | None
    stage: int


class _Reached(NamedTuple):
    """The best of a motion at a stage, by its criterion, and where it goes on."""

    number: int
    seed: int
    x: Array
    criterion: float


def search(
    interior: Interior,
    starts: int,
    rng: np.random.Generator,
    *,
    first: Sequence[Array] = (),
    stages: Sequence[Stage] = STAGES,
    executor: Executor | None = None,
    progress: Callable[[float, int, int], None] | None = None,
) -> Found:
    """Return the best motion from ``starts`` random ones, or from the ``first`` where there are any.

    ``progress`` is called with the best criterion so far, and how many of all stages of motions are done. The result
    depends on the generator alone, not on the executor. Ctrl-C ends the search with the best motion so far,
    where there is one. Raises InputError where no start keeps to the limits.
    """
    seeds = rng.integers(2**32, size=starts).tolist()
    jobs = [_Job(k, 0, x, 0) for k, x in enumerate(first)] or [_Job(k, seed, None, 0) for k, seed in enumerate(seeds)]
    count, best, interrupted = len(jobs), list[_Reached](), False
    sizes = [count]
    for stage in stages[1:]:
        sizes.append(max(1, int(np.ceil(sizes[-1] * stage.kept))))
    total, done = sum(sizes), 0
    try:
        for k in range(len(stages)):
            reached, reason = list[_Reached](), ""
            for one in run_jobs(partial(_run, interior, tuple(stages)), jobs, executor):
                done += 1
                if isinstance(one.value, _Reached):
                    reached.append(one.value)
                    best = [min([*best, one.value], key=lambda got: (got.criterion, got.number))]
                else:
                    reason = one.reason if one.value is None else one.value
                if best and progress is not None:
                    progress(best[0].criterion, done, total)
            if not reached:
                raise InputError(f"no motion was found that keeps to the limits: {reason}")
            reached.sort(key=lambda got: (got.criterion, got.number))
            if k + 1 < len(stages):
                jobs = [_Job(got.number, got.seed, got.x, k + 1) for got in reached[: sizes[k + 1]]]
    except KeyboardInterrupt:
        if not best:
            raise
        interrupted = True
    return Found(best[0].x, best[0].criterion, count, interrupted)


def _run(interior: Interior, stages: tuple[Stage, ...], job: _Job) -> _Reached | str:
    """Return where a motion has come to, or why there is none."""
    try:
        return _moved(interior, stages, job)
    except (ConfigError, InputError) as error:
        return str(error)


def _moved(interior: Interior, stages: tuple[Stage, ...], job: _Job) -> _Reached:
    with one_thread():
        x = random_motion(interior, np.random.default_rng(job.seed)) if job.x is None else job.x
        stage = stages[job.stage]
        if stage.weight:
            x, criterion = improved(interior, x, stage)
        elif fits(interior):
            x, criterion = polished(interior, x, stage.steps)
        else:
            for one in INSTEAD:
                x, criterion = improved(interior, x, one)
        return _Reached(job.number, job.seed, x, criterion)


def improved(interior: Interior, x: Array, stage: Stage) -> tuple[Array, float]:
    """Return the motion of a stage with the best criterion, from a motion that keeps to the limits, and its criterion.

    Raises InputError where it does not keep to them.
    """
    here = interior.at(x, stage.weight)
    if here is None:
        raise InputError("the motion that a search begins with does not keep to the limits, or shows nothing.")
    best, history, values = (x, here.criterion), deque[tuple[Array, Array, float]](maxlen=MEMORY), [here.value]
    metric = interior.metric(x, stage.weight, LEAST)
    for _ in range(stage.steps):
        step = _direction(metric, history, here.gradient)
        slope = float((step * here.gradient).sum())
        if slope >= 0:
            history.clear()
            step = _direction(metric, history, here.gradient)
            slope = float((step * here.gradient).sum())
        moved = _along(interior, x, step, here, slope, stage.weight)
        if moved is None:
            if not history:
                break
            history.clear()
            metric = interior.metric(x, stage.weight, LEAST)
            continue
        new, there = moved
        change, bend = new - x, there.gradient - here.gradient
        if (curved := float((change * bend).sum())) > 1e-10 * np.linalg.norm(change) * np.linalg.norm(bend):
            history.append((change, bend, 1.0 / curved))
        x, here = new, there
        if here.criterion < best[1]:
            best = x, here.criterion
        values.append(here.value)
        if len(values) > PATIENCE and values[-PATIENCE - 1] - values[-1] < ENOUGH * interior.unit:
            break
    return best


def _direction(metric: Array, history: Sequence[tuple[Array, Array, float]], gradient: Array) -> Array:
    """Return the step of L-BFGS (n, K) by the two loops over its pairs."""
    q, shares = gradient.copy(), list[float]()
    for change, bend, inverse in reversed(history):
        shares.append(inverse * float((change * q).sum()))
        q -= shares[-1] * bend
    r = np.linalg.solve(metric, q[..., None])[..., 0]
    for (change, bend, inverse), share in zip(history, reversed(shares), strict=True):
        r += change * (share - inverse * float((bend * r).sum()))
    return np.asarray(-r)


def _along(
    interior: Interior, x: Array, step: Array, here: Point, slope: float, weight: float
) -> tuple[Array, Point] | None:
    """Return the motion and its point at which the value is low enough along a step; None where it is nowhere."""
    size = min(1.0, _free(interior, x, step))
    for _ in range(HALVINGS):
        new = x + size * step
        there = interior.at(new, weight)
        if there is not None and there.value <= here.value + 1e-4 * size * slope:
            return new, there
        size *= 0.5 if there is None else _shorter(here.value, slope, there.value, size)
    return None


def _shorter(value: float, slope: float, reached: float, size: float) -> float:
    """Return by how much a step is made shorter, by the parabola through what is known."""
    fall = reached - value - slope * size
    return float(np.clip(-slope * size / (2 * fall), 0.1, 0.6)) if fall > 0 else 0.5


def _free(interior: Interior, x: Array, step: Array) -> float:
    """Return how much of a step is free of the limits of q, dq, ddq and jerk, less a little."""
    room, rate = interior.room(x), interior.moved(step)
    taken = np.array([rate, -rate])
    with np.errstate(divide="ignore"):
        return 0.98 * float(np.where(taken > 0, room / np.where(taken > 0, taken, 1.0), np.inf).min())
