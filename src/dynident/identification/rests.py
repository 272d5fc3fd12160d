"""Rests of the whole arm, at which friction is not determined: a hold says only an interval of it.

Those at the ends of a log are trimmed. Those within, which carry static torque, are left out of the fit only where this
predicts the torque in motion better.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Literal
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from dynident.errors import Note, Severity
from dynident.identification.cross_validation import Gain, gain_of
from dynident.log import Log, Motion, subsample
from dynident.models import Model
from dynident.smoothers import position_noise, repaired
from dynident.splines import stretches

__all__ = ["Rests", "hardly_moving", "moving_span", "resting", "trimmed", "whole_rests", "without_rests"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
BLOCK = 0.1  # s: a joint that stays within its noise so long stands still
NOISE, PACE = 8.0, 0.01  # times the noise, share of the usual pace: what a joint at rest moves in a block at most
CREEP, FAR = 0.01, 0.05  # shares of the range of a joint that it may creep in a rest, and may not whatever its noise
SHORTEST, CROSSING = 0.5, 0.1  # s, and share of the time in which the fastest joint crosses its range
MARGIN = 3  # blocks of a rest that stay at an end, for the smoother
HELD = 5e-3  # of the largest range of a joint of its kind: a joint whose range is less is held by its controller
HELD_WITHIN = {"revolute": 0.02, "prismatic": 1e-3}  # rad, m: likewise, a joint whose range is more does move
FEWEST = 200  # samples that must be left of a log
ROWS = 10_000  # samples with which it is decided on the rests within


@dataclass(frozen=True)
class Rests(Note):
    """How long (s) the whole arm rests at the ``start`` and the ``end`` of a log, which is trimmed, and ``within`` it.

    ``gain`` is that of leaving the rests within out of the fit, which ``left_out`` tells; None where there are none,
    or a log is not of the training.
    """

    severity: ClassVar[Severity] = Severity.INFO
    log: str
    start: float
    end: float
    within: float
    gain: Gain | None = None

    @property
    def left_out(self) -> bool:
        """Whether the rests within are left out of the fit."""
        return self.gain is not None and self.gain.sure


_KNOWN: WeakKeyDictionary[Log, tuple[slice, ...]] = WeakKeyDictionary()
_TRIMMED: WeakKeyDictionary[Log, Log | None] = WeakKeyDictionary()  # the same log each time, None where nothing is cut


def resting(log: Log) -> Mask:
    """Return for blocks of 0.1 s (B, n) whether each joint stays within its noise, or a hundredth of its usual pace."""
    reach = np.ptp(_blocks(log), axis=1)
    floor = np.maximum(NOISE * position_noise(log), PACE * np.percentile(reach, 95, axis=0))
    return np.asarray(reach <= floor)


def whole_rests(log: Log) -> tuple[slice, ...]:
    """Return the samples of the long rests of the whole arm, none where it never moves.

    Long is what lasts half a second, and a tenth of the time in which the fastest joint crosses its range at its usual
    pace. What creeps further than its noise or a hundredth of its range is slow, and not at rest.
    """
    if log not in _KNOWN:
        _KNOWN[log] = tuple(_whole_rests(repaired(log, torque=False))) if len(log) >= FEWEST else ()
    return _KNOWN[log]


def _whole_rests(log: Log) -> list[slice]:
    still, q = resting(log), _blocks(log)
    size, span, last = q.shape[1], np.ptp(log.q, axis=0), len(still)
    if still.all():
        return []
    second = float(log.t[-1] - log.t[0]) / (len(log) - 1)
    reach = np.where(still, np.nan, np.ptp(q, axis=1))[:, ~still.all(axis=0)]
    crossing = size * second * float(np.min(span[~still.all(axis=0)] / np.nanmedian(reach, axis=0)))
    least, creep = max(SHORTEST, CROSSING * crossing), np.maximum(2 * NOISE * position_noise(log), CREEP * span)
    creep = np.where(still.all(axis=0), np.inf, np.minimum(creep, FAR * span))
    return [
        slice(one.start * size, len(log) if one.stop == last else one.stop * size)
        for one in stretches(np.asarray(still.all(axis=1)))
        if (one.stop - one.start) * size * second >= least and (np.ptp(q[one].mean(axis=1), axis=0) <= creep).all()
    ]


def _blocks(log: Log) -> Array:
    """Return the positions in blocks of 0.1 s (B, samples of a block, n), without the last few samples."""
    size = min(max(5, round(BLOCK / float(np.median(np.diff(log.t))))), len(log))
    count = len(log) // size
    return log.q[: count * size].reshape(count, size, -1)


def _moving(log: Log) -> tuple[int, int]:
    """Return the first sample of the motion, and the one after its last: without the rests at the ends."""
    rests = whole_rests(log)
    first = rests[0].stop if rests and rests[0].start == 0 else 0
    return first, rests[-1].start if rests and rests[-1].stop == len(log) else len(log)


def hardly_moving(reach: Array, kinds: Sequence[str]) -> Mask:
    """Return which joints (n) are held while others move, by how far they move (n) in all recordings, in rad or m.

    A controller that holds a joint lets it give way a little; nothing is seen there of its friction. ``kinds`` are
    "revolute" or "prismatic".
    """
    of_kind = np.asarray(kinds)
    largest = np.array([reach[of_kind == kind].max() for kind in kinds])
    return np.asarray((reach < HELD * largest) & (reach < [HELD_WITHIN[kind] for kind in kinds]))


def moving_span(log: Log) -> tuple[float, float]:
    """Return the start and end (s) of the motion, without long rests of the whole arm at the ends of the log."""
    first, stop = _moving(log)
    return float(log.t[first]), float(log.t[min(stop, len(log) - 1)])


def trimmed(log: Log) -> Log:
    """Return the log without long rests of the whole arm at its ends, of which 0.3 s stay for the smoother.

    The log itself where there are none, or less than 200 samples would be left.
    """
    if log not in _TRIMMED:
        first, stop = _moving(log)
        margin = MARGIN * _blocks(log).shape[1]
        first, stop = max(first - margin, 0), min(stop + margin, len(log))
        kept = stop - first >= FEWEST and stop - first < len(log)
        _TRIMMED[log] = log.rows(slice(first, stop), log.source) if kept else None
    return _TRIMMED[log] or log


def without_rests(
    model: Model,
    motions: Mapping[str, Motion],
    recorded: Mapping[str, Mapping[str, Log]],
    rests: Literal["trim", "keep"],
    min_speed: tuple[float, ...] | None = None,
) -> tuple[dict[str, Motion], tuple[Rests, ...]]:
    """Return the motions of the training logs without the rests within that must not be fitted, and the rests of all.

    ``recorded`` are the logs by role and name, not yet trimmed. A minimum speed of every joint leaves out the rests
    itself.
    """
    if rests == "keep":
        return dict(motions), ()
    within = _within(recorded["train"])
    gain = None if min_speed and all(min_speed) else _gained(model, motions, within)
    if gain is not None and gain.sure:
        motions = {name: _moved(motion, within[name]) for name, motion in motions.items()}
    gains = {"train": gain}
    found = [
        _rests_of(name, log, gains.get(role)) for role, logs in recorded.items() for name, log in logs.items()
    ]  # fmt: skip
    return dict(motions), tuple(one for one in found if one.start or one.end or one.within)


def _within(logs: Mapping[str, Log]) -> dict[str, Mask]:
    """Return which samples (N) of the trimmed logs are of a rest within."""
    found = {}
    for name, log in logs.items():
        kept = trimmed(log)
        found[name] = np.zeros(len(kept), dtype=bool)
        for one in whole_rests(kept):
            found[name][one] = one.start > 0 and one.stop < len(kept)
    return found


def _gained(model: Model, motions: Mapping[str, Motion], rests: Mapping[str, Mask]) -> Gain | None:
    """Return what the fit gains without the rests, in the torque in motion; None where there are none."""
    if not any(one.any() for one in rests.values()):
        return None
    rows = subsample(list(motions.values()), ROWS)
    before, after = [], []
    for (name, motion), some in zip(motions.items(), rows, strict=True):
        if len(some) > 1:
            before.append(motion.shifted(0.0, some))
            after.append(_moved(before[-1], rests[name][some]))
    return gain_of(model, before, after)


def _moved(motion: Motion, rests: Mask) -> Motion:
    """Return the motion that keeps for the fit what is not at rest."""
    moving = np.broadcast_to(~rests[:, None], motion.q.shape)
    return replace(motion, keep=moving if motion.keep is None else moving & motion.keep)


def _rests_of(name: str, log: Log, gain: Gain | None) -> Rests:
    kept, (within,) = trimmed(log), _within({name: log}).values()
    return Rests(
        name,
        float(kept.t[0] - log.t[0]),
        float(log.t[-1] - kept.t[-1]),
        float(within.mean() * (kept.t[-1] - kept.t[0])),
        gain if within.any() else None,
    )
