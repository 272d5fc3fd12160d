"""Forward differences through forward-backward Butterworth filters: the article's "digital filter" method."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt
from numpy.typing import NDArray

from dynident.errors import ConfigError, InputError
from dynident.filters import butterworth, slowest_pole, zero_phase
from dynident.log import Log, Motion
from dynident.smoothers.difference import forward
from dynident.smoothers.smoother import ends_mask

__all__ = ["Butterworth", "cutoff_complaint"]

JITTER = 0.05
SLOWEST = 0.1  # periods of a cut-off frequency in a recording
Order = Annotated[int, Ge(1)]
Cutoff = Annotated[float, Gt(0)]
Seconds = Annotated[float, Ge(0)]


@dataclass(frozen=True)
class Butterworth:
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

    def __post_init__(self) -> None:
        if len(self.orders) != 3 or not set(self.orders) <= set(range(1, 13)):
            raise ConfigError(f"filter orders {self.orders}: give three whole numbers from 1 to 12, for q, dq and ddq.")
        if len(self.cutoffs) != 3 or not all(0 < f < np.inf for f in self.cutoffs):
            raise ConfigError(f"filter cut-offs {self.cutoffs}: give three positive frequencies in Hz, for q, dq, ddq.")
        if self.settle is not None and not (len(self.settle) == 2 and all(s >= 0 for s in self.settle)):
            raise ConfigError(f"settle is {self.settle}: give two times >= 0 s, at the start and at the end.")

    @property
    def method(self) -> str:
        """The method in words."""
        orders, cutoffs = ", ".join(map(str, self.orders)), ", ".join(f"{one:g}" for one in self.cutoffs)
        return f"forward differences, Butterworth filters of orders {orders} at {cutoffs} Hz"

    def __call__(self, log: Log) -> Motion:
        """Differentiate and filter; InputError where the sampling is too irregular, too slow, or the log too short."""
        rate = self._rate(log)
        dq = forward(log.t, log.q)
        signals = [log.q, dq, forward(log.t, dq)]
        slowest = 0.0
        for k, (order, cutoff) in enumerate(zip(self.orders, self.cutoffs, strict=True)):
            pad = 3 * order  # filtfilt's padding
            if len(log) <= pad + 1:
                raise InputError(f"{log.source}: {len(log)} samples are too few for a filter of order {order}.")
            sections = butterworth(order, cutoff, rate)
            slowest = max(slowest, float(np.log(1e-4) / np.log(slowest_pole(sections)) / rate))
            signals[k] = zero_phase(sections, signals[k], pad, axis=0)
        mask = ends_mask(log, *(self.settle or (slowest, slowest)))
        mask[-2:] = False
        how = {"method": self.method}
        q, dq, ddq = signals
        return Motion(log.t, q, dq, ddq, log.tau, log.joints, mask, log.source, how)

    def _rate(self, log: Log) -> float:
        step = np.diff(log.t)
        mean = float(step.mean())
        worst = int(np.abs(step - mean).argmax())
        if abs(step[worst] - mean) > JITTER * mean:
            raise InputError(
                f"{log.source}: the step after t = {log.t[worst]:.6g} s is {step[worst]:.4g} s, the mean {mean:.4g} s; "
                "too irregular for a digital filter. Use the spline smoother, which takes the times as they are."
            )
        for cutoff in self.cutoffs:
            if wrong := cutoff_complaint("a cut-off of", cutoff, log.t):
                raise InputError(f"{log.source}: {wrong}")
        return 1.0 / mean


def cutoff_complaint(what: str, cutoff: float, t: NDArray[np.float64]) -> str:
    """Return what is wrong with a cut-off (Hz) for samples at times t (N), s; empty where nothing is."""
    length = float(t[-1] - t[0])
    half = 0.5 * (len(t) - 1) / length
    if not cutoff * length >= SLOWEST:
        return (
            f"{what} {cutoff:.3g} Hz is too low for {length:.4g} s, of which it leaves nothing; give at least "
            f"{SLOWEST / length:.2g} Hz."
        )
    if not cutoff < half:
        below = f"does not lie below half the sampling rate ({half:.4g} Hz)"
        return f"{what} {cutoff:g} Hz {below}; lower it or sample faster."
    return ""
