"""Changes of a robot while it is watched, block by block, at a stated rate of false alarms.

At first a baseline shows what is usual (``Reference``). Then each block is added to windows of all lengths; where one
of them has more evidence of a change in one group of directions than the threshold, there is an alarm. The blocks after
it are kept apart: they show which groups have changed (forward selection) and by how much; the reference moves by that,
and the watch goes on. Where they show nothing, what was there has passed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.online.candidates import Candidates, is_base, joint_of
from dynident.online.events import Alarm, BaselineKnown, Changed, Event, NewMotion, Passed, Unsteady
from dynident.online.reference import Reference, reference_of
from dynident.online.scores import Scores
from dynident.online.windows import Sums, pushed, suffixes
from dynident.regression import Group

__all__ = ["Detector", "Knowledge", "Phase"]

Array = NDArray[np.float64]
NEW = 0.5  # of the scatter of a block: a larger error of the reference in a group says that its motion is new
LASTING = 12  # blocks of new motion in a row that are said
LIKELY = 1.92  # log-likelihood that the true start of a change loses at most, at 95 %
SURE = 7.0  # evidence, of the blocks after an alarm, that it was none by chance: one test in a thousand


class Phase(StrEnum):
    """What the next block is for."""

    BASELINE = "baseline"
    WATCH = "watch"
    SETTLE = "settle"


@dataclass(frozen=True, eq=False)
class Knowledge:
    """What is known after some blocks: all that the next one needs.

    ``blocks`` are those of the baseline, or those since an ``alarm``; ``windows`` the sums that are tried; ``total``
    (M) is what has changed since the baseline, in all directions; ``new`` how many blocks in a row were of new motion.
    """

    phase: Phase
    total: Array
    blocks: tuple[Scores, ...] = ()
    reference: Reference | None = None
    windows: tuple[Sums, ...] = ()
    alarm: Alarm | None = None
    new: int = 0

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class Detector:
    """Finds changes among ``candidates`` by blocks: ``baseline`` of them first, ``settle`` of them after an alarm.

    ``threshold`` is the evidence from which on there is an alarm; ``identified`` (n) the residual (N m, N) of the fit.
    """

    candidates: Candidates
    baseline: int
    settle: int
    threshold: float
    identified: Array = field(default_factory=lambda: np.zeros(0))

    __repr__ = brief

    def start(self) -> Knowledge:
        """Return what is known before the first block."""
        return Knowledge(Phase.BASELINE, np.zeros(self.candidates.directions.shape[1]))

    def step(self, known: Knowledge, block: Scores) -> tuple[Knowledge, tuple[Event, ...]]:
        """Return what is known after one more block, and what there is to say."""
        if known.reference is None:
            return self._baseline(known, block)
        how = self._watch if known.phase is Phase.WATCH else self._settle
        return how(known, known.reference, block)

    def differs(self, known: Knowledge, block: Scores) -> bool:
        """Return whether a block is surely not as usual, alone; False where it is not known what is usual."""
        if known.reference is None or known.phase is not Phase.WATCH:
            return False
        sums = self._window(known.reference, [block])
        return bool(self.candidates.evidence(known.reference, sums, clipped=False).max() > SURE)

    def _baseline(self, known: Knowledge, block: Scores) -> tuple[Knowledge, tuple[Event, ...]]:
        blocks = (*known.blocks, block)
        if len(blocks) < self.baseline:
            return replace(known, blocks=blocks), ()
        late = blocks[len(blocks) // 2 :]
        if (changed := self._unsteady(blocks[: len(blocks) // 2], late)) is not None:
            group = self.candidates.groups[changed]
            return replace(known, blocks=late), (Unsteady(block.stop, group.kind, group.joint, blocks[0].start),)
        reference = reference_of(blocks, self.candidates.directions)
        residual, fitted = (tuple(map(float, one)) for one in (reference.residual, self.identified))
        event = BaselineKnown(block.stop, blocks[0].start, residual, fitted)
        return replace(known, phase=Phase.WATCH, blocks=(), reference=reference), (event,)

    def _unsteady(self, early: Sequence[Scores], late: Sequence[Scores]) -> int | None:
        """Return the group that differs most between the halves of a baseline, None where that may be chance."""
        reference = reference_of(early, self.candidates.directions)
        shown = self.candidates.evidence(reference, self._window(reference, late), clipped=True)[:, 0]
        return int(np.argmax(shown)) if shown.max(initial=0.0) > self.threshold else None

    def _watch(self, known: Knowledge, reference: Reference, block: Scores) -> tuple[Knowledge, tuple[Event, ...]]:
        if self._newness(reference, block) > NEW:
            new = known.new + 1
            events: tuple[Event, ...] = (NewMotion(block.stop, block.start),) if new == LASTING else ()
            after = reference.learned(block)
            windows = self.candidates.rebased(known.windows, after.value - reference.value)
            return replace(known, reference=after, windows=windows, new=new), events
        windows = pushed(known.windows, self.candidates.sums(reference, block))
        starts, sums = suffixes(windows)
        if self.candidates.evidence(reference, sums, clipped=True).max() < self.threshold:
            return replace(known, windows=windows, new=0), ()
        shown = self.candidates.evidence(reference, sums, clipped=False)
        g, w = (int(k) for k in np.unravel_index(np.argmax(shown), shown.shape))
        near, group = starts[shown[g] >= shown[g, w] - LIKELY], self.candidates.groups[g]
        between = float(near.min()), float(near.max())
        alarm = Alarm(block.stop, group.kind, group.joint, float(starts[w]), between, float(shown[g, w]))
        return replace(known, phase=Phase.SETTLE, alarm=alarm, windows=(), new=0), (alarm,)

    def _settle(self, known: Knowledge, reference: Reference, block: Scores) -> tuple[Knowledge, tuple[Event, ...]]:
        blocks = (*known.blocks, block)
        if len(blocks) < self.settle or (alarm := known.alarm) is None:
            return replace(known, blocks=blocks), ()
        sums = self._window(reference, blocks)
        taken = self._selected(reference, sums)
        known = replace(known, phase=Phase.WATCH, blocks=(), alarm=None)
        if not taken:
            return known, (Passed(block.stop, alarm.kind, alarm.joint, alarm.since),)
        return self._moved(known, reference, sums, taken, replace(alarm, time=block.stop))

    def _window(self, reference: Reference, blocks: Sequence[Scores]) -> dict[str, Array]:
        total, *others = (self.candidates.sums(reference, one) for one in blocks)
        for one in others:
            total = total + one
        return suffixes([total])[1]

    def _newness(self, reference: Reference, block: Scores) -> float:
        """Return the error of the reference in a block, relative to its scatter, in the worst group of directions."""
        D = self.candidates.directions
        AD = block.information @ D
        own = (D * AD).sum(axis=0) * reference.spread
        error = (AD * (reference.unknown @ AD)).sum(axis=0)  # a change that was measured is no new motion
        shown = own > 1e-9 * own.max(initial=1e-300)
        ratio = np.divide(error, own, out=np.zeros_like(own), where=shown)
        return max((float(ratio[part].mean()) for part in self.candidates.parts if part.stop > part.start), default=0.0)

    def _selected(self, reference: Reference, sums: dict[str, Array]) -> dict[int, float]:
        """Return the groups that have changed in a window after an alarm with their evidence, the clearest first."""
        taken, at = dict[int, float](), reference
        if self.candidates.evidence(reference, sums, clipped=True).max() < SURE:
            return taken
        while len(taken) < len(self.candidates.groups):
            shown = self.candidates.evidence(at, sums, clipped=False)[:, 0]
            shown[list(taken)] = 0.0
            g = int(np.argmax(shown))
            if taken and shown[g] < self.threshold:
                break
            taken[g] = float(shown[g])
            at = self._beside(reference, sums, taken)
        return taken

    def _beside(self, reference: Reference, sums: dict[str, Array], taken: dict[int, float]) -> Reference:
        base = [g for g in taken if is_base(self.candidates.groups[g])]
        if not base:
            return reference
        return self.candidates.move(reference, sums, base).of(reference)

    def _moved(
        self, known: Knowledge, reference: Reference, sums: dict[str, Array], taken: dict[int, float], alarm: Alarm
    ) -> tuple[Knowledge, tuple[Event, ...]]:
        """Return what is known after a change of the groups taken, and the changes."""
        of, events, total = self.candidates, list[Event](), known.total.copy()
        after, end = self._beside(reference, sums, taken), 0
        base = [g for g in taken if is_base(of.groups[g])]
        move = of.move(reference, sums, base) if base else None
        for g, chance in taken.items():
            group, part = of.groups[g], of.parts[g]
            if move is not None and is_base(group):
                some = slice(end, end := end + part.stop - part.start)
                size, std = move.size[some], np.sqrt(move.variance[some])
                total[part] += size
                whole = total[part]
            else:
                size, std = of.louder(reference, sums, group)
                after, whole = after.louder(joint_of(group), 2 * float(size[0])), size
            events.append(_changed(alarm, group, size, std, whole, chance))
        return replace(known, reference=after, total=total), tuple(events)


def _changed(alarm: Alarm, group: Group, size: Array, std: Array, total: Array, chance: float) -> Changed:
    return Changed(
        alarm.time, group.kind, group.joint, alarm.since, alarm.between, group.names, group.units,
        tuple(size.tolist()), tuple(std.tolist()), tuple(total.tolist()), chance,
    )  # fmt: skip
