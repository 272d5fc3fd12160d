"""Whether what a smoothing spline took away follows the motion: a test of the positions, joint by joint.

A spline of bandwidth b passes the share H = 1 / (1 + (w b)^4) of an angular frequency w. Smoothed once more, the motion
loses d = (1 - H) H (motion + noise): of the motion what the first smoothing took away of it too, (1 - H) of all that H
leaves, and of noise little. Were there noise alone, the mean square of d would be that of H (1 - H) noise, up to an F
distribution; the noise is AR(1), by the frequencies above the motion (``coloured_noise``).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dynident.errors import Note
from dynident.log import Log, Motion
from dynident.splines import Fixed, coloured_noise, smooth

if TYPE_CHECKING:
    from dynident.validation.prediction import LogValidation

__all__ = ["HARMFUL", "FollowTest", "SmoothedAway", "follow_tests", "smoothed_away"]

Array = NDArray[np.float64]
SMALL = 0.05  # share of what was taken away that may follow the motion: the error of the noise estimate is as large
LINES = 2000  # frequencies of a spectrum
FEWEST = 50  # samples
LEVEL = 0.01  # of the test
HARMFUL = 2.0  # %, of the acceleration: beyond it a note is made


@dataclass(frozen=True)
class FollowTest:
    """What the smoothing of one joint's position took away, and how much of it follows the motion.

    ``p_value``: of as much being left in a second smoothing where at most 5 % follows; ``share`` (%) of the power taken
    away that follows the motion, and ``lost`` (%), the rms acceleration taken away with it over that of the motion.
    """

    p_value: float
    share: float
    lost: float

    @property
    def follows(self) -> bool:
        """Whether more than 5 % of the power follows the motion, at the level of 1 %."""
        return self.p_value < LEVEL


@dataclass(frozen=True)
class SmoothedAway(Note):
    """Smoothing took away motion on a ``log``: of ``joints``, most of all of the first, for which ``share`` (%) of what
    was taken away follows the motion, and with it ``lost`` (%) of the acceleration."""

    log: str
    joints: tuple[str, ...]
    share: float
    lost: float


def smoothed_away(validations: Sequence[LogValidation]) -> Iterator[SmoothedAway]:
    """Yield of each log with signals what smoothing took away of the motion, where that is more than 2 % of an
    acceleration."""
    for one in validations:
        tests = {} if one.recorded is None else follow_tests(one.motion, one.recorded)
        bad = {joint: test for joint, test in tests.items() if test.follows and test.lost > HARMFUL}
        if bad:
            joints = tuple(sorted(bad, key=lambda joint: -bad[joint].lost))
            yield SmoothedAway(one.name, joints, bad[joints[0]].share, bad[joints[0]].lost)


def follow_tests(motion: Motion, recorded: Log) -> dict[str, FollowTest]:
    """Return the tests by joint of a motion that a spline has made of a log; joints at rest are missing.

    Empty where no spline has smoothed: the pass band of other smoothers is not known.
    """
    how = motion.smoothing
    if not {"bandwidth", "lam", "sigma"} <= how.keys() or motion.mask.sum() < FEWEST:
        return {}
    smoothed = motion.shifted(-motion.time_offset)
    mask, width = motion.mask & smoothed.mask, np.array(how["bandwidth"], dtype=float)
    moves = np.flatnonzero(np.isfinite(width) & (width > 0) & (np.ptp(smoothed.q, axis=0) > 0))
    if not len(moves) or mask.sum() < FEWEST:
        return {}
    lam, sigma = (np.array(how[name], dtype=float)[moves] for name in ("lam", "sigma"))
    again = smooth(motion.t, smoothed.q[:, moves], Fixed(lam=tuple(lam)), sigma=sigma)
    measured = recorded.select(motion.joints).q[:, moves]
    left = measured - smoothed.q[:, moves]
    noise, rho = coloured_noise(motion.t, measured, left, width[moves])
    taken = smoothed.q[:, moves] - again.values, smoothed.ddq[:, moves] - again.derivative(2)
    step = float(np.diff(motion.t).mean())
    found = {}
    for k, j in enumerate(moves):
        moments = _expected(float(width[j]) / step, float(rho[k]))
        parts = [one[mask, k] for one in (*taken, left)]
        found[motion.joints[j]] = _tested(parts, moments, float(noise[k]), step, smoothed.ddq[mask, j])
    return found


def _expected(width: float, rho: float) -> tuple[float, float, float]:
    """Return for AR(1) noise of variance one what d holds of it: its mean square, that of its second derivative (per
    step^4), and the sum of its squared autocorrelations, for a bandwidth in steps."""
    top = min(np.pi, 6.0 / width)
    w = (np.arange(LINES) + 0.5) * top / LINES
    passed = 1.0 / (1.0 + (w * width) ** 4)
    density = (passed * (1.0 - passed)) ** 2 * (1 - rho**2) / (1 + rho**2 - 2 * rho * np.cos(w))
    first, second = (float((w**k * density).sum()) * top / LINES / np.pi for k in (0, 4))
    together = float(np.square(density).sum()) * top / LINES / np.pi / first**2
    return first, second, together


def _tested(
    parts: list[Array], expected: tuple[float, float, float], noise: float, step: float, ddq: Array
) -> FollowTest:
    from scipy.special import fdtrc

    again, bend, left = (float(np.mean(np.square(one))) for one in parts)
    first, second, together = expected
    first, second = first * noise**2, second * noise**2 / step**4
    count = len(parts[0])
    if not (first > 0 and left > 0):
        return FollowTest(float("nan"), float("nan"), float("nan"))
    p_value = float(fdtrc(count / together, count / 4, again / (first + SMALL * left)))
    motion, away = max(float(np.mean(np.square(ddq))) - second, 1e-300), max(bend - second, 0.0)
    return FollowTest(p_value, 100 * min(max(again - first, 0.0) / left, 1.0), 100 * float(np.sqrt(away / motion)))
