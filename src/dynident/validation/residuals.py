"""Tests of torque residuals: are they white noise, and if not, what is the likely cause?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.filters import autocorrelation, ljung_box, welch

__all__ = [
    "LOW",
    "SLOW",
    "Cause",
    "FrictionLevel",
    "HighFrequency",
    "LowFrequency",
    "ResidualTest",
    "Reversals",
    "Ripple",
    "decorrelation",
    "residual_test",
]

Array = NDArray[np.float64]
LOW = 5.0  # Hz: rigid-body motion lies below; ripple, elasticity and sensor noise above
SLOW = 0.05  # of the rms velocity: below it friction reverses


@dataclass(frozen=True)
class Cause:
    """Base of the likely causes of a residual."""


@dataclass(frozen=True)
class Reversals(Cause):
    """Friction around the reversals of the motion."""


@dataclass(frozen=True)
class FrictionLevel(Cause):
    """Friction whose level differs from that of the fit: the residual correlates with the sign of the velocity."""


@dataclass(frozen=True)
class Ripple(Cause):
    """A ripple at one ``frequency`` (Hz)."""

    frequency: float


@dataclass(frozen=True)
class LowFrequency(Cause):
    """Residual mostly below ``LOW`` Hz: an error of the model or its parameters."""


@dataclass(frozen=True)
class HighFrequency(Cause):
    """Residual mostly above ``LOW`` Hz: noise, ripple, elasticity or a time offset."""


@dataclass(frozen=True)
class ResidualTest:
    """How one joint's residual (measured minus predicted torque) differs from white noise.

    ``lag1``: autocorrelation at one sample; ``decorrelation`` (s): time over which samples count as one, so that N h /
    decorrelation is the number of independent ones; ``p_value`` of Ljung and Box's test, small where the residual is
    not white; ``low_share``: share of its power below 5 Hz (nan where the rate is too low to say); ``peak`` (Hz) of its
    spectrum above 5 Hz and ``peak_share``, the share of all power within a tenth of it, less what white noise would
    have there; ``reversal_share``: share of its energy where the joint is slower than 5 % of its rms velocity, and
    ``slow_share``, the share of time it spends there;
    ``sign_correlation`` with the sign of the velocity.
    """

    lag1: float
    decorrelation: float
    p_value: float
    low_share: float
    peak: float
    peak_share: float
    reversal_share: float
    slow_share: float
    sign_correlation: float

    @property
    def causes(self) -> tuple[Cause, ...]:
        """The two most likely causes of the residual; empty where none stands out."""
        signs = list[Cause]()
        if self.reversal_share > max(2 * self.slow_share, 0.15):
            signs.append(Reversals())
        if abs(self.sign_correlation) > 0.2:
            signs.append(FrictionLevel())
        if self.peak_share > 0.2 and self.peak > LOW:
            signs.append(Ripple(self.peak))
        if self.low_share > 0.5:
            signs.append(LowFrequency())
        elif self.low_share <= 0.2:
            signs.append(HighFrequency())
        return tuple(signs[:2])


def residual_test(residual: Array, dq: Array, step: float) -> ResidualTest:
    """Test one joint's residual (N), in N m or N, at uniform steps (s), with the joint's velocity dq (N).

    A residual that is zero, or shorter than 50 samples, gives nan.
    """
    size = float(np.square(residual).sum())
    if len(residual) < 50 or not size > 0 or not np.ptp(residual) > 0:
        return ResidualTest(*[float("nan")] * 9)
    correlation = autocorrelation(residual)
    slow = np.abs(dq) < SLOW * float(np.sqrt(np.mean(dq**2)))
    frequency, power = _spectrum(residual, step)
    k = int(np.argmax(np.where(frequency >= LOW, power, 0.0)))
    near = np.abs(frequency - frequency[k]) <= 0.1 * frequency[k]
    sign = np.sign(dq)
    correlated = np.corrcoef(residual, sign)[0, 1] if np.ptp(sign) > 0 else 0.0
    return ResidualTest(
        lag1=float(correlation[1]),
        decorrelation=step * decorrelation(correlation),
        p_value=ljung_box(correlation, len(residual)),
        low_share=_share(power, frequency < LOW) if frequency[-1] > 2 * LOW else float("nan"),
        peak=float(frequency[k]),
        peak_share=_share(power, near) - float(near.mean()),
        reversal_share=float(np.square(residual[slow]).sum()) / size,
        slow_share=float(slow.mean()),
        sign_correlation=float(correlated),
    )


def decorrelation(correlation: Array) -> float:
    """Return 1 + 2 sum rho_k in samples, the sum cut at the first k >= 5 times itself (Sokal, 1989); at least 1.

    Of a series whose correlation falls by 0.8 a sample, (1 + 0.8) / (1 - 0.8) = 9 samples count as one:

    >>> decorrelation(0.8 ** np.arange(1000))
    9.00
    """
    times = 2 * np.cumsum(correlation) - 1
    enough = np.flatnonzero(np.arange(len(times)) >= 5 * times)
    return float(max(times[enough[0]] if len(enough) else times[-1], 1.0))


def _spectrum(x: Array, step: float) -> tuple[Array, Array]:
    """Return frequencies (Hz) and power by Welch's method, from stretches of about 4 s."""
    return welch(x, step, min(len(x), max(round(4 / step), 64)))


def _share(power: Array, chosen: NDArray[np.bool_]) -> float:
    return float(power[chosen].sum() / power.sum())
