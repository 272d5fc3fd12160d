"""Whether positions follow their commands: columns of other joints, other units and signs, clocks out of step, and
servos at their limits.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from dynident.apps.servo.start import SmoothLog, late_commands
from dynident.apps.servo.values import ServoValues
from dynident.runtime import Finding, Remark, number, percent
from dynident.runtime.arrays import Array

LAGS = np.arange(-0.2, 0.4, 0.01)  # s, of positions behind commands, that are tried
LAG_COST = 0.1  # of a correlation, per s
MIN_CORRELATION = 0.6  # of a position with its command
MIN_OTHER_CORRELATION = 0.9  # with that of another joint, to name it
MAX_RATIO = 5.0  # of the spreads of commands and positions
MIN_SPREAD = 0.01  # rad or m, of positions and, as a share of these, of commands: what stands still follows nothing
MAX_LEAD = 0.015  # s, of positions before commands
MAX_LIMIT_SHARE = 0.1  # of samples in which a servo gives all that it can
LIMIT_SLACK = 0.98  # of a limit
MAX_LAG_DIFFERENCE = 0.06  # s, of recordings: friction and inertia make some


def command_findings(
    motions: Sequence[SmoothLog], joints: Sequence[str], takes_torque: NDArray[np.bool_]
) -> Iterator[Finding]:
    """Yield where positions do not follow the commands of positions as those of a servo do, by recording."""
    if takes_torque.all():
        return
    lags = []
    for motion in motions:
        correlations = np.array([_correlations(motion.raw, late_commands(motion, float(lag))) for lag in LAGS])
        diagonal = np.einsum("ijj->ij", correlations)
        # periodic motion follows at several lags, of which the nearest to zero is taken
        places = (diagonal - LAG_COST * np.abs(LAGS)[:, None]).argmax(axis=0)
        # a turned sign is one where no lag is right
        places = np.where(diagonal.max(axis=0) > MIN_CORRELATION, places, np.abs(diagonal).argmax(axis=0))
        best = diagonal[places, np.arange(len(joints))]
        for k in map(int, np.flatnonzero(~takes_torque & (motion.raw.std(axis=0) > MIN_SPREAD))):
            if words := _fault(motion, k, float(best[k]), np.abs(correlations[:, k]), joints):
                yield Finding(Remark(words), joint=joints[k], source=motion.log.name)
        following = places[~takes_torque & (best > MIN_CORRELATION)]
        lags.append(float(np.median(LAGS[following])) if len(following) else np.nan)
        if lags[-1] < -MAX_LEAD:
            words = (
                f"positions are about {number(-1e3 * lags[-1], 2)} ms before their commands; are these stamped late?"
            )
            yield Finding(Remark(words), source=motion.log.name)
    for motion, lag in zip(motions, lags, strict=True):
        if abs(lag - lags[0]) > MAX_LAG_DIFFERENCE:
            words = (
                f"positions are about {number(1e3 * lag, 2)} ms behind their commands, but {number(1e3 * lags[0], 2)} "
                f"ms in {motions[0].log.name!r}; are both stamped by one clock?"
            )
            yield Finding(Remark(words), source=motion.log.name)


def limit_findings(joints: Sequence[str], motions: Sequence[SmoothLog], values: ServoValues) -> Iterator[Finding]:
    """Yield the servos that are at their limit, where their torque tells nothing of the position."""
    for motion in motions:
        torques = values.drive_torques(late_commands(motion, values.delay), motion.raw, motion.dq)
        shares = (np.abs(torques) >= LIMIT_SLACK * values.limit).mean(axis=0)
        for joint, share, limit in zip(joints, shares, values.limit, strict=True):
            if share > MAX_LIMIT_SHARE:
                words = (
                    f"the servo is at its limit of {number(limit)} in {percent(100 * share)} of the samples. "
                    "Check `limit` and `kd` (it is not like damping there); if they are right, move less, or slower"
                )
                yield Finding(Remark(words), joint=joint, source=motion.log.name)


def _fault(motion: SmoothLog, k: int, correlation: float, others: Array, joints: Sequence[str]) -> str:
    """Return what is wrong with the commands of joint k, "" for nothing; ``others`` (L, n) are the correlations of its
    position with all commands, by lag."""
    spread, command = float(motion.raw[:, k].std()), float(motion.log.command[:, k].std())
    if command < MIN_SPREAD * spread:
        return "the joint moves, while its command hardly changes; is the right column named?"
    other = int(others.max(axis=0).argmax())
    if abs(correlation) < MIN_CORRELATION:
        is_other = other != k and others[:, other].max() > MIN_OTHER_CORRELATION
        words = f"; it follows that of {joints[other]!r}" if is_other else ""
        likeness = number(correlation, 2)
        return f"the position does not follow its command (correlation {likeness}){words}; is the right column named?"
    if correlation < 0:
        return "the position goes against its command; turn the sign of one of them by `gain: -1`"
    ratio = command / spread
    if not 1 / MAX_RATIO < ratio < MAX_RATIO:
        return f"the command spans {number(ratio, 3)} times what the position spans; is its `unit` right?"
    return ""


def _correlations(q: Array, command: Array) -> Array:
    """Return the correlations (n, n) of positions with commands (N, n), zero of what does not change."""
    sides = [(x - x.mean(axis=0)) / np.maximum(x.std(axis=0), 1e-12) for x in (q, command)]
    return np.asarray(sides[0].T @ sides[1] / len(q))
