"""Forward differences through forward-backward Butterworth filters: the article's "digital filter" method."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt

from dynident.errors import ConfigError, InputError
from dynident.log import Log, Motion
from dynident.smoothers.difference import forward
from dynident.smoothers.smoother import ends_mask

__all__ = ["Butterworth"]

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

    def __call__(self, log: Log) -> Motion:
        """Differentiate and filter; InputError where the sampling is too irregular, too slow, or the log too short."""
        from scipy.signal import butter, sosfiltfilt

        rate = self._rate(log)
        dq = forward(log.t, log.q)
        signals = [log.q, dq, forward(log.t, dq)]
        slowest = 0.0
        for k, (order, cutoff) in enumerate(zip(self.orders, self.cutoffs, strict=True)):
            pad = 3 * order  # filtfilt's padding
            if len(log) <= pad + 1:
                raise InputError(f"{log.source}: {len(log)} samples are too few for a filter of order {order}.")
            poles = butter(order, cutoff, fs=rate, output="zpk")[1]
            slowest = max(slowest, float(np.log(1e-4) / np.log(np.abs(poles).max()) / rate))
            sos = butter(order, cutoff, fs=rate, output="sos")
            signals[k] = sosfiltfilt(sos, signals[k], axis=0, padlen=pad)
        mask = ends_mask(log, *(self.settle or (slowest, slowest)))
        mask[-2:] = False
        how = {"method": "forward differences, Butterworth filters of orders {} at {} Hz".format(
            ", ".join(map(str, self.orders)), ", ".join(f"{f:g}" for f in self.cutoffs))}  # fmt: skip
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
        length = float(log.t[-1] - log.t[0])
        if min(self.cutoffs) * length < SLOWEST:
            raise InputError(
                f"{log.source}: a cut-off of {min(self.cutoffs):.3g} Hz is too low for {length:.4g} s, of which it "
                f"leaves nothing; give at least {SLOWEST / length:.2g} Hz."
            )
        if max(self.cutoffs) >= 0.5 / mean:
            raise InputError(
                f"{log.source}: a cut-off of {max(self.cutoffs):g} Hz does not lie below half the sampling rate "
                f"({0.5 / mean:.4g} Hz); lower it or sample faster."
            )
        return 1.0 / mean
