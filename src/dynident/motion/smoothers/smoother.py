"""The base of a smoother: Log -> Motion, that is position to velocity and acceleration."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, Self

import numpy as np
from annotated_types import Ge, Le
from numpy.typing import NDArray

from dynident.motion.log import Log, Motion, mark_read_only
from dynident.motion.splines import bridge_gaps, frozen_samples, noise_sigma, spikes, stretches, torn_ends
from dynident.runtime import (
    ConfigError,
    InputError,
    MissingInputError,
    Noun,
    Part,
    call_part,
    check_settings,
    choices,
    part_text,
    short,
)
from dynident.runtime.arrays import Array

BY_JOINT = "by joint"
"""Marks a setting, as ``Annotated[..., BY_JOINT]``, that may be a mapping by the names of the joints."""


class Smoother(Part, ABC):
    """Base of all smoothers: converts a ``Log`` to a ``Motion``.

    A smoother is a frozen dataclass of settings. It keeps t, tau, joints and source, does not use tau, and masks out
    the samples near the ends at which its derivatives are not reliable. It raises InputError where the log is too
    short, MissingInputError where the log has not the motion that it is made for, and ConfigError for settings outside
    the limits of their types.
    """

    def __post_init__(self) -> None:
        check_settings(self)

    @abstractmethod
    def __call__(self, log: Log) -> Motion:
        """Return q, dq, ddq (N, n) at the samples of the log."""

    @property
    def sigma(self) -> float | Mapping[str, float] | None:
        """Standard deviation of the position noise (rad, m) that it was given: one value or by joint; else None."""
        return None

    def with_noise(self, sigma: Mapping[str, float]) -> Self:
        """Return the smoother with the noise by joint where its setting ``sigma`` is None, else the same."""
        estimates_noise = "sigma" in getattr(self, "__dataclass_fields__", {}) and self.sigma is None
        return replace(self, sigma=sigma) if estimates_noise else self  # type: ignore[type-var]

    def as_used(self, motion: Motion) -> Smoother:  # noqa: ARG002
        """Return the smoother that smooths any log as much as it has smoothed that of ``motion``: a linear one.

        It is the smoother itself where it does not choose by the log how much to smooth.
        """
        return self

    def of_period(self, motion: Motion) -> Smoother:  # noqa: ARG002
        """Return the smoother with the period that it has used for a motion, if it looks for one of all joints."""
        return self

    def substitute(self) -> Smoother | None:
        """Return what smooths a log without the motion that the smoother is made for, where it is only judged.

        None where nothing does; MissingInputError says that a log has not this motion.
        """
        return None

    def by_joint(self, name: str, log: Log) -> list[Any]:
        """Return a setting at each joint of a log, None where a mapping lacks it; ConfigError for another joint."""
        setting = getattr(self, name)
        if not isinstance(setting, Mapping):
            return [setting] * len(log.joints)
        for joint in setting:
            if joint not in log.joints:
                raise ConfigError(f"{name} names the joint {joint!r}; the log has others; {choices(joint, log.joints)}")
        return [setting.get(joint) for joint in log.joints]


def make_motion(
    log: Log,
    channels: Iterable[Array],
    mask: NDArray[np.bool_],
    smoothing: Mapping[str, object],
    still: NDArray[np.bool_] | None = None,
) -> Motion:
    """Return the motion of a log with these new q, dq and ddq (N, n), which are not copied.

    Joints that stand ``still`` (n) are at rest at the mean of their measured positions.
    """
    if still is not None and still.any():
        rests = (log.q.mean(axis=0), np.zeros(1), np.zeros(1))
        channels = [np.where(still, rest_value, part) for rest_value, part in zip(rests, channels, strict=True)]
    q, dq, ddq = map(mark_read_only, channels)
    return Motion(log.t, q, dq, ddq, log.tau, log.joints, mask, log.source, smoothing)


def position_noise(log: Log) -> NDArray[np.float64]:
    """Return the standard deviation (n) of the noise in the positions of a log, which keeps it for all smoothers."""
    return log.fact("position noise", lambda: noise_sigma(log.t, log.q))


def ends_mask(log: Log, start: float, stop: float) -> NDArray[np.bool_]:
    """Return a mask (N) without the first ``start`` and the last ``stop`` seconds; InputError where none is left."""
    mask = (log.t >= log.t[0] + start) & (log.t <= log.t[-1] - stop)
    if not mask.any():
        raise InputError(
            f"{log.source}: {log.t[-1] - log.t[0]:.4g} s are too short: the derivatives are not reliable in the first "
            f"{start:.4g} s and the last {stop:.4g} s. Record longer, or smooth less."
        )
    return np.asarray(mask)


MAX_REST_RATIO = 3.0  # times the noise: a joint that moves less in the whole log is at rest
QUICK_SAMPLES = 1000  # samples in which a step is looked for that is less than what an encoder at rest may show


def at_rest(q: Array, smoothed: Array, noise: Array) -> NDArray[np.bool_]:
    """Return which joints (n) are at rest: within the noise, or within two counts of a quantised encoder."""
    span = np.ptp(q, axis=0)
    # the whole log is only searched where its start leaves the question open, which saves most of the time
    flicker = span <= 2.001 * least_step(q[:QUICK_SAMPLES])  # which is no less than that of all
    if flicker.any():
        count = least_step(q)
        flicker = span <= np.where(np.isfinite(count), 2.001 * count, 0.0)
    return np.asarray((np.ptp(smoothed, axis=0) <= MAX_REST_RATIO * noise) | flicker)


def least_step(q: Array) -> Array:
    """Return the least step (n) other than zero, inf where there is none."""
    steps = np.abs(np.diff(q, axis=0))
    return np.asarray(np.where(steps > 0, steps, np.inf).min(axis=0))


MAX_TIME_OFFSET = 60.0  # s


@dataclass(frozen=True)
class TimeShifted(Smoother):
    """Smooth with ``smoother``, then pair each torque with the motion ``time_offset`` (s) later.

    Filters, buses and drives delay positions and torques by different times. The torque is not shifted, because
    interpolating a noisy signal filters it.
    """

    smoother: Smoother
    time_offset: Annotated[float, Ge(-MAX_TIME_OFFSET), Le(MAX_TIME_OFFSET)]

    def __call__(self, log: Log) -> Motion:
        """Smooth and shift; samples whose motion lies outside the log are masked out."""
        return self.shift(call_part(self.smoother, log, Motion))

    def shift(self, motion: Motion) -> Motion:
        """Shift the motion that the smoother has made of a log."""
        shifted_motion = motion.shift(self.time_offset)
        if motion.mask.any() and not shifted_motion.mask.any():
            raise InputError(
                f"{motion.source}: with a `time_offset` of {self.time_offset:g} s no sample of its "
                f"{motion.t[-1] - motion.t[0]:.4g} s is left; give the true one, most often a few milliseconds."
            )
        smoothing = {**motion.smoothing, "time offset": f"{1e3 * self.time_offset:.3g} ms"}
        return replace(shifted_motion, smoothing=smoothing)

    def as_used(self, motion: Motion) -> TimeShifted:
        """Return the same shift of the smoother as it was used for a motion."""
        return TimeShifted(self.smoother.as_used(motion), self.time_offset)

    def substitute(self) -> TimeShifted | None:
        """Return the same shift of what stands in for the smoother, where it has something."""
        replacement = self.smoother.substitute()
        return None if replacement is None else TimeShifted(replacement, self.time_offset)

    def __str__(self) -> str:
        return f"{part_text(self.smoother)}, shifted by {short(1e3 * self.time_offset)} ms"


def strip_time_offset(smoother: Smoother) -> Smoother:
    """Return the smoother without its time offset."""
    return strip_time_offset(smoother.smoother) if isinstance(smoother, TimeShifted) else smoother


ACCURACY = 1e-10  # what may be left of the error at a cut, where the acceleration itself is wrong
MIN_OVERLAP = 32  # samples


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
    # each w gives two reciprocal roots z; the one inside the unit circle decays
    half = 1.0 + w / 2
    offset = np.sqrt(half**2 - 1.0)
    return float(np.abs(np.stack([half + offset, half - offset])).min(axis=0).max())


def overlap(smoother: Smoother, log: Log, motion: Motion) -> int:
    """Return the number of samples beside a piece after which its motion is that of the whole log, to 1e-9.

    ``motion`` is what the smoother, a linear one, has made of ``log``, or of a part of the recording like it.
    Raises ConfigError where the log is too short to tell.
    """
    step = float(np.median(np.diff(log.t)))
    offset_samples = math.ceil(abs(smoother.time_offset) / step) + 2 if isinstance(smoother, TimeShifted) else 0
    widths = motion.smoothing.get("bandwidth")
    if widths is None or motion.smoothing.get("order", 2) != 2:
        return offset_samples + _measure_overlap(strip_time_offset(smoother), log)
    slowest_decay = max(decay(float(width), step) for width in widths)
    # samples after which the influence of a cut has decayed to ACCURACY
    needed = MIN_OVERLAP + math.log(ACCURACY) / math.log(slowest_decay) if slowest_decay < 1.0 else math.inf
    if needed > len(log):
        raise ConfigError(
            f"{log.source}: the spline smooths over {max(widths):.3g} s, so that no piece of {len(log)} samples can "
            "be smoothed by itself; smooth less, or fit a shorter part of the recording."
        )
    return offset_samples + math.ceil(needed)


def _measure_overlap(smoother: Smoother, log: Log) -> int:
    """Return the overlap by trial: from where the motion of the second half of a log is that of all of it."""
    middle = len(log) // 2
    second_half = log.rows(slice(middle, None), log.source)
    full, cut = (call_part(smoother, recording, Motion) for recording in (log, second_half))
    last = middle + 3 * (len(log) - middle) // 4  # beyond, the other end counts
    wrong = np.zeros(last - middle, dtype=bool)
    for name in ("q", "dq", "ddq"):
        expected, part = getattr(full, name)[middle:last], getattr(cut, name)[: last - middle]
        wrong |= (np.abs(part - expected) > ACCURACY * np.abs(expected).max(axis=0)).any(axis=1)
    wrong_rows: NDArray[np.intp] = np.flatnonzero(wrong)
    needed = MIN_OVERLAP + (int(wrong_rows[-1]) + 1 if len(wrong_rows) else 0)
    if needed >= len(wrong):
        raise ConfigError(
            f"{log.source}: what {type(smoother).__name__} makes of a sample depends on others that are "
            f"{len(wrong) * float(np.median(np.diff(log.t))):.3g} s away, so that a long recording cannot be "
            "smoothed in pieces; take a spline, or fit a shorter part."
        )
    return needed


Mask = NDArray[np.bool_]

SUBSTITUTE = "smoothed in place of"  # what a substitute smooths a motion for: the class of a smoother
MAX_SPIKE_SHARE = 0.01  # share of a joint's samples: if more are spikes, they belong to the signal
MAX_FROZEN_SHARE = 0.25  # the same of frozen positions
MAX_WRONG_TORQUE_SHARE = 0.5  # the same of frozen and clipped torques, which a fit to the others shows to be wrong
MAX_SUSPECT_SHARE = 0.99  # share of all torques: if more are suspect, too few are left for that fit
MIN_CLIPPED = 10  # least number of values at exactly the largest or smallest
MIN_CLIPPED_RUN, MIN_CLIPPED_RUNS = 3, 2  # of which so many follow each other, so often; or once all of them
FROZEN_MARGIN = 8  # samples beside a frozen stretch whose derivatives are those of the bridge


class Suspects(Noun):
    """Where (N, n) positions and torques of a log look wrong: spikes, frozen stretches, values at a limit, and torques
    that never change (``torque_dead``) while those of other joints do.

    The torques are only suspects: whether they are wrong, a model must say.
    """

    position_spikes: Mask
    position_frozen: Mask
    torque_spikes: Mask
    torque_frozen: Mask
    torque_clipped: Mask
    torque_dead: Mask

    @cached_property
    def positions(self) -> Mask:
        """The positions (N, n) that are to be replaced: of joints in which they are few enough to be outliers."""
        few_spikes = select_rare(self.position_spikes, MAX_SPIKE_SHARE)
        return few_spikes | select_rare(self.position_frozen, MAX_FROZEN_SHARE)

    @cached_property
    def torques(self) -> Mask:
        """All suspect torques (N, n); none where they are nearly all of the log."""
        suspect = self.torque_spikes | self.torque_frozen | self.torque_clipped | self.torque_dead
        return suspect if suspect.mean() <= MAX_SUSPECT_SHARE else np.zeros_like(suspect)


def select_rare(mask: Mask, max_share: float) -> Mask:
    """Return the ``mask`` (N, n) of those joints only in which its share is at most ``max_share``."""
    return np.asarray(mask & (mask.mean(axis=0) <= max_share))


def suspects(log: Log) -> Suspects:
    """Return where the positions and torques of a log look wrong; the log keeps it."""

    def find() -> Suspects:
        clipped = _clipped_samples(log.tau)
        frozen_torque = frozen_samples(log.t, log.tau) & ~clipped
        q, tau = (spikes(log.t, x) | torn_ends(log.t, x) for x in (log.q, log.tau))
        constant = np.ptp(log.tau, axis=0) == 0
        # where all are constant, the whole arm may swing freely
        dead = np.broadcast_to(constant & ~constant.all(), log.tau.shape)
        return Suspects(q, frozen_samples(log.t, log.q), tau & ~clipped, frozen_torque, clipped, dead)

    return log.fact("suspects", find)


def _clipped_samples(tau: NDArray[np.float64]) -> Mask:
    """Return which torques (N, n) are exactly the largest or the smallest, other than zero, repeatedly."""
    mask = np.zeros(tau.shape, dtype=bool)
    for j, column in enumerate(tau.T):
        # zero is what a sensor at rest shows, not a limit
        for extreme in {float(column.min()), float(column.max())} - {0.0}:
            at_extreme = column == extreme
            lengths = [part.stop - part.start for part in stretches(at_extreme)]
            is_repeated = sum(length >= MIN_CLIPPED_RUN for length in lengths) >= MIN_CLIPPED_RUNS
            is_at_limit = sum(lengths) >= MIN_CLIPPED and (is_repeated or max(lengths) >= MIN_CLIPPED)
            if is_at_limit and not at_extreme.all():
                mask[:, j] |= at_extreme
    return mask


def repair_log(log: Log, *, torque: bool) -> Log:
    """Return the log with outliers of the positions replaced from their neighbours and excluded from the fit.

    With ``torque``, suspect torques are excluded too, until a model says that they are right.
    """
    marks = suspects(log)
    wrong, q = marks.positions, log.q
    if wrong.any():
        columns = (bridge_gaps(log.t, x, outliers) for x, outliers in zip(log.q.T, wrong.T, strict=True))
        q = np.stack(list(columns), axis=1)
    # next to a frozen stretch the derivatives are those of the bridge; next to a spike they are not
    stuck: Mask = np.asarray(marks.position_frozen & wrong)
    if stuck.any():
        from scipy.ndimage import binary_dilation  # seldom needed

        stuck = binary_dilation(stuck, np.ones((2 * FROZEN_MARGIN + 1, 1)))
    lost_rows = np.asarray(stuck | wrong).any(axis=1, keepdims=True)
    left_out = lost_rows | (marks.torques & torque)
    keep = ~left_out if log.keep is None else ~left_out & log.keep
    return replace(log, q=q, keep=keep) if left_out.any() else log


def smooth_log(smoother: Smoother, log: Log, *, judge_only: bool = False) -> Motion:
    """Return the motion of a log, of which the fit keeps what the log keeps.

    With ``judge_only`` the log is judged, not fitted: where it has not the motion that the smoother is made for,
    the smoother's substitute smooths it, and ``smoothing`` has the key ``SUBSTITUTE``. Excluded samples are
    neither in its mask nor kept. Raises the errors of the smoother, and ConfigError where its motion has not the
    samples of the log.
    """
    motion = _smooth_or_substitute(smoother, log) if judge_only else call_part(smoother, log, Motion)
    if len(motion) != len(log):
        name = type(strip_time_offset(smoother)).__name__
        raise ConfigError(
            f"{log.source}: the smoother {name} returns {len(motion)} samples for {len(log)}; "
            "return all of them, and mask out those that must not be used."
        )
    if log.excluded is None:
        return motion if log.keep is None else replace(motion, keep=log.keep)
    usable = np.broadcast_to(~log.excluded[:, None], log.q.shape)
    return replace(motion, mask=motion.mask & ~log.excluded, keep=usable if log.keep is None else usable & log.keep)


def _smooth_or_substitute(smoother: Smoother, log: Log) -> Motion:
    """Return the motion by a smoother, or by its substitute where it does not apply."""
    try:
        return call_part(smoother, log, Motion)
    except MissingInputError:
        substitute = smoother.substitute()
        if substitute is None:
            raise
    motion = call_part(substitute, log, Motion)
    return replace(motion, smoothing={**motion.smoothing, SUBSTITUTE: type(strip_time_offset(smoother)).__name__})
