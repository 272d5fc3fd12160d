"""Instruments of a recording: motions at its samples whose errors are independent of those of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dynident.estimators.estimator import Problem
from dynident.estimators.simulated_recordings import failure_of
from dynident.models import Model
from dynident.models.simulation import Failure, simulate_recording, ticks
from dynident.motion.filters import frequency_response
from dynident.motion.log import Log, Motion
from dynident.regression import ParallelFilter, Regression, Selection, fitted_rows
from dynident.regression.groups import repeated_rows
from dynident.runtime import ConfigError, InputError, Note, Noun, Severity, WordedEnum, short
from dynident.runtime.arrays import Array


class InstrumentKind(WordedEnum):
    """The origin of instruments: a simulation, another pass of the same motion, or other samples of the same motion."""

    SIMULATED = "simulated", "the motion that the model makes in the loop of the controller"
    REPEATED = "repeated", "another pass of the same motion"
    LAGGED = "lagged", "the motion before and after each sample"


class InstrumentsUsed(Note):
    """The ``kinds`` of instruments, the longest ``lag`` (s) of those that have one, and what became of least squares.

    ``correlation`` is the least between instruments and regressor; the value of ``parameter`` is the one that is moved
    most, by ``moved`` standard errors; none where no parameter is determined by itself.
    """

    severity = Severity.INFO
    kinds: tuple[InstrumentKind, ...]
    correlation: float
    lag: float | None = None
    parameter: str | None = None
    moved: float = 0.0

    def __str__(self) -> str:
        kinds = ", and ".join(kind.words for kind in self.kinds)
        change = ""
        if self.parameter is not None:
            change = f"; least squares differs most in {self.parameter}, by {short(self.moved, 2)} standard errors"
        noise = ""
        if self.lag is not None:
            noise = f". That holds where noise of the positions is not correlated over {short(self.lag, 2)} s"
        correlation = f"(least correlation with the regressor {short(self.correlation, 3)})"
        return f"instruments are {kinds} {correlation}{change}{noise}"


class WeakInstruments(Note):
    """The instruments explain little of the regressor in a direction of which ``parameter`` has the largest part:
    their ``correlation``, and the F ``statistic`` of the first stage."""

    parameter: str
    correlation: float
    statistic: float

    def __str__(self) -> str:
        return (
            f"weak instruments: they hardly show {self.parameter} (correlation {short(self.correlation, 2)}, F = "
            f"{short(self.statistic, 2)}, 10 would do); values and standard errors are not reliable there"
        )


class NotSimulated(Note):
    """Instruments are not simulated, since the first model fails in the controller's loop, for a ``reason``."""

    reason: str

    def __str__(self) -> str:
        return (
            "instruments were not simulated, as neither least squares nor the physically consistent model can be "
            f"simulated in the loop of the controller: {self.reason}"
        )


class Instruments(Noun):
    """A ``motion`` at the samples of another one, usable where its mask is True; its ``kind`` and ``lag`` (s).

    For another pass, ``partner_motion`` is the index of its recording, and ``partner`` (N) the index of the
    sample there that corresponds to each sample, -1 for none.
    """

    motion: Motion
    kind: InstrumentKind
    lag: float | None = None
    partner_motion: int | None = None
    partner: NDArray[np.intp] | None = None


def pair_rows(problem: Problem, instruments: Sequence[Instruments]) -> tuple[Regression, Regression]:
    """Return the rows of a problem that have instruments, and the rows of the instruments, at the same samples."""
    regression, rows, instrument_rows = problem.regression, [], []
    for motion, instrument in zip(regression.motions, instruments, strict=True):
        # the minimum speed is applied to the measured motion alone: the same samples must remain on both sides
        mask, keep = motion.mask & instrument.motion.mask, fitted_rows(motion, regression.min_speed)
        rows.append(replace(motion, mask=mask, keep=keep))
        instrument_rows.append(replace(instrument.motion, mask=mask, keep=keep))
    # slow samples are left out by the masks above, alike in both
    selection = Selection(regression.filter)
    row_regression, instrument_regression = (
        replace(regression, motions=tuple(motions), selection=selection) for motions in (rows, instrument_rows)
    )
    return row_regression, instrument_regression


