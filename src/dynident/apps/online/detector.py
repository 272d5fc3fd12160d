"""Detection of changes of a robot while it is watched, block by block, at a stated rate of false alarms.

A baseline first shows what is usual (``Reference``). Then each block is added to windows of all lengths.
Where one of them has more evidence of a change in one group of directions than the threshold, there is
an alarm. The blocks after it are kept apart: they show which groups have changed (forward selection) and
by how much; the reference moves by that, and the watch goes on. Where they show nothing, the disturbance
has passed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field, replace

import numpy as np

from dynident.apps.online.candidates import Candidates, ReferenceUpdate, is_base_group, residual_joint
from dynident.apps.online.events import Alarm, BaselineKnown, Changed, Event, NewMotion, Passed, Unsteady
from dynident.apps.online.scores import Reference, Scores, Sums, build_reference, push_sums, suffix_sums
from dynident.runtime import Noun
from dynident.runtime.arrays import Array

# of the scatter of a block: a larger error of the reference in a group says that its motion is new
NEW_MOTION_ERROR = 0.5
NEW_MOTION_BLOCKS = 12  # blocks of new motion in a row that are said
MAX_LIKELIHOOD_LOSS = 1.92  # log-likelihood that the true start of a change loses at most, at 95 %
MIN_SURE_EVIDENCE = 7.0  # evidence, of the blocks after an alarm, that it was none by chance: one test in a thousand


class Knowledge(Noun):
    """Knowledge after some blocks: all that the next one needs.

    Without a ``reference`` the next block is one of the baseline, after an ``alarm`` it shows what has changed; else it
    is watched. ``blocks`` are those of the baseline, or those since the alarm; ``windows`` the sums that are tested;
    ``total`` (M) is the change since the baseline, in all directions; ``new`` is the number of blocks in a
    row that were of new motion.
    """

    total: Array
    blocks: tuple[Scores, ...] = ()
    reference: Reference | None = None
    windows: tuple[Sums, ...] = ()
    alarm: Alarm | None = None
    new: int = 0


class Detector(Noun):
    """Finds changes among ``candidates`` by blocks: ``baseline`` of them first, ``settle`` of them after an
    alarm.

    ``threshold`` is the evidence from which on there is an alarm; ``identified`` (n) is the residual (N m,
    N) of the fit.
    """

    candidates: Candidates
    baseline: int
    settle: int
    threshold: float
    identified: Array = field(default_factory=lambda: np.zeros(0))

    def start(self) -> Knowledge:
        """Return the knowledge before the first block."""
        return Knowledge(np.zeros(self.candidates.directions.shape[1]))

    def step(self, knowledge: Knowledge, block: Scores) -> tuple[Knowledge, tuple[Event, ...]]:
        """Return the knowledge after one more block, and the events."""
        if knowledge.reference is None:
            return self._extend_baseline(knowledge, block)
        handle = self._watch if knowledge.alarm is None else self._settle
        return handle(knowledge, knowledge.reference, block)

    def differs(self, knowledge: Knowledge, block: Scores) -> bool:
        """Return whether a block alone surely differs from what is usual; False where that is not known yet."""
        if knowledge.reference is None or knowledge.alarm is not None:
            return False
        sums = self._window_sums(knowledge.reference, [block])
        return bool(self.candidates.evidence(knowledge.reference, sums, clipped=False).max() > MIN_SURE_EVIDENCE)

    def _extend_baseline(self, knowledge: Knowledge, block: Scores) -> tuple[Knowledge, tuple[Event, ...]]:
        blocks = (*knowledge.blocks, block)
        if len(blocks) < self.baseline:
            return replace(knowledge, blocks=blocks), ()
        # the later half goes on as the new baseline
        late_blocks = blocks[len(blocks) // 2 :]
        if (group_index := self._find_unsteady_group(blocks[: len(blocks) // 2], late_blocks)) is not None:
            group = self.candidates.groups[group_index]
            unsteady = Unsteady(block.stop, group.kind, group.joint, blocks[0].start)
            return replace(knowledge, blocks=late_blocks), (unsteady,)
        reference = build_reference(blocks, self.candidates.directions)
        residual, identified = (tuple(map(float, values)) for values in (reference.residual, self.identified))
        event = BaselineKnown(block.stop, blocks[0].start, residual, identified)
        return replace(knowledge, blocks=(), reference=reference), (event,)

    def _find_unsteady_group(self, early_blocks: Sequence[Scores], late_blocks: Sequence[Scores]) -> int | None:
        """Return the group that differs most between the halves of a baseline, None where that may be chance."""
        reference = build_reference(early_blocks, self.candidates.directions)
        evidence = self.candidates.evidence(reference, self._window_sums(reference, late_blocks), clipped=True)[:, 0]
        return int(np.argmax(evidence)) if evidence.max(initial=0.0) > self.threshold else None

    def _watch(self, knowledge: Knowledge, reference: Reference, block: Scores) -> tuple[Knowledge, tuple[Event, ...]]:
        # motion that the baseline has not shown: the reference learns from it, and no change is tested
        if self._motion_novelty(reference, block) > NEW_MOTION_ERROR:
            new_count = knowledge.new + 1
            events: tuple[Event, ...] = (NewMotion(block.stop, block.start),) if new_count == NEW_MOTION_BLOCKS else ()
            updated = reference.learn(block)
            # sums in the windows are relative to the reference, which has moved
            windows = self.candidates.rebase(knowledge.windows, updated.value - reference.value)
            return replace(knowledge, reference=updated, windows=windows, new=new_count), events
        windows = push_sums(knowledge.windows, self.candidates.sums(reference, block))
        starts, sums = suffix_sums(windows)
        # the clipped evidence raises the alarm, so that a single block cannot
        if self.candidates.evidence(reference, sums, clipped=True).max() < self.threshold:
            return replace(knowledge, windows=windows, new=0), ()
        evidence = self.candidates.evidence(reference, sums, clipped=False)
        g, w = (int(k) for k in np.unravel_index(np.argmax(evidence), evidence.shape))
        # all starts whose likelihood is nearly as large as the best: a likelihood interval
        likely_starts, group = starts[evidence[g] >= evidence[g, w] - MAX_LIKELIHOOD_LOSS], self.candidates.groups[g]
        start_range = float(likely_starts.min()), float(likely_starts.max())
        alarm = Alarm(block.stop, group.kind, group.joint, float(starts[w]), start_range, float(evidence[g, w]))
        return replace(knowledge, alarm=alarm, windows=(), new=0), (alarm,)

    def _settle(self, knowledge: Knowledge, reference: Reference, block: Scores) -> tuple[Knowledge, tuple[Event, ...]]:
        blocks = (*knowledge.blocks, block)
        if len(blocks) < self.settle or (alarm := knowledge.alarm) is None:
            return replace(knowledge, blocks=blocks), ()
        sums = self._window_sums(reference, blocks)
        changed_groups = self._select_groups(reference, sums)
        knowledge = replace(knowledge, blocks=(), alarm=None)
        if not changed_groups:
            return knowledge, (Passed(block.stop, alarm.kind, alarm.joint, alarm.since),)
        return self._apply_changes(knowledge, reference, sums, changed_groups, replace(alarm, time=block.stop))

    def _window_sums(self, reference: Reference, blocks: Sequence[Scores]) -> dict[str, Array]:
        total, *block_sums = (self.candidates.sums(reference, block) for block in blocks)
        for block in block_sums:
            total = total + block
        return suffix_sums([total])[1]

    def _motion_novelty(self, reference: Reference, block: Scores) -> float:
        """Return the error of the reference in a block, relative to its scatter, in the worst group of directions."""
        D = self.candidates.directions
        AD = block.information @ D
        scatter = (D * AD).sum(axis=0) * reference.spread
        error = (AD * (reference.unknown @ AD)).sum(axis=0)  # a change that was measured is no new motion
        is_shown = scatter > 1e-9 * scatter.max(initial=1e-300)
        ratio = np.divide(error, scatter, out=np.zeros_like(scatter), where=is_shown)
        parts = (part for part in self.candidates.group_slices if part.stop > part.start)
        return max((float(ratio[part].mean()) for part in parts), default=0.0)

    def _select_groups(self, reference: Reference, sums: dict[str, Array]) -> dict[int, float]:
        """Return the groups that have changed in a window after an alarm with their evidence, the clearest first."""
        changed_groups, current = dict[int, float](), reference
        # nothing lasting after the alarm: it has passed
        if self.candidates.evidence(reference, sums, clipped=True).max() < MIN_SURE_EVIDENCE:
            return changed_groups
        # forward selection: each further group must be a change beside those already taken
        while len(changed_groups) < len(self.candidates.groups):
            evidence = self.candidates.evidence(current, sums, clipped=False)[:, 0]
            evidence[list(changed_groups)] = 0.0
            g = int(np.argmax(evidence))
            if changed_groups and evidence[g] < self.threshold:
                break
            changed_groups[g] = float(evidence[g])
            update = self._estimate_update(reference, sums, changed_groups)
            current = reference if update is None else update.apply_to(reference)
        return changed_groups

    def _estimate_update(
        self, reference: Reference, sums: dict[str, Array], changed_groups: dict[int, float]
    ) -> ReferenceUpdate | None:
        """Return by how much base parameters have changed, None where only residuals have."""
        base = [g for g in changed_groups if is_base_group(self.candidates.groups[g])]
        return self.candidates.estimate_update(reference, sums, base) if base else None

    def _apply_changes(
        self,
        knowledge: Knowledge,
        reference: Reference,
        sums: dict[str, Array],
        changed_groups: dict[int, float],
        alarm: Alarm,
    ) -> tuple[Knowledge, tuple[Event, ...]]:
        """Return the knowledge after a change of these groups, and the events."""
        candidates, events, total = self.candidates, list[Event](), knowledge.total.copy()
        # the reference moves by the changes, so that the watch goes on from there
        update, end = self._estimate_update(reference, sums, changed_groups), 0
        updated = reference if update is None else update.apply_to(reference)
        for g, evidence in changed_groups.items():
            group, part = candidates.groups[g], candidates.group_slices[g]
            if update is not None and is_base_group(group):
                rows = slice(end, end := end + part.stop - part.start)
                size, std = update.size[rows], np.sqrt(update.variance[rows])
                total[part] += size
                total_change = total[part]
            else:
                size, std = candidates.residual_change(reference, sums, group)
                updated, total_change = updated.with_residual_change(residual_joint(group), 2 * float(size[0])), size
            events.append(Changed(
                alarm.time, group.kind, group.joint, alarm.since, alarm.between, group.names, group.units,
                tuple(size.tolist()), tuple(std.tolist()), tuple(total_change.tolist()), evidence,
            ))  # fmt: skip
        return replace(knowledge, reference=updated, total=total), tuple(events)
