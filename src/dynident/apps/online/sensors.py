"""Checks of the sensors of a stream: missing numbers, values that freeze, jumps.

A position that freezes stops within one sample, which no joint can do: its last step is many times as
large as steps usually differ from one to the next. A joint that comes to rest slows down. Where a
position froze near a turn, only the torques of the arm can tell it from a rest: it is reported as still
when that lasts longer than usual while others move, and a caller that has the torques may ``excuse`` it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import inf, isfinite
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynident.apps.online.events import Back, Event, Fault, FaultKind, Signal
from dynident.runtime.arrays import Array

MISSING_SAMPLES = 3  # samples in a row without a number
FROZEN_SAMPLES, FROZEN_TIME = 10, 0.05  # samples, and s, of a position that froze
ABRUPT_STOP_RATIO = 8.0  # times the usual difference of two steps: what a joint cannot do
CONSTANT_TORQUE_TIME = 1.0  # s of a torque that does not change while the robot moves
CONSTANT_POSITION_TIME = 5.0  # s of a position that does not change while others do
TORQUE_HOLD_FACTOR = 10.0  # times the longest that was usual before, of a torque
POSITION_HOLD_FACTOR = 2.0  # times the longest that was usual before, of a position
MAX_HOLD_TIME = 60.0  # s: what is usual asks for no more
RECOVERY_SAMPLES = 10  # samples that a sensor must work again
MAX_SPEED_FACTOR = 2.0  # times the velocity limit
MAX_STEP_FACTOR = 20.0  # times the largest usual step, where there is no limit
JUMP_SAMPLES = 4  # samples after which a jump is no spike
MAX_JUMPS, JUMP_PAUSE = 2, 60.0  # jumps that are reported singly, each within s of the one before; more are a fault
MIN_OTHER_MOTION = 0.01  # rad, m: what others move at least while one does not
AVERAGING_SAMPLES = 500.0  # samples over which what is usual is averaged
SETTLING_SAMPLES = 50  # samples until something is usual
MAX_POSITION, MAX_TORQUE = 1e6, 1e9  # rad or m, N m or N: what is larger is no value of a sensor
FAULT_KINDS = (FaultKind.MISSING, FaultKind.FROZEN, FaultKind.STILL, FaultKind.JUMPING)
MISSING, FROZEN, STILL, JUMPING = range(1, 1 + len(FAULT_KINDS))  # their numbers; 0 is none


def possible_values(q: Array, tau: Array) -> tuple[Array, Array]:
    """Return positions and torques (N, n), nan for what is no value: it would drown all others in the sums."""
    # a sum of squares, nan where a value is, takes a fifth of the time for a single sample
    if np.vdot(q, q) <= MAX_POSITION**2 and np.vdot(tau, tau) <= MAX_TORQUE**2:
        return q, tau
    return np.where(np.abs(q) <= MAX_POSITION, q, np.nan), np.where(np.abs(tau) <= MAX_TORQUE, tau, np.nan)


class SensorCheck(NamedTuple):
    """Result of the check of the first N samples.

    ``rows`` (N) are those that can be used, by joint with its torque where ``torque_usable`` (N, n), and
    ``events`` are to be reported. The N-th is the last sample, or one where a position is reported as still.
    ``cuts`` are the rows at which a motion ends: what was not yet used of it is dropped. ``is_plain`` where all can
    be used, and nothing is reported.
    """

    rows: NDArray[np.bool_]
    torque_usable: NDArray[np.bool_]
    cuts: tuple[int, ...]
    events: tuple[Event, ...]
    is_plain: bool = False


class Sensors:
    """Checks 2 n channels, the positions and torques of ``joints``.

    ``velocity`` are the limits (rad/s, m/s; None where they are not known).
    """

    def __init__(self, joints: Sequence[str], velocity: Sequence[float | None]) -> None:
        self.joints = tuple(joints)
        self.fastest = np.array([np.inf if v is None else MAX_SPEED_FACTOR * v for v in velocity])
        self.limited = np.isfinite(self.fastest)
        self.least = np.where(self.limited, self.fastest, 0.0)
        n = 2 * len(self.joints)
        self.seen, self.t, self.path = 0, np.nan, 0.0  # samples, the last stamp, what all positions have moved
        self.value, self.step = np.full(n, np.nan), np.zeros(n)
        self.bend = np.zeros(n)  # mean square difference of steps
        self.run, self.since, self.path_then = np.zeros(n), np.zeros(n), np.zeros(n)  # samples without a change
        self.abrupt, self.longest = np.zeros(n), np.zeros(n)  # how it stopped; s without a change that are usual
        self.missed, self.lost = np.zeros(n), np.zeros(n)  # samples in a row without a number, since when
        self.fault, self.began, self.well = np.zeros(n), np.zeros(n), np.zeros(n)  # 1 + number of the kind
        m = len(self.joints)
        self.jumped, self.leap = np.zeros(m), np.zeros(m)  # samples since what may be a jump of a position, its size
        self.left, self.left_at, self.pace = np.zeros(m), np.zeros(m), np.zeros(m)  # the value before it, when
        self.jumps, self.jumped_at = np.zeros(n), np.full(n, -np.inf)  # jumps of a position, and the last of them (s)
        self.alive = np.zeros(n)  # whether it has ever changed: a channel that is not recorded does not die
        self.excused = np.zeros(n)  # whether it is known to rest, until it changes
        self.moved = np.zeros(m)  # samples in which it moved
        self.gone = self.held = self.leaps = self.faulty = self.dead = False  # whether any of these is

    @property
    def state(self) -> dict[str, Array]:
        """State as arrays."""
        return {name: np.array(value, dtype=float) for name, value in self._state_values().items()}

    def restore(self, state: Mapping[str, Array]) -> None:
        """Continue from a saved state."""
        for name, value in self._state_values().items():
            saved = np.array(state[name], dtype=float)
            setattr(self, name, saved if isinstance(value, np.ndarray) else type(value)(saved))

    def _state_values(self) -> dict[str, Array | float | int]:
        return {
            name: value for name, value in vars(self).items() if name not in ("joints", "fastest", "limited", "least")
        }

    def check(self, t: Array, q: Array, tau: Array) -> SensorCheck:
        """Check samples: t (N) s, increasing; q and tau (N, n), nan where there is no number."""
        n, cuts, events = len(self.joints), list[int](), list[Event]()
        rows, torque_usable = np.empty(len(t), dtype=bool), np.empty((len(t), n), dtype=bool)
        torque_usable.fill(True)
        values = np.concatenate((q, tau), axis=1)
        all_finite = isfinite(np.vdot(values, values))
        is_complete = [True] * len(t) if all_finite else [bool(row.all()) for row in np.isfinite(values)]
        for k, (time, x) in enumerate(zip(t.tolist(), values, strict=True)):
            sample_events = self._check_sample(time, x, all_there=is_complete[k])
            rows[k] = is_complete[k] and not self.dead
            # the torque of a joint may fail alone: its other columns can still be used
            if self.faulty and not self.dead:
                is_finite, torque_usable[k] = np.isfinite(x), self.fault[n:] == 0
                rows[k] = is_finite[:n].all() and is_finite[n:][torque_usable[k]].all()
            if sample_events:
                events += sample_events
                failed = [fault for fault in sample_events if isinstance(fault, Fault)]
                faults = [fault for fault in failed if fault.signal is Signal.POSITION]
                cuts += [k] if faults else []
                # whoever has the torques may excuse the position: stop here, so that the later samples are judged with
                # that
                if any(fault.kind is FaultKind.STILL for fault in faults):
                    return SensorCheck(rows[: k + 1], torque_usable[: k + 1], tuple(cuts), tuple(events))
        is_plain = all_finite and not events and not self.faulty
        return SensorCheck(rows, torque_usable, tuple(cuts), tuple(events), is_plain)

    @property
    def doubtful_since(self) -> float:
        """Time (s) since which values do not change that may still turn out to be a fault; infinite without such."""
        if not self.held:
            return inf
        is_held = (self.run > 0) & (self.alive > 0) & (self.fault == 0) & (self.excused == 0)
        return float(self.since[is_held].min(initial=inf))

    def excuse(self, joint: str) -> None:
        """Take back that a position is still: the joint rests."""
        k = self.joints.index(joint)
        self.fault[k], self.excused[k] = 0.0, 1.0
        self._note()

    def forget(self) -> None:
        """Take the next sample as the first after a gap: the samples before say nothing about its step."""
        self.run[:], self.jumped[:], self.t = 0.0, 0.0, np.nan
        self.held = self.leaps = False

    def _check_sample(self, t: float, x: Array, *, all_there: bool) -> list[Event]:
        events = list[Event]()
        if not all_there or self.gone:
            is_finite = np.isfinite(x)
            events += self._check_missing(t, is_finite)
            # a missing value keeps the last one, so that the other channels can be checked
            x = np.where(is_finite, x, np.nan_to_num(self.value))
        if self.t != self.t:  # the first after a gap
            self.value, self.step[:] = x, 0.0
            self.jumped_at = np.minimum(self.jumped_at, t)  # the clock may have been set back
        else:
            events += self._check_changes(t, x)
        if self.faulty:
            events += self._check_recovery(t)
        self.t, self.seen = t, self.seen + 1
        return events

    def _check_missing(self, t: float, is_finite: NDArray[np.bool_]) -> Iterator[Event]:
        self.lost = np.where((self.missed == 0) & ~is_finite, t, self.lost)
        self.missed = np.where(is_finite, 0.0, self.missed + 1)
        self.gone = not is_finite.all()
        is_missing = (self.missed >= MISSING_SAMPLES) & (self.fault != MISSING)
        yield from self._report_faults(t, is_missing, MISSING, self.lost)

    def _check_changes(self, t: float, x: Array) -> Iterator[Event]:
        n, d = len(self.joints), x - self.value
        is_same = d == 0
        if self.held or np.count_nonzero(is_same):
            self._update_runs(t, is_same, d)
        self._update_usual(d, is_same)
        size = np.abs(d[:n])
        if self.leaps or np.count_nonzero(size > self.least * (t - self.t)):
            yield from self._check_jumps(t, x, d, size)
        self.run = np.where(is_same, self.run + 1, 0.0) if self.held else self.run
        self.path += float(size.sum())
        if self.held and self.seen > SETTLING_SAMPLES and self.run.max() >= FROZEN_SAMPLES:
            yield from self._check_frozen(t)
        self.value, self.step = x, np.where(is_same, self.step, d) if self.held else d

    def _update_runs(self, t: float, is_same: NDArray[np.bool_], d: Array) -> None:
        """Note which values begin and end to be constant."""
        begins = is_same & (self.run == 0)
        if begins.any():
            usual = np.sqrt(self.bend)
            abrupt = np.divide(np.abs(self.step), usual, out=np.zeros_like(usual), where=usual > 0)
            self.abrupt = np.where(begins, abrupt, self.abrupt)
            self.since = np.where(begins, self.t, self.since)
            self.alive = np.maximum(self.alive, begins & (self.step != 0))
            self.path_then = np.where(begins, self.path, self.path_then)
        ends = ~is_same & (self.run > 0)
        if ends.any():
            # a pause counts as usual only where others moved meanwhile and it ended as from rest
            is_usual = ends & ((self.fault == 0) | (self.fault == STILL))
            is_usual &= self.path - self.path_then > MIN_OTHER_MOTION
            is_usual &= (np.abs(d) <= ABRUPT_STOP_RATIO * np.sqrt(self.bend)) | (np.arange(len(d)) >= len(self.joints))
            self.excused[ends] = 0.0
            self.longest = np.where(is_usual, np.maximum(self.longest, t - self.since), self.longest)
            self.run = np.where(ends, 0.0, self.run)
        self.held = bool(is_same.any())

    def _update_usual(self, d: Array, is_same: NDArray[np.bool_]) -> None:
        """Add a step to the usual ones; an outlier only counts as far as it would be usual."""
        step = d - self.step
        step *= step
        if self.seen > SETTLING_SAMPLES:
            # a sample that stands out counts as three usual deviations at most
            np.minimum(step, 9 * self.bend, out=step)
        step -= self.bend
        step /= min(self.seen + 1.0, AVERAGING_SAMPLES)
        self.bend = self.bend + (np.where(is_same & (self.run > 0), 0.0, step) if self.held else step)

    def _check_jumps(self, t: float, x: Array, d: Array, size: Array) -> Iterator[Event]:
        n = len(size)
        last = np.where(self.run[:n] > 0, self.since[:n], self.t) if self.held else self.t
        limit = np.where(self.limited, self.fastest * (t - last), MAX_STEP_FACTOR * self.pace)
        decayed_pace = self.pace * (1 - 1 / AVERAGING_SAMPLES)
        if not self.leaps and not np.count_nonzero(size > limit):  # as nearly always: no more is to be noted
            self.moved += size > 0
            self.pace = np.maximum(size, decayed_pace)
            return
        # fast motion is no jump, however small the limit of the file: the steps beside it are nearly the same
        is_sudden = np.abs(d[:n] - self.step[:n]) > ABRUPT_STOP_RATIO * np.sqrt(self.bend[:n])
        # the samples since a suspected jump are counted: a spike returns, a jump stays
        samples_since, self.jumped = self.jumped, np.where(self.jumped > 0, self.jumped + 1, 0.0)
        for k in np.flatnonzero(self.jumped == JUMP_SAMPLES).tolist():
            if abs(x[k] - self.left[k]) > abs(self.leap[k]) / 2:
                yield from self._report_jump(t, k)
        self.jumped[self.jumped >= JUMP_SAMPLES] = 0.0
        has_limit = self.limited | (self.moved > SETTLING_SAMPLES)
        new = (size > limit) & is_sudden & has_limit & (self.seen > SETTLING_SAMPLES) & (samples_since == 0)
        new &= (self.fault[:n] == 0) | (self.fault[:n] == 4)
        # a jump needs a known limit, a settled channel, and none under way
        self.jumped[new] = 1.0
        self.left, self.left_at = np.where(new, self.value[:n], self.left), np.where(new, t, self.left_at)
        self.leap, self.leaps = np.where(new, d[:n], self.leap), bool(self.jumped.any())
        usual = np.where(has_limit, np.minimum(size, limit), size)
        self.moved += size > 0
        self.pace = np.maximum(np.where(samples_since > 0, 0.0, usual), decayed_pace)

    def _report_jump(self, t: float, k: int) -> Iterator[Event]:
        """Yield the jump of a position; of many in a row that it jumps again and again, once."""
        since = float(self.left_at[k])
        self.jumps[k] = self.jumps[k] + 1 if since - self.jumped_at[k] < JUMP_PAUSE else 1
        self.jumped_at[k] = since
        if self.jumps[k] <= MAX_JUMPS:
            yield Fault(t, FaultKind.JUMP, Signal.POSITION, self.joints[k], since, float(self.leap[k]))
        elif self.fault[k] == 0:
            yield from self._report_faults(t, np.arange(len(self.fault)) == k, JUMPING, self.left_at)

    def _check_frozen(self, t: float) -> Iterator[Event]:
        n, hold_time = len(self.joints), t - self.since
        position = np.arange(2 * n) < n
        is_long = self.run >= FROZEN_SAMPLES
        others_moved = self.path - self.path_then > MIN_OTHER_MOTION
        # a position froze: it stopped within one sample from full speed
        stopped_abruptly = position & is_long & (hold_time >= FROZEN_TIME) & (self.abrupt > ABRUPT_STOP_RATIO)
        others_moved &= self.alive > 0
        # what was long before without a fault is usual for this channel
        usual = np.where(position, POSITION_HOLD_FACTOR, TORQUE_HOLD_FACTOR) * self.longest
        shortest = np.where(position, CONSTANT_POSITION_TIME, CONSTANT_TORQUE_TIME)
        is_held = is_long & others_moved & (hold_time >= np.clip(usual, shortest, MAX_HOLD_TIME))
        is_still = position & is_held & (self.excused == 0)
        is_frozen = (stopped_abruptly | (~position & is_held)) & (self.fault == 0)
        yield from self._report_faults(t, is_frozen, FROZEN, self.since)
        yield from self._report_faults(t, is_still & (self.fault == 0), STILL, self.since)

    def _report_faults(self, t: float, which: NDArray[np.bool_], kind: int, since: Array) -> Iterator[Event]:
        for k in np.flatnonzero(which).tolist():
            self.fault[k], self.began[k], self.well[k] = kind, since[k], 0.0
            yield Fault(t, FAULT_KINDS[kind - 1], *self._channel(k), float(since[k]))
        self._note()

    def _check_recovery(self, t: float) -> Iterator[Event]:
        # the value changes again and has been a number for some samples
        works = (self.missed == 0) & ((self.run == 0) | (self.fault == MISSING))
        works &= (self.fault != JUMPING) | (t - self.jumped_at >= JUMP_PAUSE)
        self.well = np.where(self.fault > 0, np.where(works, self.well + 1, 0.0), 0.0)
        for k in np.flatnonzero((self.well >= RECOVERY_SAMPLES) | (works & (self.fault == STILL))).tolist():
            yield Back(t, *self._channel(k), float(self.began[k]))
            self.fault[k] = self.well[k] = self.run[k] = 0.0
        self._note()

    def _note(self) -> None:
        self.faulty = bool(self.fault.any())
        self.dead = bool(self.fault[: len(self.joints)].any())

    def _channel(self, k: int) -> tuple[Signal, str]:
        n = len(self.joints)
        return (Signal.POSITION if k < n else Signal.TORQUE), self.joints[k % n]