def simulated_instruments(problem: Problem, k: int, theta: Array) -> Instruments | Failure:
    """Return the simulated motion of the problem's model in the loop of the k-th recording, or why there is none.

    It begins with the state at the first usable sample, whose errors the loop forgets. A controller sees
    positions when they are stamped: there it is simulated, and then shifted to the torque as the motion has been.
    """
    model, motion = problem.model, problem.motions[k]
    # the controller acts on positions at the time of their stamps: simulate there, and shift back at the end
    stamped = motion.shift(-motion.time_offset)
    usable = np.flatnonzero(stamped.mask)
    if len(usable) < 2:
        raise InputError(f"{motion.source}: too few usable samples to simulate instruments.")
    rows = slice(int(usable[0]), int(usable[-1]) + 1)
    controller = problem.controller(k)
    # references may be known more often than samples: simulate on the finer grid
    grid = ticks(stamped, controller, rows)
    run = simulate_recording(model, theta, grid.motion, controller, rows=grid.rows)
    failure = failure_of(run, grid.motion.q[grid.rows])
    if failure is not None:
        return failure
    mask = np.zeros(len(motion), dtype=bool)
    mask[rows] = True
    q, dq, ddq = (quantity.copy() for quantity in (stamped.q, stamped.dq, stamped.ddq))
    q[rows], dq[rows], ddq[rows] = run.q[grid.at], run.dq[grid.at], run.ddq[grid.at]
    simulated_motion = replace(stamped, q=q, dq=dq, ddq=ddq, mask=mask, memory=None)
    return Instruments(model.remembering(simulated_motion.shift(motion.time_offset)), InstrumentKind.SIMULATED)


MAX_COPY_DISTANCE = 1e-9  # of a joint's range: positions that are as near are the same samples
MAX_COPIED_SHARE = 0.1  # share of such samples from which a recording is no other pass


def repeated_instruments(problem: Problem, k: int) -> Instruments | None:
    """Return the other pass that shares most samples with the k-th motion; None where it is not repeated.

    A copy of the same samples has the same noise, and does not count.
    """
    motion = problem.motions[k]
    # a motion object that occurs twice is one recording: its first place counts
    index_by_motion = {other_motion: m for m, other_motion in reversed(list(enumerate(problem.motions)))}  # each once
    candidates = (_pass_instruments(motion, other_motion, m) for other_motion, m in index_by_motion.items())
    return max(
        (instrument for instrument in candidates if instrument),
        key=lambda instrument: int(instrument.motion.mask.sum()),
        default=None,
    )


def _pass_instruments(motion: Motion, other_motion: Motion, m: int) -> Instruments | None:
    pairs = repeated_rows(motion, other_motion)
    if pairs is None:
        return None
    # measured positions of a moving joint never agree exactly: what does is a copy
    span = np.ptp(motion.q, axis=0)
    is_equal = np.abs(motion.q[pairs[0]] - other_motion.q[pairs[1]]) <= MAX_COPY_DISTANCE * span
    if is_equal[:, span > 0].all(axis=1).mean() > MAX_COPIED_SHARE:
        return None
    partner = np.full(len(motion), -1, dtype=np.intp)
    if other_motion is motion:  # what is passed again is a pass of what passes it
        partner[pairs[1]] = pairs[0]
    partner[pairs[0]] = pairs[1]
    # samples without partner get the state of sample zero, which the mask excludes
    mask, at = partner >= 0, np.maximum(partner, 0)
    memory = None if other_motion.memory is None else other_motion.memory[at]
    partner_states = replace(
        motion, q=other_motion.q[at], dq=other_motion.dq[at], ddq=other_motion.ddq[at], mask=mask, memory=memory
    )
    return Instruments(partner_states, InstrumentKind.REPEATED, None, m, partner)


MIN_LAG_SAMPLES = 3  # samples: central differences so far apart share none
MAX_ERROR_CORRELATION = 0.01  # correlation of the errors of accelerations that counts as none
SPECTRUM_POINTS = 2**14  # of a spectrum
# of a spectrum; differences by which positions become nearly white: no leak
SEGMENTS, MAX_SEGMENT_LENGTH, DIFFERENCE_ORDER = 16, 2**10, 2
MIN_RELATIVE_POWER = 1e-6  # of the largest power: too little to say what passes there


def lagged_instruments(
    model: Model, motion: Motion, log: Log | None, low_pass: ParallelFilter | None, lag: float | None
) -> Instruments:
    """Return the motion interpolated from a ``lag`` (s) before and after; None takes that of ``lag_of``.

    The equations are filtered by ``low_pass``. Raises ConfigError where the lag is shorter than the time between
    samples.
    """
    distance = lag_of(motion, log, low_pass) if lag is None else lag
    step = float(np.diff(motion.t).mean())
    if not distance > 0.99 * step:
        raise ConfigError(
            f"lag = {distance} s of the instruments is shorter than the time between samples, {step:.3g} s; "
            "give a longer one, or null."
        )
    before, after = motion.shift(-distance), motion.shift(distance)
    mask = _is_usable(motion, -distance) & _is_usable(motion, distance)
    q, dq, ddq = _midpoint_states(before, after, 2 * distance)
    midway_motion = replace(motion, q=q, dq=dq, ddq=ddq, mask=mask, memory=None)
    return Instruments(model.remembering(midway_motion), InstrumentKind.LAGGED, distance)


