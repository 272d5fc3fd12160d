"""Sensors that fail, seen at once: no numbers, values that freeze, jumps.

A position that froze stops within one sample, which no joint can do: its last step is many times as large as steps
usually differ from one to the next. What comes to rest does not. Where it froze near a turn, only the torques of the
arm can tell it from a rest: it is said to be still when that lasts longer than usual while others move, and who has the
torques may ``excuse`` it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.online.events import Back, Event, Fault, FaultKind, Signal

__all__ = ["Checked", "Sensors"]

Array = NDArray[np.float64]
MISSED = 3  # samples in a row without a number
HELD, HELD_FOR = 10, 0.05  # samples, and s, of a position that froze
ABRUPT = 8.0  # times the usual difference of two steps: what a joint cannot do
SILENT = 1.0  # s of a torque that does not change while the robot moves
STILL = 5.0  # s of a position that does not change while others do
LONGER = 10.0  # times the longest that was usual before, of a torque
RATHER = 2.0  # times the longest that was usual before, of a position
MOST = 60.0  # s: what is usual asks for no more
RECOVERED = 10  # samples that a sensor must work again
FASTEST = 2.0  # times the velocity limit
LARGEST = 20.0  # times the largest usual step, where there is no limit
CONFIRMED = 4  # samples after which a jump is no spike
FAR = 0.01  # rad, m: what others move at least while one does not
MEMORY = 500.0  # samples over which what is usual is averaged
SETTLED = 50  # samples until something is usual
KINDS = (FaultKind.MISSING, FaultKind.FROZEN, FaultKind.STILL)
LOST = (1, 2, 3)  # of them, by number from one: those without which a sensor says nothing


@dataclass(frozen=True)
class Checked:
    """What of the first N samples can be used, ``rows`` (N), by joint with its torque ``heard`` (N, n), and what there
    is to say. The N-th is the last one, or one where a position is said to be still.

    ``cuts`` are the rows at which a motion ends: what was not yet used of it is to go.
    """

    rows: NDArray[np.bool_]
    heard: NDArray[np.bool_]
    cuts: tuple[int, ...]
    events: tuple[Event, ...]


class Sensors:
    """Looks at 2 n channels, the positions and torques of ``joints``, of which ``velocity`` has the limits (rad/s, m/s;
    None where they are not known)."""

    def __init__(self, joints: Sequence[str], velocity: Sequence[float | None]) -> None:
        self.joints = tuple(joints)
        self.fastest = np.array([np.inf if v is None else FASTEST * v for v in velocity])
        self.least = np.where(np.isfinite(self.fastest), self.fastest, 0.0)
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
        self.alive = np.zeros(n)  # whether it has ever changed: a channel that is not recorded does not die
        self.excused = np.zeros(n)  # whether it is known to rest, until it changes
        self.moved = np.zeros(m)  # samples in which it moved
        self.gone = self.held = self.leaps = self.faulty = self.dead = False  # whether any of these is

    @property
    def state(self) -> dict[str, Array]:
        """All that it knows, as arrays."""
        return {name: np.array(value, dtype=float) for name, value in self._known().items()}

    def restore(self, state: Mapping[str, Array]) -> None:
        """Continue from a saved state."""
        for name, value in self._known().items():
            saved = np.array(state[name], dtype=float)
            setattr(self, name, saved if isinstance(value, np.ndarray) else type(value)(saved))

    def _known(self) -> dict[str, Array | float | int]:
        return {name: value for name, value in vars(self).items() if name not in ("joints", "fastest", "least")}

    def check(self, t: Array, q: Array, tau: Array) -> Checked:
        """Look at samples: t (N) s, increasing; q and tau (N, n), nan where there is no number."""
        n, cuts, events = len(self.joints), list[int](), list[Event]()
        rows, heard = np.zeros(len(t), dtype=bool), np.ones((len(t), n), dtype=bool)
        values = np.concatenate([q, tau], axis=1)
        number = np.isfinite(values)
        there = number.all(axis=1)
        for k, (at, x) in enumerate(zip(t.tolist(), values, strict=True)):
            found = self._sample(at, x, all_there=bool(there[k]))
            rows[k] = there[k] and not self.dead
            if self.faulty and not self.dead:
                heard[k] = ~np.isin(self.fault[n:], LOST)
                rows[k] = number[k, :n].all() and number[k, n:][heard[k]].all()
            if found:
                events += found
                faults = [one for one in found if isinstance(one, Fault) and one.signal is Signal.POSITION]
                cuts += [k] if faults else []
                if any(one.kind is FaultKind.STILL for one in faults):
                    return Checked(rows[: k + 1], heard[: k + 1], tuple(cuts), tuple(events))
        return Checked(rows, heard, tuple(cuts), tuple(events))

    @property
    def doubtful(self) -> float:
        """The time (s) since which values do not change of which a fault may still be said; infinite without such."""
        held = (self.run > 0) & (self.alive > 0) & (self.fault == 0) & (self.excused == 0)
        return float(self.since[held].min(initial=np.inf))

    def excuse(self, joint: str) -> None:
        """Take back that a position is still: the joint rests."""
        k = self.joints.index(joint)
        self.fault[k], self.excused[k] = 0.0, 1.0
        self._note()

    def forget(self) -> None:
        """Take the next sample as the first after a gap: what came before says nothing of its steps."""
        self.run[:], self.jumped[:], self.t = 0.0, 0.0, np.nan
        self.held = self.leaps = False

    def _sample(self, t: float, x: Array, *, all_there: bool) -> list[Event]:
        events = list[Event]()
        if not all_there or self.gone:
            there = np.isfinite(x)
            events += self._missing(t, there)
            x = np.where(there, x, np.nan_to_num(self.value))
        if self.t != self.t:  # the first after a gap
            self.value, self.step[:] = x, 0.0
        else:
            events += self._changes(t, x)
        if self.faulty:
            events += self._recovered(t)
        self.t, self.seen = t, self.seen + 1
        return events

    def _missing(self, t: float, there: NDArray[np.bool_]) -> Iterator[Event]:
        self.lost = np.where((self.missed == 0) & ~there, t, self.lost)
        self.missed = np.where(there, 0.0, self.missed + 1)
        self.gone = not there.all()
        yield from self._failed(t, (self.missed >= MISSED) & (self.fault != 1), 1, self.lost)

    def _changes(self, t: float, x: Array) -> Iterator[Event]:
        n, d = len(self.joints), x - self.value
        same = d == 0
        if same.any() or self.held:
            self._runs(t, same, d)
        self._usual(d, same)
        size = np.abs(d[:n])
        if self.leaps or (size > self.least * (t - self.t)).any():
            yield from self._jumps(t, x, d)
        self.run = np.where(same, self.run + 1, 0.0) if self.held else self.run
        self.path += float(size.sum())
        if self.held and self.seen > SETTLED and self.run.max() >= HELD:
            yield from self._frozen(t)
        self.value, self.step = x, np.where(same, self.step, d) if self.held else d

    def _runs(self, t: float, same: NDArray[np.bool_], d: Array) -> None:
        """Note which values begin and end not to change."""
        begins = same & (self.run == 0)
        if begins.any():
            usual = np.sqrt(self.bend)
            abrupt = np.divide(np.abs(self.step), usual, out=np.zeros_like(usual), where=usual > 0)
            self.abrupt = np.where(begins, abrupt, self.abrupt)
            self.since = np.where(begins, self.t, self.since)
            self.alive = np.maximum(self.alive, begins & (self.step != 0))
            self.path_then = np.where(begins, self.path, self.path_then)
        ends = ~same & (self.run > 0)
        if ends.any():
            well = ends & ((self.fault == 0) | (self.fault == 3)) & (self.path - self.path_then > FAR)  # others moved
            well &= (np.abs(d) <= ABRUPT * np.sqrt(self.bend)) | (np.arange(len(d)) >= len(self.joints))  # from rest
            self.excused[ends] = 0.0
            self.longest = np.where(well, np.maximum(self.longest, t - self.since), self.longest)
            self.run = np.where(ends, 0.0, self.run)
        self.held = bool(same.any())

    def _usual(self, d: Array, same: NDArray[np.bool_]) -> None:
        """Add a step to what is usual; of what stands out only as much as would be usual."""
        square = (d - self.step) ** 2
        if self.seen > SETTLED:
            square = np.minimum(square, 9 * self.bend)
        step = (square - self.bend) / min(self.seen + 1.0, MEMORY)
        self.bend = self.bend + (np.where(same & (self.run > 0), 0.0, step) if self.held else step)

    def _jumps(self, t: float, x: Array, d: Array) -> Iterator[Event]:
        n, size = len(self.joints), np.abs(d[: len(self.joints)])
        last = np.where(self.run[:n] > 0, self.since[:n], self.t)
        limit = np.where(np.isfinite(self.fastest), self.fastest * (t - last), LARGEST * self.pace)
        limit = np.maximum(limit, ABRUPT * np.sqrt(self.bend[:n]))
        late, self.jumped = self.jumped, np.where(self.jumped > 0, self.jumped + 1, 0.0)
        for k in np.flatnonzero(self.jumped == CONFIRMED).tolist():
            if abs(x[k] - self.left[k]) > abs(self.leap[k]) / 2:
                at, leap = float(self.left_at[k]), float(self.leap[k])
                yield Fault(t, FaultKind.JUMP, Signal.POSITION, self.joints[k], at, leap)
        self.jumped[self.jumped >= CONFIRMED] = 0.0
        known = np.isfinite(self.fastest) | (self.moved > SETTLED)
        new = (size > limit) & known & (self.seen > SETTLED) & (late == 0) & (self.fault[:n] == 0)
        self.jumped[new] = 1.0
        self.left, self.left_at = np.where(new, self.value[:n], self.left), np.where(new, t, self.left_at)
        self.leap, self.leaps = np.where(new, d[:n], self.leap), bool(self.jumped.any())
        usual = np.where(known, np.minimum(size, limit), size)
        self.moved += size > 0
        self.pace = np.maximum(np.where(late > 0, 0.0, usual), self.pace * (1 - 1 / MEMORY))

    def _frozen(self, t: float) -> Iterator[Event]:
        n, held = len(self.joints), t - self.since
        position = np.arange(2 * n) < n
        long = self.run >= HELD
        moved = self.path - self.path_then > FAR
        stopped = position & long & (held >= HELD_FOR) & (self.abrupt > ABRUPT)
        moved &= self.alive > 0
        usual = np.where(position, RATHER, LONGER) * self.longest
        silent = ~position & long & moved & (held >= np.clip(usual, SILENT, MOST))
        still = position & long & moved & (self.excused == 0) & (held >= np.clip(usual, STILL, MOST))
        yield from self._failed(t, (stopped | silent) & ~np.isin(self.fault, LOST), 2, self.since)
        yield from self._failed(t, still & (self.fault == 0), 3, self.since)

    def _failed(self, t: float, which: NDArray[np.bool_], kind: int, since: Array) -> Iterator[Event]:
        for k in np.flatnonzero(which).tolist():
            self.fault[k], self.began[k], self.well[k] = kind, since[k], 0.0
            yield Fault(t, KINDS[kind - 1], *self._channel(k), float(since[k]))
        self._note()

    def _recovered(self, t: float) -> Iterator[Event]:
        works = (self.missed == 0) & ((self.run == 0) | (self.fault == 1))
        self.well = np.where(self.fault > 0, np.where(works, self.well + 1, 0.0), 0.0)
        for k in np.flatnonzero((self.well >= RECOVERED) | (works & (self.fault == 3))).tolist():
            yield Back(t, *self._channel(k), float(self.began[k]))
            self.fault[k] = self.well[k] = self.run[k] = 0.0
        self._note()

    def _note(self) -> None:
        self.faulty = bool(self.fault.any())
        self.dead = bool(np.isin(self.fault[: len(self.joints)], LOST).any())

    def _channel(self, k: int) -> tuple[Signal, str]:
        n = len(self.joints)
        return (Signal.POSITION if k < n else Signal.TORQUE), self.joints[k % n]
