"""The smoothers of a comparison: the motions that each makes, and the samples that all of them have in common."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.errors import DynidentError, InputError, MissingInputError, brief
from dynident.identification import Pairing, TimeOffset
from dynident.log import Motion
from dynident.ranking.candidates import Candidate
from dynident.ranking.rows import Outcome, empty_row, packed_masks
from dynident.ranking.task import Task
from dynident.regression import one_thread
from dynident.smoothers import Smoother, TimeShifted, unshifted
from dynident.tuning.cache import Cache

__all__ = ["Common", "Smoothing", "common_of", "failed", "motions_of", "shift_of", "shifted", "with_common"]

Mask = NDArray[np.bool_]
Motions = Mapping[str, Mapping[str, Motion]]
LEAST = 0.5  # share of the samples that most smoothers keep in a log, which one must keep to be compared
VALUES = 4e6  # samples times joints of motions that a process keeps: about half a gigabyte
_KNOWN: Cache[Motions] = Cache(4)  # motions that this process has made last, by task and smoother


@dataclass(frozen=True, eq=False)
class Smoothing:
    """Smooths all logs of a task by the candidate of a number: a job gives its row, with the samples that it keeps."""

    task: Task
    candidates: tuple[Candidate, ...]
    digests: tuple[str, ...]

    __repr__ = brief

    def __call__(self, k: int) -> dict[str, Any]:
        """Return the row of a candidate."""
        one = self.candidates[k]
        key = one.name, "", self.digests[k]
        began = time.perf_counter()
        try:
            with one_thread():
                paired = self.task.paired(one.parts, own=one.own)
                chosen, shift = _number(one, paired.smoother), shift_of(paired.time_offset)
                began = time.perf_counter()
                motions = motions_of(self.task, one, paired.smoother)
            seconds = time.perf_counter() - began
            masks = {role: {name: motion.mask for name, motion in named.items()} for role, named in motions.items()}
        except Exception as error:  # a smoother that fails is a row
            return empty_row(key, *failed(error), time.perf_counter() - began)
        found = {"masks": packed_masks(masks), "chosen": chosen, "shift": shift}
        return empty_row(key, Outcome.OK, "", seconds) | found


def _number(one: Candidate, part: Smoother) -> int:
    """Return the number of a part of a candidate."""
    plain = unshifted(part)
    return one.parts.index(plain) if plain in one.parts else 0


def shift_of(found: TimeOffset | None) -> list[float]:
    """Return a time offset that was estimated as numbers for a row, empty where none was."""
    return [] if found is None else [found.seconds, found.before, found.after, *([found.std] if found.std else [])]


def shifted(part: Smoother, shift: Sequence[float], late: float) -> Pairing:
    """Return a smoother with the time offset of its row, or else ``late`` (s)."""
    offset = TimeOffset(shift[0], shift[1], shift[2], shift[3] if len(shift) > 3 else None) if len(shift) else None
    seconds = offset.seconds if offset else late
    return Pairing(TimeShifted(unshifted(part), seconds) if seconds else part, None, offset)


def failed(error: Exception) -> tuple[Outcome, str]:
    """Return what an exception makes of a row, and the reason."""
    if isinstance(error, MemoryError):
        raise error  # the job as a whole has too little
    outcome = Outcome.NOT_APPLICABLE if isinstance(error, MissingInputError) else Outcome.FAILED
    return outcome, str(error) if isinstance(error, DynidentError) else f"{type(error).__name__}: {error}"


def motions_of(task: Task, one: Candidate, smoother: Smoother) -> Motions:
    """Return the motions by role and log of a candidate, as its ``smoother`` makes them; raises the errors of that."""
    values = sum(log.q.size for named in task.logs.repaired.values() for log in named.values())
    if values > VALUES:
        return task.logs.smoothed(smoother)
    return _KNOWN((task.digest, one.settings, repr(smoother)), lambda: task.logs.smoothed(smoother))


@dataclass(frozen=True, eq=False)
class Common:
    """The samples that count: those that all smoothers keep which are compared, ``masks`` (N) by role and log.

    ``apart`` are smoothers that keep so few that they are not compared, with the reason; ``shares`` the part (%) of the
    samples of each log that is left, ``kept`` that of all logs that each smoother keeps.
    """

    masks: Mapping[str, Mapping[str, Mask]]
    apart: Mapping[str, str]
    shares: Mapping[str, float]
    kept: Mapping[str, float]

    __repr__ = brief


def common_of(task: Task, masks: Mapping[str, Mapping[str, Mapping[str, Mask]]]) -> Common:
    """Return the samples that smoothers have in common, whose masks are given by smoother, role and log.

    A smoother that keeps less than half of what the median of them keeps of a log is left out: it would take from all
    others what they are compared on. InputError where a log has no sample in common.
    """
    apart = dict[str, str]()
    for role, named in task.motions.items():
        for log in named:
            sizes = {name: int(one[role][log].sum()) for name, one in masks.items()}
            usual = float(np.median(list(sizes.values())))
            for name, count in sizes.items():
                if count < LEAST * usual:
                    apart.setdefault(name, f"{log}: keeps {count} samples, where most smoothers keep {usual:.0f}")
    used = [one for name, one in masks.items() if name not in apart]
    common = {
        role: {log: _both([one[role][log] for one in used], motion.mask) for log, motion in named.items()}
        for role, named in task.motions.items()
    }
    every = {log: mask for some in common.values() for log, mask in some.items()}
    for log, mask in every.items():
        if not mask.any():
            raise InputError(f"{log}: no sample is kept by all smoothers; compare fewer of them.")
    shares = {log: 100.0 * float(mask.mean()) for log, mask in every.items()}
    kept = {name: _share(one) for name, one in masks.items() if name not in apart}
    return Common(common, apart, shares, kept)


def _share(masks: Mapping[str, Mapping[str, Mask]]) -> float:
    """Return the part (%) of the samples of all logs that is in masks."""
    return 100.0 * float(np.concatenate([mask for named in masks.values() for mask in named.values()]).mean())


def _both(masks: Sequence[Mask], own: Mask) -> Mask:
    return np.asarray(np.logical_and.reduce([own, *masks]))


def with_common(task: Task, motions: Motions, common: Common) -> dict[str, dict[str, Motion]]:
    """Return motions with the common samples and, of the training, the torques and equations that are fitted."""
    found: dict[str, dict[str, Motion]] = {"train": {}, "validation": {}}
    for role, named in motions.items():
        for name, motion in named.items():
            mask, like = common.masks[role][name], task.motions[role][name]
            kept = task.kept[role][name]
            keep = None if kept.all() else kept
            found[role][name] = task.model.remembering(replace(motion, mask=mask, tau=like.tau, keep=keep, memory=None))
    return found