def lag_of(motion: Motion, log: Log | None, low_pass: ParallelFilter | None) -> float:
    """Return the time (s) beyond which errors of the accelerations of a motion are not correlated.

    White noise passes the smoother and twice the zero-phase filter ``low_pass``. The smoother's cut-off is found
    from the positions of log and motion, and its response is taken as that of a smoothing spline, 1 / (1 + (f /
    cut-off)^4). Without a log, positions count as measured.
    """
    step = float(np.diff(motion.t).mean())
    if log is None and low_pass is None:
        return MIN_LAG_SAMPLES * step
    f = np.arange(SPECTRUM_POINTS) / SPECTRUM_POINTS  # of half of the sampling rate
    # power spectrum of the error of an acceleration: white noise, differentiated twice, after the smoother
    power = f**4 / (1.0 + (f / (1.0 if log is None else cutoff_frequency(log.q, motion.q))) ** 4) ** 2
    if low_pass is not None:
        # zero-phase filtering applies the filter twice to the motion
        power *= np.abs(frequency_response(low_pass.sections(motion), SPECTRUM_POINTS)) ** 4
    correlation = np.fft.irfft(power)
    correlated = np.flatnonzero(np.abs(correlation[:SPECTRUM_POINTS]) > MAX_ERROR_CORRELATION * correlation[0])
    return max(MIN_LAG_SAMPLES, int(correlated.max()) + 1) * step


def cutoff_frequency(before: Array, after: Array) -> float:
    """Return the frequency above which less than half of some column (N, n) passes, in half of the sampling rate.

    It is also the frequency above which nothing is left to pass, as after the low-pass filter of a recorder.
    """
    length = int(np.clip(2 ** int(np.log2(max(len(before) // SEGMENTS, 1))), 16, MAX_SEGMENT_LENGTH))
    if len(before) < 2 * length:
        return 1.0
    # differences are nearly white, so that the large power at low frequencies does not leak into the others
    lowest, window = 1.0, np.hanning(length)
    for columns in zip(before.T, after.T, strict=True):
        differences = (np.diff(x, DIFFERENCE_ORDER) for x in columns)
        # of overlapping stretches
        parts = (np.lib.stride_tricks.sliding_window_view(x, length)[:: length // 2] for x in differences)
        spectrum_before, spectrum_after = (np.fft.rfft(part * window) for part in parts)
        power = np.square(np.abs(spectrum_before)).mean(axis=0)
        significant = power > MIN_RELATIVE_POWER * power.max()
        gain = np.abs((spectrum_before.conj() * spectrum_after).mean(axis=0)) / np.where(significant, power, np.inf)
        if significant.any():
            end = np.flatnonzero(significant)[-1] + 1
            # the first frequency of which less than half is left, among those that hold any power
            attenuated = np.flatnonzero(significant & (gain < 0.5)).min(initial=end)
            lowest = min(lowest, max(int(attenuated), 1) / (len(gain) - 1))
    return lowest


def _is_usable(motion: Motion, offset: float) -> NDArray[np.bool_]:
    """Return whether the motion is usable at each sample and at the time ``offset`` (s) from it."""
    at = motion.t + offset
    k = np.clip(np.searchsorted(motion.t, at, side="right") - 1, 0, len(motion) - 2)
    inside = (at >= motion.t[0]) & (at <= motion.t[-1])
    return np.asarray(motion.mask & inside & motion.mask[k] & motion.mask[k + 1])


def _midpoint_states(a: Motion, b: Motion, T: float) -> tuple[Array, Array, Array]:
    """Return q, dq, ddq (N, n) in the middle of the polynomials of degree five between states T s apart."""
    q = (a.q + b.q) / 2 + (5 / 32) * T * (a.dq - b.dq) + T**2 / 64 * (a.ddq + b.ddq)
    dq = (15 / 8) * (b.q - a.q) / T - (7 / 16) * (a.dq + b.dq) + T / 32 * (b.ddq - a.ddq)
    return q, dq, 1.5 * (b.dq - a.dq) / T - (a.ddq + b.ddq) / 4
