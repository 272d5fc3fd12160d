"""How to identify: the parts that can be exchanged, as asked for and as used."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from numbers import Real
from reprlib import repr as short_repr
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from dynident.estimators import Estimator, LeastSquares
from dynident.identification.cross_validation import Gain, motion_gain
from dynident.models import Joint, Model
from dynident.motion.log import Log, Motion, subsample
from dynident.motion.smoothers import Smoother, Spline, position_noise, repair_log, smooth_log
from dynident.motion.splines import stretches
from dynident.regression import EVERYTHING, ParallelFilter, Selection
from dynident.runtime import OMITTED, ConfigError, Note, Severity, choices, settings_repr, short
from dynident.runtime.arrays import Array

Mask = NDArray[np.bool_]
BLOCK_DURATION = 0.1  # s: a joint that stays within its noise so long stands still
# times the noise, share of the usual pace: what a joint at rest moves in a block at most
MAX_REST_NOISE, MAX_REST_PACE = 8.0, 0.01
# shares of the range of a joint that it may creep in a rest, and may not whatever its noise
MAX_CREEP, MAX_REST_RANGE = 0.01, 0.05
MIN_REST_DURATION, MIN_REST_CROSSING = 0.5, 0.1  # s, and share of the time in which the fastest joint crosses its range
MARGIN_BLOCKS = 3  # blocks of a rest that stay at an end, for the smoother
# of the largest range of a joint of its kind: a joint whose range is less is held by its controller
MAX_HELD_SHARE = 5e-3
MAX_HELD_RANGE = {"revolute": 0.02, "prismatic": 1e-3}  # rad, m: likewise, a joint whose range is more does move
MIN_SAMPLES = 200  # samples that must be left of a log
DECISION_SAMPLES = 10_000  # samples with which it is decided on the rests within


class Rests(Note):
    """How long (s) the whole arm rests at the ``start`` and ``end`` of a log, where it is trimmed, and ``within``.

    ``gain`` is that of leaving the rests within out of the fit, as ``left_out`` tells; None where there are none,
    or for a log that is not of the training.
    """

    severity = Severity.INFO
    log: str
    start: float
    end: float
    within: float
    gain: Gain | None = None

    @property
    def left_out(self) -> bool:
        """Whether the rests within are left out of the fit."""
        return self.gain is not None and self.gain.sure

    def __str__(self) -> str:
        lengths = {"start": self.start, "end": self.end}
        ends = [f"{short(length)} s at its {end}" for end, length in lengths.items() if length]
        parts = [f"{' and '.join(ends)}, where the arm is at rest, are left out of fit and errors"] if ends else []
        if self.within:
            use = f"fitted: without them {self.gain} in motion would be gained"
            if self.gain is None or self.left_out:
                use = (
                    f"left out of the fit, which gains {self.gain} in motion" if self.gain else "counted in its errors"
                )
            parts.append(f"rests of {short(self.within)} s within are {use}")
        return f"{self.log}: {'; '.join(parts)}"


def rest_blocks(log: Log) -> Mask:
    """Return for blocks of 0.1 s (B, n) whether each joint stays within its noise, or 1 % of its usual pace."""
    # The range within a block, compared with the noise and with the usual range of a moving block.
    reach = np.ptp(_position_blocks(log), axis=1)
    floor = np.maximum(MAX_REST_NOISE * position_noise(log), MAX_REST_PACE * np.percentile(reach, 95, axis=0))
    return np.asarray(reach <= floor)


def arm_rests(log: Log) -> tuple[slice, ...]:
    """Return the samples of the long rests of the whole arm, none where it never moves.

    A long rest lasts half a second, and a tenth of the time in which the fastest joint crosses its range at its
    usual pace. Motion that creeps further than its noise or a hundredth of its range is slow, and no rest.
    """
    if len(log) < MIN_SAMPLES:
        return ()
    return log.fact("rests", lambda: tuple(_find_arm_rests(repair_log(log, torque=False))))


def _find_arm_rests(log: Log) -> list[slice]:
    is_resting, q = rest_blocks(log), _position_blocks(log)
    size, joint_range, n_blocks = q.shape[1], np.ptp(log.q, axis=0), len(is_resting)
    if is_resting.all():
        return []
    sample_time = float(log.t[-1] - log.t[0]) / (len(log) - 1)
    # The usual pace is the median range of moving blocks; joints that never move have none.
    reach = np.where(is_resting, np.nan, np.ptp(q, axis=1))[:, ~is_resting.all(axis=0)]
    crossing = size * sample_time * float(np.min(joint_range[~is_resting.all(axis=0)] / np.nanmedian(reach, axis=0)))
    min_duration = max(MIN_REST_DURATION, MIN_REST_CROSSING * crossing)
    max_creep = np.maximum(2 * MAX_REST_NOISE * position_noise(log), MAX_CREEP * joint_range)
    # A joint that never moves may creep: it rests all the time.
    max_creep = np.where(is_resting.all(axis=0), np.inf, np.minimum(max_creep, MAX_REST_RANGE * joint_range))
    return [
        slice(rest.start * size, len(log) if rest.stop == n_blocks else rest.stop * size)
        for rest in stretches(np.asarray(is_resting.all(axis=1)))
        if (rest.stop - rest.start) * size * sample_time >= min_duration
        and (np.ptp(q[rest].mean(axis=1), axis=0) <= max_creep).all()
    ]


def _position_blocks(log: Log) -> Array:
    """Return the positions in blocks of 0.1 s (B, samples of a block, n), without the last few samples."""
    size = min(max(5, round(BLOCK_DURATION / float(np.median(np.diff(log.t))))), len(log))
    count = len(log) // size
    return log.q[: count * size].reshape(count, size, -1)


def _moving_rows(log: Log) -> tuple[int, int]:
    """Return the first sample of the motion and the one after its last, without the rests at the ends."""
    rests = arm_rests(log)
    start = rests[0].stop if rests and rests[0].start == 0 else 0
    return start, rests[-1].start if rests and rests[-1].stop == len(log) else len(log)


def held_joints(reach: Array, kinds: Sequence[str]) -> Mask:
    """Return which joints (n) are held while others move, by their range (n) over all recordings, in rad or m.

    A controller that holds a joint lets it give way a little; this motion does not show friction. ``kinds`` are
    "revolute" or "prismatic".
    """
    of_kind = np.asarray(kinds)
    largest = np.array([reach[of_kind == kind].max() for kind in kinds])
    return np.asarray((reach < MAX_HELD_SHARE * largest) & (reach < [MAX_HELD_RANGE[kind] for kind in kinds]))


def moving_span(log: Log) -> tuple[float, float]:
    """Return the start and end (s) of the motion, without long rests of the whole arm at the ends of the log."""
    start, stop = _moving_rows(log)
    return float(log.t[start]), float(log.t[min(stop, len(log) - 1)])


def trim_rests(log: Log) -> Log:
    """Return the log without long rests of the whole arm at its ends, of which 0.3 s stay for the smoother.

    The log itself is returned where there are none, or fewer than 200 samples would be left.
    """
    return log.fact("trimmed log", lambda: _trim_rests(log))


def _trim_rests(log: Log) -> Log:
    start, stop = _moving_rows(log)
    margin = MARGIN_BLOCKS * _position_blocks(log).shape[1]
    start, stop = max(start - margin, 0), min(stop + margin, len(log))
    is_trimmed = stop - start >= MIN_SAMPLES and stop - start < len(log)
    return log.rows(slice(start, stop), log.source) if is_trimmed else log


def without_rests(
    model: Model,
    motions: Mapping[str, Motion],
    recorded: Mapping[str, Mapping[str, Log]],
    rests: Literal["trim", "keep"],
    selection: Selection = EVERYTHING,
) -> tuple[dict[str, Motion], tuple[Rests, ...]]:
    """Return the training motions, without the rests within where these must not be fitted, and all rests.

    ``recorded`` are the logs by role and name, not yet trimmed. A minimum speed of every joint leaves out the
    rests itself.
    """
    if rests == "keep":
        return dict(motions), ()
    rest_masks = _inner_rest_masks(recorded["train"])
    # A minimum speed leaves the rests out anyway, so that there is nothing to decide.
    gain = None if selection.min_speed and all(selection.min_speed) else _gain_without_rests(model, motions, rest_masks)
    if gain is not None and gain.sure:
        motions = {name: keep_moving(motion, rest_masks[name]) for name, motion in motions.items()}
    gains = {"train": gain}
    notes = [_rest_note(name, log, gains.get(role)) for role, logs in recorded.items() for name, log in logs.items()]
    return dict(motions), tuple(note for note in notes if note.start or note.end or note.within)


def _inner_rest_masks(logs: Mapping[str, Log]) -> dict[str, Mask]:
    """Return which samples (N) of the trimmed logs belong to a rest within the motion."""
    masks = {}
    for name, log in logs.items():
        trimmed_log = trim_rests(log)
        masks[name] = np.zeros(len(trimmed_log), dtype=bool)
        for rest in arm_rests(trimmed_log):
            masks[name][rest] = rest.start > 0 and rest.stop < len(trimmed_log)
    return masks


def _gain_without_rests(model: Model, motions: Mapping[str, Motion], rests: Mapping[str, Mask]) -> Gain | None:
    """Return the gain of the fit without the rests, in the torque in motion; None where there are none."""
    if not any(mask.any() for mask in rests.values()):
        return None
    rows = subsample(list(motions.values()), DECISION_SAMPLES)
    before, after = [], []
    for (name, motion), indices in zip(motions.items(), rows, strict=True):
        if len(indices) > 1:
            # Both versions have the same samples; only the mask of the fit differs.
            before.append(motion.shift(0.0, indices))
            after.append(keep_moving(before[-1], rests[name][indices]))
    return motion_gain(model, before, after)


def keep_moving(motion: Motion, rests: Mask) -> Motion:
    """Return the motion with the samples at rest left out of the fit."""
    moving = np.broadcast_to(~rests[:, None], motion.q.shape)
    return replace(motion, keep=moving if motion.keep is None else moving & motion.keep)


def _rest_note(name: str, log: Log, gain: Gain | None) -> Rests:
    trimmed_log, (rest_mask,) = trim_rests(log), _inner_rest_masks({name: log}).values()
    return Rests(
        name,
        float(trimmed_log.t[0] - log.t[0]),
        float(log.t[-1] - trimmed_log.t[-1]),
        float(rest_mask.mean() * (trimmed_log.t[-1] - trimmed_log.t[0])),
        gain if rest_mask.any() else None,
    )


Recorded = TypeVar("Recorded", Log, Motion)


def _is_smoother(value: object) -> bool:
    if isinstance(value, tuple):
        return len(value) > 0 and all(isinstance(part, Smoother) for part in value)
    return isinstance(value, Smoother)


def _is_number(value: Any) -> bool:
    return not isinstance(value, bool) and isinstance(value, Real) and math.isfinite(value)


def _is_speed(value: Any) -> bool:
    values = value.values() if isinstance(value, Mapping) else (value,)
    return value is None or all(_is_number(speed) and speed >= 0 for speed in values)


def _are_proposing(value: object) -> bool:
    return isinstance(value, tuple) and all(
        isinstance(term_class, type) and hasattr(term_class, "proposed") for term_class in value
    )


def _is_estimate(value: object) -> bool:
    return isinstance(value, str) and value == "estimate"


def _is_tilt(value: object) -> bool:
    return isinstance(value, tuple) and len(value) == 2 and all(map(_is_number, value))


_FIELDS: Mapping[str, tuple[Callable[[Any], bool], str]] = {
    "smoother": (_is_smoother, "a smoother, such as Spline(), or a tuple of them"),
    "estimator": (lambda value: isinstance(value, Estimator), "an estimator, such as LeastSquares()"),
    "filter": (lambda value: isinstance(value, ParallelFilter | None), "a ParallelFilter or None"),
    "min_speed": (_is_speed, "a number of at least 0, such numbers by joint, or None"),
    "time_offset": (lambda value: _is_estimate(value) or _is_number(value), "a finite number (s) or 'estimate'"),
    "base_tilt": (
        lambda value: value is None or _is_estimate(value) or _is_tilt(value), "two angles (rad), 'estimate' or None",
    ),
    "outliers": (lambda value: value in ("mask", "keep"), "'mask' or 'keep'"),
    "rests": (lambda value: value in ("trim", "keep"), "'trim' or 'keep'"),
    "terms": (lambda value: value in (None, "auto"), "'auto' or None"),
    "proposed": (_are_proposing, "classes of terms with a class method `proposed`, in a tuple"),
    "unfitted": (
        lambda value: isinstance(value, tuple) and all(isinstance(name, str) for name in value),
        "names of joints, in a tuple",
    ),
    "restart": (lambda value: value is None or (_is_number(value) and value > 0), "a positive number (s) or None"),
}  # fmt: skip


@dataclass(frozen=True)
class Recipe:
    """How to identify: the interchangeable parts, with the article's method as the default.

    Of several smoothers, ``choose_smoother`` takes one by the cross-validated torque error on the training logs.
    ``min_speed``, a speed (rad/s, m/s) or one by joint name, leaves slower samples out of that joint's equation in the
    fit. ``time_offset`` (s) is how much later than the torque the positions show the motion, and ``base_tilt`` are the
    rotations (rad) of the robot's base about the x and y axes of its root link; "estimate" finds either on the training
    logs. ``restart`` (s) asks for free simulations from the measured torque; logs that know their controller need none.
    ``outliers`` "mask" replaces spikes and frozen stretches of positions, and leaves wrong torques out of the fit.
    ``rests`` "trim" cuts long rests of the whole arm off the ends of the logs, and leaves those within out of the fit
    where this predicts the torque in motion better.
    ``terms`` "auto" adds to the model the terms of each joint that the training logs choose, as ``choose_terms`` does,
    and chooses ``min_speed`` with them where none is given; classes of terms in ``proposed``, which say by their method
    ``proposed`` in what sizes they are to be tried on a joint, then take part. The torque equations of ``unfitted``
    joints are not fitted; their torque is predicted and judged all the same.

    A recipe as used, that of an ``Identification``, has one smoother, which gives the motion with the time offset, and
    numbers: nothing in it is left to choose. Raises ConfigError for a field of another type.

    >>> import dynident as dy
    >>> dy.Recipe(dy.Difference("central"), time_offset="estimate")
    Recipe(smoother=Difference(scheme='central'), time_offset='estimate')
    """

    smoother: Smoother | tuple[Smoother, ...] = field(default_factory=Spline)
    estimator: Estimator = field(default_factory=LeastSquares)
    filter: ParallelFilter | None = None
    min_speed: Mapping[str, float] | float | None = None
    time_offset: float | Literal["estimate"] = 0.0
    base_tilt: tuple[float, float] | Literal["estimate"] | None = None
    restart: float | None = None
    outliers: Literal["mask", "keep"] = "mask"
    rests: Literal["trim", "keep"] = "trim"
    terms: Literal["auto"] | None = None
    proposed: Annotated[tuple[type, ...], OMITTED] = ()
    unfitted: tuple[str, ...] = ()

    __repr__ = settings_repr

    def __post_init__(self) -> None:
        for name in ("smoother", "base_tilt", "unfitted"):
            if isinstance(value := getattr(self, name), list):
                object.__setattr__(self, name, tuple(value))
        for name, (is_valid, expected) in _FIELDS.items():
            if not is_valid(value := getattr(self, name)):
                raise ConfigError(f"recipe: {name} is {short_repr(value)}; it must be {expected}.")

    @property
    def smoothers(self) -> tuple[Smoother, ...]:
        """The smoothers to choose from, most often one."""
        return self.smoother if isinstance(self.smoother, tuple) else (self.smoother,)

    def motion(self, log: Log) -> Motion:
        """Return the motion of a log that is judged, by the smoother, or its substitute where that does not apply.

        Raises the errors of the smoother, and ConfigError where it is still to be chosen among several.
        """
        if len(self.smoothers) != 1:
            raise ConfigError(f"the recipe has {len(self.smoothers)} smoothers to choose from; name one, or identify.")
        return smooth_log(self.smoothers[0], self.repair(log), judge_only=True)

    def trim(self, log: Log) -> Log:
        """Return the log without long rests of the whole arm at its ends."""
        return trim_rests(log) if self.rests == "trim" else log

    def repair(self, log: Log, *, torque: bool = False) -> Log:
        """Return the log without outliers of the positions.

        With ``torque``, suspect torques are not kept either, nor those of joints that are not fitted.
        """
        repaired_log = repair_log(log, torque=torque) if self.outliers == "mask" else log
        return self.drop_unfitted(repaired_log) if torque else repaired_log

    def drop_unfitted(self, recording: Recorded) -> Recorded:
        """Return a log or motion of which the joints that are not fitted are left out of the fit."""
        if not self.unfitted:
            return recording
        keep = np.broadcast_to([name not in self.unfitted for name in recording.joints], recording.q.shape)
        return replace(recording, keep=keep if recording.keep is None else keep & recording.keep)

    def check_joints(self, joints: Sequence[str]) -> None:
        """Raise ConfigError where joints that are not fitted are unknown, or all of them."""
        for name in self.unfitted:
            if name not in joints:
                raise ConfigError(f"unfitted: there is no joint {name!r}; {choices(name, joints)}")
        if set(joints) <= set(self.unfitted):
            raise ConfigError("unfitted: names every joint, so that nothing is left to fit; leave one out.")

    def selection(self, joints: Sequence[Joint]) -> Selection:
        """Return which samples of these joints the fit uses; ConfigError where ``min_speed`` names another joint."""
        return Selection(self.filter, self.min_speeds([joint.name for joint in joints]))

    def min_speeds(self, joints: Sequence[str]) -> tuple[float, ...] | None:
        """Return ``min_speed`` for each joint; ConfigError where it names another."""
        if self.min_speed is None or not isinstance(self.min_speed, Mapping):
            return None if self.min_speed is None else (float(self.min_speed),) * len(joints)
        for name in self.min_speed:
            if name not in joints:
                raise ConfigError(f"min_speed: there is no joint {name!r}; {choices(name, joints)}")
        return tuple(float(self.min_speed.get(name, 0.0)) for name in joints)
