"""Finite differences without any smoothing: the article's "raw data" method."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Gt, Le
from numpy.typing import NDArray

from dynident.motion.filters import butterworth, slowest_pole, zero_phase
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers.smoother import Smoother, ends_mask, make_motion
from dynident.runtime import InputError, settings_text
from dynident.runtime.arrays import Array


def forward_difference(t: Array, x: Array) -> Array:
    """Return (x[i+1] - x[i]) / (t[i+1] - t[i]), eqs. (47)-(48); the last row repeats the one before it."""
    out = np.empty_like(x)
    out[:-1] = np.diff(x, axis=0) / np.diff(t)[:, None]
    out[-1] = out[-2]
    return out


@dataclass(frozen=True)
class Difference(Smoother):
    """Forward differences, eqs. (47)-(49), or central differences of second order, at the actual sample times.

    ``scheme`` is "forward" or "central". The mask leaves out the last two samples (forward), or the first and the last
    (central). Calling it returns a ``Motion``; raises InputError for fewer than 5 samples, ConfigError for another
    scheme.

    >>> import numpy as np
    >>> import dynident as dy
    >>> t = np.arange(1001) * 0.01
    >>> log = dy.Log(t, q=np.sin(t)[:, None], tau=np.cos(t)[:, None], joints=("hinge",))
    >>> dy.Difference("central")(log)
    <Motion 'log': 1001 samples of hinge; 0 to 10 s, 100 Hz; 999 usable; central differences>
    """

    scheme: Literal["forward", "central"] = "forward"

    @property
    def method(self) -> str:
        """The method in words."""
        return f"{self.scheme} differences"

    def __call__(self, log: Log) -> Motion:
        """Differentiate; q itself is left as measured."""
        if len(log) < 5:
            raise InputError(f"{log.source}: differences need at least 5 samples, got {len(log)}.")
        mask = np.ones(len(log), dtype=bool)
        if self.scheme == "forward":
            dq = forward_difference(log.t, log.q)
            ddq = forward_difference(log.t, dq)
            mask[-2:] = False
        else:
            dq = np.gradient(log.q, log.t, axis=0)
            # the second difference of three points on a grid that may be uneven; the ends repeat their neighbours
            h, ddq = np.diff(log.t)[:, None], np.empty_like(log.q)
            ddq[1:-1] = 2 * np.diff(np.diff(log.q, axis=0) / h, axis=0) / (h[1:] + h[:-1])
            ddq[0], ddq[-1] = ddq[1], ddq[-2]
            mask[[0, -1]] = False
        return make_motion(log, (log.q, dq, ddq), mask, {"method": self.method})

    def __str__(self) -> str:
        return self.method


MAX_JITTER = 0.05
MIN_PERIODS = 0.1  # periods of a cut-off frequency in a recording
Order = Annotated[int, Ge(1), Le(12)]
Cutoff = Annotated[float, Gt(0)]
Seconds = Annotated[float, Ge(0)]


@dataclass(frozen=True)
class Butterworth(Smoother):
    """Forward differences of q and dq, then zero-phase filters on q, dq and ddq; eqs. (47)-(53).

    ``orders`` and ``cutoffs`` (Hz) are those of the filters on q, dq and ddq. The defaults are the article's, orders
    3, 3, 4 at 10, 3, 2 Hz (butter(3, 0.05), butter(3, 0.015), butter(4, 0.01) at 400 Hz; its printed coefficients are
    rounded too coarsely to be used). ``settle`` is the time (s) to mask out at the start and at the end; None takes the
    time in which the slowest filter decays to 0.01 %. Digital filters assume uniform sampling: the steps may vary by
    5 % at most.

    Calling it returns a ``Motion``. Raises ConfigError for bad settings, and InputError where the sampling is too
    irregular or too slow, or the log too short.

    >>> import numpy as np
    >>> import dynident as dy
    >>> t = np.arange(1001) * 0.01
    >>> log = dy.Log(t, q=np.sin(t)[:, None], tau=np.cos(t)[:, None], joints=("hinge",))
    >>> motion = dy.Butterworth(cutoffs=(10, 8, 8))(log)
    >>> print(f"{motion.mask.sum()} of {len(motion)} samples")
    901 of 1001 samples
    """

    orders: tuple[Order, Order, Order] = (3, 3, 4)
    cutoffs: tuple[Cutoff, Cutoff, Cutoff] = (10.0, 3.0, 2.0)
    settle: tuple[Seconds, Seconds] | None = None

    @property
    def method(self) -> str:
        """The method in words."""
        orders, cutoffs = ", ".join(map(str, self.orders)), ", ".join(f"{cutoff:g}" for cutoff in self.cutoffs)
        return f"forward differences, Butterworth filters of orders {orders} at {cutoffs} Hz"

    def __call__(self, log: Log) -> Motion:
        """Differentiate and filter; InputError where the sampling is too irregular, too slow, or the log too short."""
        rate = self._rate(log)
        dq = forward_difference(log.t, log.q)
        signals = [log.q, dq, forward_difference(log.t, dq)]
        slowest = 0.0
        for k, (order, cutoff) in enumerate(zip(self.orders, self.cutoffs, strict=True)):
            pad = 3 * order  # filtfilt's padding
            if len(log) <= pad + 1:
                raise InputError(f"{log.source}: {len(log)} samples are too few for a filter of order {order}.")
            sections = butterworth(order, cutoff, rate)
            # samples until the slowest pole has decayed to 1e-4, as a time
            slowest = max(slowest, float(np.log(1e-4) / np.log(slowest_pole(sections)) / rate))
            signals[k] = zero_phase(sections, signals[k], pad, axis=0)
        mask = ends_mask(log, *(self.settle or (slowest, slowest)))
        # the forward differences repeat the last row, twice
        mask[-2:] = False
        return make_motion(log, signals, mask, {"method": self.method})

    def _rate(self, log: Log) -> float:
        step = np.diff(log.t)
        mean = float(step.mean())
        worst = int(np.abs(step - mean).argmax())
        if abs(step[worst] - mean) > MAX_JITTER * mean:
            raise InputError(
                f"{log.source}: the step after t = {log.t[worst]:.6g} s is {step[worst]:.4g} s, the mean {mean:.4g} s; "
                "too irregular for a digital filter. Use the spline smoother, which takes the times as they are."
            )
        for cutoff in self.cutoffs:
            if complaint := cutoff_complaint("a cut-off of", cutoff, log.t):
                raise InputError(f"{log.source}: {complaint}")
        return 1.0 / mean

    def __str__(self) -> str:
        return settings_text(self.method, self, ("orders", "cutoffs"))


def cutoff_complaint(subject: str, cutoff: float, t: NDArray[np.float64]) -> str:
    """Return what is wrong with a cut-off (Hz) for samples at times t (N), s; empty where nothing is.

    ``subject`` begins the sentence.
    """
    length = float(t[-1] - t[0])
    nyquist = 0.5 * (len(t) - 1) / length
    if not cutoff * length >= MIN_PERIODS:
        return (
            f"{subject} {cutoff:.3g} Hz is too low for {length:.4g} s, of which it leaves nothing; give at least "
            f"{MIN_PERIODS / length:.2g} Hz."
        )
    if not cutoff < nyquist:
        reason = f"does not lie below half the sampling rate ({nyquist:.4g} Hz)"
        return f"{subject} {cutoff:g} Hz {reason}; lower it or sample faster."
    return ""
