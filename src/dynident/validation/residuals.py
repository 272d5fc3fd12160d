"""Tests whether torque residuals are white noise, and otherwise what the likely cause is."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dynident.motion.filters import autocorrelation, ljung_box, welch
from dynident.motion.log import Log, Motion
from dynident.motion.splines import Fixed, coloured_noise, smooth
from dynident.runtime import Note, TaggedUnion, join_names, percent
from dynident.runtime.arrays import Array

if TYPE_CHECKING:
    from dynident.validation.prediction import LogValidation

LOW_FREQUENCY = 5.0  # Hz: rigid-body motion lies below; ripple, elasticity and sensor noise above
SLOW_SPEED_SHARE = 0.05  # of the rms velocity: below it friction reverses


@dataclass(frozen=True)
class Cause(TaggedUnion):
    """Base of the likely causes of a residual."""


@dataclass(frozen=True)
class Reversals(Cause):
    """Friction around the reversals of the motion."""

    def __str__(self) -> str:
        return "friction around reversals"


@dataclass(frozen=True)
class FrictionLevel(Cause):
    """Friction whose level differs from that of the fit: the residual correlates with the sign of the velocity."""

    def __str__(self) -> str:
        return "a wrong level of friction (it follows the sign of the velocity)"


@dataclass(frozen=True)
class ResidualRipple(Cause):
    """A ripple at one ``frequency`` (Hz)."""

    frequency: float

    def __str__(self) -> str:
        return f"a ripple at {self.frequency:.3g} Hz"


@dataclass(frozen=True)
class LowFrequency(Cause):
    """Residual mostly below ``LOW_FREQUENCY`` Hz: an error of the model or its parameters."""

    def __str__(self) -> str:
        return f"an error of the model or its parameters (mostly below {LOW_FREQUENCY:g} Hz)"


@dataclass(frozen=True)
class HighFrequency(Cause):
    """Residual mostly above ``LOW_FREQUENCY`` Hz: noise, ripple, elasticity or a time offset."""

    def __str__(self) -> str:
        return f"noise, ripple, elasticity or a time offset (mostly above {LOW_FREQUENCY:g} Hz)"


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
        likely = list[Cause]()
        if self.reversal_share > max(2 * self.slow_share, 0.15):
            likely.append(Reversals())
        if abs(self.sign_correlation) > 0.2:
            likely.append(FrictionLevel())
        if self.peak_share > 0.2 and self.peak > LOW_FREQUENCY:
            likely.append(ResidualRipple(self.peak))
        if self.low_share > 0.5:
            likely.append(LowFrequency())
        elif self.low_share <= 0.2:
            likely.append(HighFrequency())
        return tuple(likely[:2])


def residual_test(residual: Array, dq: Array, step: float) -> ResidualTest:
    """Test one joint's residual (N), in N m or N, at uniform steps (s), with the joint's velocity dq (N).

    A residual that is zero, or shorter than 50 samples, gives nan.
    """
    energy = float(np.square(residual).sum())
    if len(residual) < 50 or not energy > 0 or not np.ptp(residual) > 0:
        return ResidualTest(*[float("nan")] * 9)
    correlation = autocorrelation(residual)
    slow = np.abs(dq) < SLOW_SPEED_SHARE * float(np.sqrt(np.mean(dq**2)))
    # Welch's method, from stretches of about 4 s
    frequency, power = welch(residual, step, min(len(residual), max(round(4 / step), 64)))
    k = int(np.argmax(np.where(frequency >= LOW_FREQUENCY, power, 0.0)))
    around_peak = np.abs(frequency - frequency[k]) <= 0.1 * frequency[k]
    sign = np.sign(dq)
    sign_correlation = np.corrcoef(residual, sign)[0, 1] if np.ptp(sign) > 0 else 0.0
    return ResidualTest(
        lag1=float(correlation[1]),
        decorrelation=step * decorrelation(correlation),
        p_value=ljung_box(correlation, len(residual)),
        low_share=_share(power, frequency < LOW_FREQUENCY) if frequency[-1] > 2 * LOW_FREQUENCY else float("nan"),
        peak=float(frequency[k]),
        # a tenth around the peak, less the share that white noise has there
        peak_share=_share(power, around_peak) - float(around_peak.mean()),
        reversal_share=float(np.square(residual[slow]).sum()) / energy,
        slow_share=float(slow.mean()),
        sign_correlation=float(sign_correlation),
    )


def decorrelation(correlation: Array) -> float:
    """Return 1 + 2 sum rho_k in samples, the sum cut at the first k >= 5 times itself (Sokal, 1989); at least 1.

    Of a series whose correlation falls by 0.8 a sample, (1 + 0.8) / (1 - 0.8) = 9 samples count as one:

    >>> decorrelation(0.8 ** np.arange(1000))
    9.00
    """
    running_times = 2 * np.cumsum(correlation) - 1
    long_enough = np.flatnonzero(np.arange(len(running_times)) >= 5 * running_times)
    # a window of five decorrelation times: beyond, the sum only gathers noise
    return float(max(running_times[long_enough[0]] if len(long_enough) else running_times[-1], 1.0))


def _share(power: Array, selected: NDArray[np.bool_]) -> float:
    return float(power[selected].sum() / power.sum())


# share of what was taken away that may follow the motion: the error of the noise estimate is as large
MAX_FOLLOWING_SHARE = 0.05
SPECTRUM_LINES = 2000  # frequencies of a spectrum
MIN_TEST_SAMPLES = 50  # samples
TEST_LEVEL = 0.01  # of the test
MAX_LOST_ACCELERATION = 2.0  # %, of the acceleration: beyond it a note is made


@dataclass(frozen=True)
class FollowTest:
    """What the smoothing of one joint's position removed, and how much of that follows the motion.

    ``p_value`` is the probability of losing as much in a second smoothing if at most 5 % followed; ``share`` (%)
    the part of the removed power that follows the motion, and ``lost`` (%) the rms acceleration removed with it
    over that of the motion.
    """

    p_value: float
    share: float
    lost: float

    @property
    def is_following(self) -> bool:
        """Whether more than 5 % of the power follows the motion, at the level of 1 %."""
        return self.p_value < TEST_LEVEL


class SmoothedAway(Note):
    """Smoothing took away motion on a ``log``: of ``joints``, most of all of the first, for which ``share`` (%) of what
    was taken away follows the motion, and with it ``lost`` (%) of the acceleration."""

    log: str
    joints: tuple[str, ...]
    share: float
    lost: float

    def __str__(self) -> str:
        tail = f" (the most; likewise {join_names(self.joints[1:])})" if self.joints[1:] else ""
        return (
            f"{self.log}: what the smoothing took away follows the motion: {percent(self.share, 2)} of it, and with "
            f"it {percent(self.lost, 2)} of the acceleration of {self.joints[0]}{tail}; smooth less, by a smaller "
            "`factor` of the smoother, if the torque of held-out motion is then predicted better"
        )


def smoothing_losses(validations: Sequence[LogValidation]) -> Iterator[SmoothedAway]:
    """Yield for each log with signals what smoothing removed of the motion, if above 2 % of an acceleration."""
    for validation in validations:
        tests = {} if validation.recorded_log is None else follow_tests(validation.motion, validation.recorded_log)
        losing = {
            joint: test for joint, test in tests.items() if test.is_following and test.lost > MAX_LOST_ACCELERATION
        }
        if losing:
            joints = tuple(sorted(losing, key=lambda joint: -losing[joint].lost))
            yield SmoothedAway(validation.name, joints, losing[joints[0]].share, losing[joints[0]].lost)


def follow_tests(motion: Motion, recorded: Log) -> dict[str, FollowTest]:
    """Return the tests by joint of a motion that a spline has made of a log; joints at rest are missing.

    Empty where the smoother is no spline: the pass band of others is not known.
    """
    smoothing = motion.smoothing
    if not {"bandwidth", "lam", "sigma"} <= smoothing.keys() or motion.mask.sum() < MIN_TEST_SAMPLES:
        return {}
    # the smoother's own time axis, on which the bandwidth was chosen
    smoothed = motion.shift(-motion.time_offset)
    mask, width = motion.mask & smoothed.mask, np.array(smoothing["bandwidth"], dtype=float)
    moves = np.flatnonzero(np.isfinite(width) & (width > 0) & (np.ptp(smoothed.q, axis=0) > 0))
    if not len(moves) or mask.sum() < MIN_TEST_SAMPLES:
        return {}
    lam, sigma = (np.array(smoothing[name], dtype=float)[moves] for name in ("lam", "sigma"))
    resmoothed = smooth(motion.t, smoothed.q[:, moves], Fixed(lam=tuple(lam)), sigma=sigma)
    measured = recorded.select(motion.joints).q[:, moves]
    removed = measured - smoothed.q[:, moves]
    noise, rho = coloured_noise(motion.t, measured, removed, width[moves])
    removed_again = smoothed.q[:, moves] - resmoothed.values, smoothed.ddq[:, moves] - resmoothed.derivative(2)
    step = float(np.diff(motion.t).mean())
    tests = {}
    for k, j in enumerate(moves):
        moments = _noise_moments(float(width[j]) / step, float(rho[k]))
        parts = [series[mask, k] for series in (*removed_again, removed)]
        tests[motion.joints[j]] = _test_joint(parts, moments, float(noise[k]), step, smoothed.ddq[mask, j])
    return tests


def _noise_moments(width: float, rho: float) -> tuple[float, float, float]:
    """Return moments of d for AR(1) noise of variance one, for a bandwidth in steps.

    They are the mean square of d, that of its second derivative (per step^4), and the sum of its squared
    autocorrelations.
    """
    top = min(np.pi, 6.0 / width)
    # the power of noise passed twice falls like w^-8, so that frequencies beyond the top do not matter
    w = (np.arange(SPECTRUM_LINES) + 0.5) * top / SPECTRUM_LINES
    gain = 1.0 / (1.0 + (w * width) ** 4)
    density = (gain * (1.0 - gain)) ** 2 * (1 - rho**2) / (1 + rho**2 - 2 * rho * np.cos(w))
    power, bend_power = (float((w**k * density).sum()) * top / SPECTRUM_LINES / np.pi for k in (0, 4))
    correlation_sum = float(np.square(density).sum()) * top / SPECTRUM_LINES / np.pi / power**2
    return power, bend_power, correlation_sum


def _test_joint(
    parts: list[Array], expected: tuple[float, float, float], noise: float, step: float, ddq: Array
) -> FollowTest:
    from scipy.special import fdtrc

    removed_power, bend_power, total_power = (float(np.mean(np.square(part))) for part in parts)
    noise_power, noise_bend_power, correlation_sum = expected
    noise_power, noise_bend_power = noise_power * noise**2, noise_bend_power * noise**2 / step**4
    count = len(parts[0])
    if not (noise_power > 0 and total_power > 0):
        return FollowTest(float("nan"), float("nan"), float("nan"))
    # F test with the effective number of samples of the correlated series d, by its squared autocorrelations
    p_value = float(
        fdtrc(count / correlation_sum, count / 4, removed_power / (noise_power + MAX_FOLLOWING_SHARE * total_power))
    )
    motion, lost_power = (
        max(float(np.mean(np.square(ddq))) - noise_bend_power, 1e-300),
        max(bend_power - noise_bend_power, 0.0),
    )
    return FollowTest(
        p_value,
        100 * min(max(removed_power - noise_power, 0.0) / total_power, 1.0),
        100 * float(np.sqrt(lost_power / motion)),
    )
