"""The controller that a configuration gives, against the one that ran: the torque it asks for along the motion.

A loop that is simulated is as right as its controller. A wrong one moves what estimators that simulate find by more
than their errors say, and it shows: at the measured motion it asks for another torque than the measured one. Noise of
positions and torque is in this difference, too, so that another setting is named only where it takes much of it away.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.checks.finding import Finding, Topic
from dynident.checks.motion_notes import LoopDiffers, LoopGain, LoopVelocity
from dynident.errors import DynidentError, Severity
from dynident.log import Controller, HasState, Log, Motion
from dynident.simulation import Differenced, HasTimes, longest
from dynident.smoothers import Spline, motion_of

__all__ = ["loop_findings"]

Array = NDArray[np.float64]
SAMPLES, ROWS = 1000, 5000  # of a log, at which a controller is asked; in a row, of one that remembers
FEW = 10  # samples, of which nothing is told
STEPS = range(11)  # of a drive, over which its velocity may be a difference; 0 where it is faster than is said
BETTER, SCALED = 0.65, 0.5  # of the error, which another velocity or factor must leave at most
OFF, LEFT = 0.05, 0.2  # by how much a factor must differ from 1 to be named, and what it may leave of the torque
FAR = 0.5  # share of the torque above which a controller is another one
NOISY = 3.0  # times what the noise of the positions explains of that


@dataclass(frozen=True, eq=False)
class _Asked:
    """Torques (K, n) along a motion: the measured ones, and by the number of steps what the controller asks for;
    ``noise`` (n) is the root mean square that the noise of the positions changes of it."""

    tau: Array
    by_steps: dict[int, Array]
    noise: Array

    def error(self, steps: int, factor: Array | float = 1.0) -> Array:
        """Return the root mean squares (n) of the difference, with a factor (n) on what is asked for."""
        return np.asarray(np.sqrt(np.mean(np.square(self.tau - factor * self.by_steps[steps]), axis=0)))


def loop_findings(logs: Sequence[Log]) -> Iterator[Finding]:
    """Yield what differs between the controllers that logs know and those that ran: the velocity that these see, a
    factor on a joint's torque, or all of it."""
    for log in logs:
        if log.controller is None or log.controller.joints != log.joints:
            continue
        try:
            with np.errstate(all="ignore"):  # what is not finite is left to the simulation, too
                asked, given = _asked(log, log.controller), _steps(log.controller)
        except DynidentError:  # the simulation says it
            continue
        if len(asked.tau) > FEW and all(np.isfinite(one).all() for one in asked.by_steps.values()):
            yield from _findings(log, asked, given)


def _findings(log: Log, asked: _Asked, given: int) -> Iterator[Finding]:
    size = np.sqrt(np.mean(np.square(asked.tau), axis=0))
    moved = size > 0
    if not moved.any():
        return
    total = {steps: _share(asked.error(steps)[moved] / size[moved]) for steps in asked.by_steps}
    best = min(total, key=lambda steps: total[steps])
    if total[best] > BETTER * total[given]:
        best = given
    else:
        velocity = LoopVelocity(given, best, total[given], total[best])
        yield Finding(Severity.WARNING, None, velocity, Topic.LOOP, source=log.source)
    wanted, error = asked.by_steps[best], asked.error(best)
    power = np.sum(wanted**2, axis=0)
    factor = np.where(power > 0, np.sum(wanted * asked.tau, axis=0) / np.where(power > 0, power, 1.0), 1.0)
    left = asked.error(best, factor)
    for j in np.flatnonzero(moved):
        name, share = log.joints[j], float(error[j] / size[j])
        if abs(factor[j] - 1.0) > OFF and left[j] < min(SCALED * error[j], LEFT * size[j]):
            scaled = LoopGain(float(factor[j]), share, float(left[j] / size[j]))
            yield Finding(Severity.WARNING, name, scaled, Topic.LOOP, source=log.source)
        elif share > FAR and error[j] > NOISY * asked.noise[j]:
            yield Finding(Severity.WARNING, name, LoopDiffers(share), Topic.LOOP, source=log.source)


def _share(each: Array) -> float:
    """Return the root mean square of shares (n)."""
    return float(np.sqrt(np.mean(np.square(each))))


def _steps(controller: Controller) -> int:
    return controller.steps if isinstance(controller, Differenced) else 1


def _asked(log: Log, controller: Controller) -> _Asked:
    """Ask a controller for torques along the smoothed motion of a log, with the velocity of each number of steps."""
    loop = controller.loop if isinstance(controller, Differenced) else controller
    motion = motion_of(Spline(), log)
    times = controller.t if isinstance(controller, HasTimes) and len(controller.t) > 1 else log.t
    period = float(np.median(np.diff(times)))
    if isinstance(loop, HasState):  # without gaps, over which its state would be unknown
        rows = np.arange(len(motion))[longest(motion)][:ROWS]
    else:
        rows = np.flatnonzero(motion.mask)
        rows = rows[:: max(len(rows) // SAMPLES, 1)]
    if len(rows) <= FEW:
        return _Asked(motion.tau[rows], {}, np.zeros(len(log.joints)))
    by_steps = {steps: _torques(loop, motion, rows, motion.q[rows], steps * period) for steps in STEPS}
    noisy = _torques(loop, motion, rows, log.q[rows], period)
    noise = np.sqrt(np.mean(np.square(noisy - by_steps[1]), axis=0))
    return _Asked(motion.tau[rows], by_steps, noise)


def _torques(loop: Controller, motion: Motion, rows: NDArray[np.intp], q: Array, over: float) -> Array:
    """Return what a controller asks for (K, n) at positions q (K, n), with the velocity of the time ``over`` (s) before
    each sample: a difference over it is the velocity in its middle."""
    t = motion.t[rows]
    dq = np.column_stack([np.interp(t - over / 2, motion.t, one) for one in motion.dq.T])
    found = np.empty_like(q)
    if not isinstance(loop, HasState):
        for k, time in enumerate(t.tolist()):
            found[k] = loop(time, q[k], dq[k])
        return found
    gaps = np.diff(t, prepend=2 * t[0] - t[1]).tolist()
    state = loop.begin(float(t[0]), gaps[0], q[0], dq[0], motion.tau[rows[0]])
    for k, (time, gap) in enumerate(zip(t.tolist(), gaps, strict=True)):
        found[k], state = loop.advance(time, gap, q[k], dq[k], state)
    return found
