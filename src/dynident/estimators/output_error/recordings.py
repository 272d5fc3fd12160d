"""The stretches of recordings that are simulated, and what drives the model there."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError
from dynident.estimators.estimator import Problem
from dynident.estimators.loops import log_of
from dynident.estimators.output_error.shots import Shots
from dynident.log import Controller, Motion
from dynident.regression import fitted_rows, stretches
from dynident.simulation import ticks

__all__ = ["closed_shots", "open_shots", "torque_shots"]

Array = NDArray[np.float64]
FEWEST, SHORTEST = 10, 0.1  # samples of a stretch, and its share of the longest one


def closed_shots(problem: Problem, k: int, controller: Controller) -> Shots:
    """Return the k-th recording in the loop of its controller, which goes on where samples are not used, and as fast as
    its references are known."""
    return _refined(_closed(problem, k, controller))


def _closed(problem: Problem, k: int, controller: Controller) -> Shots:
    motion = _stamped(problem.motions[k])
    usable = np.flatnonzero(motion.mask)
    if len(usable) < FEWEST:
        raise _too_few(motion)
    rows, measured = slice(int(usable[0]), int(usable[-1]) + 1), _measured(problem, k, motion)
    return Shots(motion, measured, _counted(motion), rows, np.inf, controller)


def open_shots(problem: Problem, k: int, segment: float, torque: Array | None = None) -> Iterator[Shots]:
    """Yield the stretches of the k-th recording, but short ones, whose positions are met in segments of so many s.

    Positions are simulated when they are stamped; ``torque`` (N, n) is that of then, by default the measured one.
    """
    motion = problem.motions[k]
    driven = replace(_stamped(motion), tau=_averaged(_late(motion) if torque is None else torque))
    found = stretches(driven.mask)
    least = max(FEWEST, SHORTEST * max((one.stop - one.start for one in found), default=0))
    long = [one for one in found if one.stop - one.start >= least]
    if not long:
        raise _too_few(motion)
    for rows in long:
        yield Shots(driven, _measured(problem, k, driven), np.ones(driven.q.shape), rows, segment)


def torque_shots(problem: Problem, k: int, controller: Controller) -> Shots:
    """Return the k-th recording in the loop of its controller, whose torque is to be met; where equations are left out
    of the regression, torques are."""
    motion, shots = problem.motions[k], _closed(problem, k, controller)
    keep = fitted_rows(motion, problem.regression.min_speed)
    count = _counted(motion) if keep is None else _counted(motion) * keep
    met = replace(shots, measured=motion.tau, count=count, output="tau", after=motion.time_offset)
    return _refined(met)


def _refined(shots: Shots) -> Shots:
    """Return the same at the times of the controller's references, where these are more than those of the recording."""
    found = ticks(shots.motion, shots.controller, shots.rows)
    if found.motion is shots.motion:
        return shots
    measured, count = np.zeros_like(found.motion.q), np.zeros_like(found.motion.q)
    measured[found.at], count[found.at] = shots.measured[shots.rows], shots.count[shots.rows]
    return replace(shots, motion=found.motion, measured=measured, count=count, rows=found.rows)


def _stamped(motion: Motion) -> Motion:
    """Return the motion when its positions are stamped: a controller sees them then."""
    return motion.shifted(-motion.time_offset)


def _measured(problem: Problem, k: int, motion: Motion) -> Array:
    """Return the positions (N, n) as measured, without a log those of the motion."""
    log = log_of(problem, k)
    return motion.q if log is None else log.q


def _counted(motion: Motion) -> Array:
    """Return 1 where samples may be used, else 0 (N, n)."""
    return np.repeat(motion.mask[:, None], len(motion.joints), axis=1).astype(float)


def _too_few(motion: Motion) -> InputError:
    return InputError(
        f"{motion.source}: too few usable samples in a row to simulate: give at least {FEWEST}, or an estimator that "
        "simulates nothing."
    )


def _late(motion: Motion) -> Array:
    """Return the torque when the positions are stamped: they are stamped later by the time offset."""
    if not motion.time_offset:
        return motion.tau
    t = motion.t - motion.time_offset
    return np.column_stack([np.interp(t, motion.t, one) for one in motion.tau.T])


def _averaged(tau: Array) -> Array:
    """Return the torque (N, n) whose means of neighbours are those of a smooth torque between the samples."""
    found = tau.copy()
    found[1:-1] -= np.diff(tau, 2, axis=0) / 12.0
    return found
