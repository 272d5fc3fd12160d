"""How many samples around a piece of a log a smoother must see, so that the piece has the motion of the whole log.

A natural spline forgets what is beyond its ends like |z|^k over k samples, z the slowest root inside the unit circle of
its equations (Reinsch, 1967) at even spacing h:

    kappa w^2 + w / 6 + 1 = 0,  w = z - 2 + 1 / z,  kappa = (bandwidth / h)^4,

which is exp(-k h / (sqrt 2 bandwidth)) where the bandwidth spans several samples, and (2 - sqrt 3)^k without smoothing.
Of other smoothers it is measured.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError, called
from dynident.log import Log, Motion
from dynident.smoothers.smoother import Smoother
from dynident.smoothers.time_offset import TimeShifted, unshifted

__all__ = ["ACCURACY", "decay", "overlap"]

ACCURACY = 1e-10  # what may be left of the error at a cut, where the acceleration itself is wrong
SHORTEST = 32  # samples


def decay(bandwidth: float, step: float) -> float:
    """Return |z|, the share of an error at its end that is left of a spline's after one sample, from 0.27 to 1.

    ``bandwidth`` (s) is that of a ``SmoothingSpline``, ``step`` (s) the time between samples.
    """
    kappa = (bandwidth / step) ** 4
    if kappa == np.inf:  # a straight line
        return 1.0
    # the roots as 2 / (-b -+ sqrt(b^2 - 4 a)) of a w^2 + b w + 1, which holds for a = 0, too
    root = np.sqrt(complex(1 / 36 - 4 * kappa))
    w = np.array([-2.0 / (1 / 6 + side * root) for side in ((1.0, -1.0) if kappa else (1.0,))])
    half = 1.0 + w / 2
    other = np.sqrt(half**2 - 1.0)
    return float(np.abs(np.stack([half + other, half - other])).min(axis=0).max())


def overlap(smoother: Smoother, log: Log, motion: Motion) -> int:
    """Return the number of samples on either side of a piece after which its motion is that of the whole log to 1e-9.

    ``motion`` is what the smoother, a linear one, has made of ``log``, or of a part of the recording like it. Raises
    ConfigError where the log is too short to tell.
    """
    step = float(np.median(np.diff(log.t)))
    late = math.ceil(abs(smoother.time_offset) / step) + 2 if isinstance(smoother, TimeShifted) else 0
    widths = motion.smoothing.get("bandwidth")
    if widths is None or motion.smoothing.get("order", 2) != 2:
        return late + _measured(unshifted(smoother), log)
    left = max(decay(float(one), step) for one in widths)
    needed = SHORTEST + math.log(ACCURACY) / math.log(left) if left < 1.0 else math.inf
    if needed > len(log):
        raise ConfigError(
            f"{log.source}: the spline smooths over {max(widths):.3g} s, so that no piece of {len(log)} samples can "
            "be smoothed by itself; smooth less, or fit a shorter part of the recording."
        )
    return late + math.ceil(needed)


def _measured(smoother: Smoother, log: Log) -> int:
    """Return the same by trying: from where the motion of the second half of a log is that of all of it."""
    middle = len(log) // 2
    whole, cut = (called(smoother, one, Motion) for one in (log, log.rows(slice(middle, None), log.source)))
    last = middle + 3 * (len(log) - middle) // 4  # beyond, the other end counts
    wrong = np.zeros(last - middle, dtype=bool)
    for name in ("q", "dq", "ddq"):
        all_of, part = getattr(whole, name)[middle:last], getattr(cut, name)[: last - middle]
        wrong |= (np.abs(part - all_of) > ACCURACY * np.abs(all_of).max(axis=0)).any(axis=1)
    far: NDArray[np.intp] = np.flatnonzero(wrong)
    found = SHORTEST + (int(far[-1]) + 1 if len(far) else 0)
    if found >= len(wrong):
        raise ConfigError(
            f"{log.source}: what {type(smoother).__name__} makes of a sample depends on others that are "
            f"{len(wrong) * float(np.median(np.diff(log.t))):.3g} s away, so that a long recording cannot be "
            "smoothed in pieces; take a spline, or fit a shorter part."
        )
    return found
