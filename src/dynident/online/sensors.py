"""Sensors that fail, seen at once: no numbers, values that freeze, jumps.

A position that froze stops within one sample, which no joint can do: its last step is many times as large as steps
usually differ from one to the next. What comes to rest does not. A joint may rest while others move, so that a position
that just does not change is only said, and the watch goes on.
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
LONGER = 10.0  # times the longest that was usual before
RECOVERED = 10  # samples that a sensor must work again
FASTEST = 2.0  # times the velocity limit
LARGEST = 20.0  # times the largest usual step, where there is no limit
CONFIRMED = 4  # samples after which a jump is no spike
FAR = 0.01  # rad, m: what others move at least while one does not
MEMORY = 500.0  # samples over which what is usual is averaged
SETTLED = 50  # samples until something is usual
KINDS = (FaultKind.MISSING, FaultKind.FROZEN, FaultKind.STILL)
LOST = (1, 2)  # of them, by number from one: those without which nothing can be computed


@dataclass(frozen=True)
class Checked:
    """What of N samples can be used, ``rows`` (N), and what there is to say.

    ``cuts`` are the rows at which a motion ends: what was not yet used of it is to go.
    """

    rows: NDArray[np.bool_]
    cuts: tuple[int, ...]
    events: tuple[Event, ...]


class Sensors:
    """Looks at 2 n channels, the positions and torques of ``joints``, of which ``velocity`` has the limits (rad/s, m/s;
    None where they are not known)."""

    def __init__(self, joints: Sequence[str], velocity: Sequence[float | None]) -> None:
        self.joints = tuple(joints)
        self.fastest = np.array([np.inf if v is None else FASTEST * v for v in velocity])
        n = 2 * len(self.joints)
        self.seen, self.t, self.path = 0, np.nan, 0.0  # samples, the last stamp, what all positions have moved
        self.value, self.step = np.full(n, np.nan), np.zeros(n)
        self.bend, self.pace = np.zeros(n), np.zeros(n)  # mean square difference of steps, usual largest step
        self.run, self.since, self.path_then = np.zeros(n), np.zeros(n), np.zeros(n)  # samples without a change
        self.abrupt, self.longest = np.zeros(n), np.zeros(n)  # how it stopped; s without a change that are usual
        self.missed, self.lost = np.zeros(n), np.zeros(n)  # samples in a row without a number, since when
        self.fault, self.began, self.well = np.zeros(n), np.zeros(n), np.zeros(n)  # 1 + number of the kind
        self.jumped, self.leap = np.zeros(n), np.zeros(n)  # samples since what may be a jump, its size
        self.left, self.left_at = np.zeros(n), np.zeros(n)  # the value before it, and when

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
        return {name: value for name, value in vars(self).items() if name not in ("joints", "fastest")}

    def check(self, t: Array, q: Array, tau: Array) -> Checked:
        """Look at samples: t (N) s, increasing; q and tau (N, n), nan where there is no number."""
        rows, cuts, events = np.zeros(len(t), dtype=bool), list[int](), list[Event]()
        values = np.concatenate([q, tau], axis=1)
        for k, (at, x) in enumerate(zip(t.tolist(), values, strict=True)):
            found = tuple(self._sample(at, x))
            events += found
            rows[k] = not np.isin(self.fault, LOST).any() and not self.missed.any()
            if any(isinstance(one, Fault) and one.kind is not FaultKind.STILL for one in found):
                cuts.append(k)
        return Checked(rows, tuple(cuts), tuple(events))

    def forget(self) -> None:
        """Take the next sample as the first after a gap: what came before says nothing of its steps."""
        self.run[:], self.jumped[:], self.t = 0.0, 0.0, np.nan

    def _sample(self, t: float, x: Array) -> Iterator[Event]:
        there = np.isfinite(x)
        yield from self._missing(t, there)
        if np.isnan(self.t):
            self.value, self.step[:] = np.where(there, x, self.value), 0.0
        else:
            yield from self._changes(t, np.where(there, x, self.value), there)
        yield from self._recovered(t, there)
        self.t, self.seen = t, self.seen + 1

    def _missing(self, t: float, there: NDArray[np.bool_]) -> Iterator[Event]:
        if there.all() and not self.missed.any():
            return
        self.lost = np.where((self.missed == 0) & ~there, t, self.lost)
        self.missed = np.where(there, 0.0, self.missed + 1)
        yield from self._failed(t, (self.missed >= MISSED) & (self.fault != 1), 1, self.lost)

    def _changes(self, t: float, x: Array, there: NDArray[np.bool_]) -> Iterator[Event]:
        n, d = len(self.joints), x - self.value
        same = (d == 0) & there
        begins = same & (self.run == 0)
        if begins.any():
            usual = np.sqrt(self.bend)
            abrupt = np.divide(np.abs(self.step), usual, out=np.zeros_like(usual), where=usual > 0)
            self.abrupt = np.where(begins, abrupt, self.abrupt)
            self.since = np.where(begins, self.t, self.since)
            self.path_then = np.where(begins, self.path, self.path_then)
        ends = ~same & (self.run > 0) & (self.fault == 0)
        self.longest = np.where(ends, np.maximum(self.longest, t - self.since), self.longest)
        self._usual(d, same)
        yield from self._jumps(t, x, d)
        self.run = np.where(same, self.run + 1, 0.0)
        self.path += float(np.abs(d[:n]).sum())
        if (self.run >= HELD).any() and self.seen > SETTLED:
            yield from self._frozen(t)
        self.value, self.step = x, np.where(same, self.step, d)

    def _usual(self, d: Array, same: NDArray[np.bool_]) -> None:
        """Add a step to what is usual; of what stands out only as much as would be usual."""
        square = (d - self.step) ** 2
        if self.seen > SETTLED:
            square = np.minimum(square, 9 * self.bend)
        share = 1 / min(self.seen + 1.0, MEMORY)
        self.bend = np.where(same & (self.run > 0), self.bend, self.bend + share * (square - self.bend))

    def _jumps(self, t: float, x: Array, d: Array) -> Iterator[Event]:
        n, late = len(self.joints), self.jumped
        own, size = slice(0, n), np.abs(d)
        last = np.where(self.run[own] > 0, self.since[own], self.t)
        limit = np.where(np.isfinite(self.fastest), self.fastest * (t - last), LARGEST * self.pace[own])
        limit = np.maximum(limit, ABRUPT * np.sqrt(self.bend[own]))
        new = (size[own] > limit) & (self.seen > SETTLED) & (late[own] == 0) & (self.fault[own] == 0)
        usual = np.where(late > 0, 0.0, np.minimum(size, np.append(limit, size[n:])))
        self.pace = np.maximum(usual, self.pace * (1 - 1 / MEMORY))
        if new.any():
            which = np.append(new, np.zeros(n, dtype=bool))
            self.left, self.left_at = np.where(which, self.value, self.left), np.where(which, t, self.left_at)
            self.leap = np.where(which, d, self.leap)
            self.jumped = np.where(which, 1.0, late)
        elif late.any():
            self.jumped = np.where(late > 0, late + 1, 0.0)
            for k in np.flatnonzero(self.jumped == CONFIRMED):
                if abs(x[k] - self.left[k]) > limit[k] / 2:
                    at, size = float(self.left_at[k]), float(self.leap[k])
                    yield Fault(t, FaultKind.JUMP, Signal.POSITION, self.joints[k], at, size)
            self.jumped = np.where(self.jumped >= CONFIRMED, 0.0, self.jumped)

    def _frozen(self, t: float) -> Iterator[Event]:
        n, held = len(self.joints), t - self.since
        position = np.arange(2 * n) < n
        long = self.run >= HELD
        moved = self.path - self.path_then > FAR
        stopped = position & long & (held >= HELD_FOR) & (self.abrupt > ABRUPT)
        silent = ~position & long & moved & (held >= np.maximum(SILENT, LONGER * self.longest))
        still = position & long & moved & (held >= np.maximum(STILL, LONGER * self.longest))
        yield from self._failed(t, (stopped | silent) & ~np.isin(self.fault, LOST), 2, self.since)
        yield from self._failed(t, still & (self.fault == 0), 3, self.since)

    def _failed(self, t: float, which: NDArray[np.bool_], kind: int, since: Array) -> Iterator[Event]:
        for k in np.flatnonzero(which):
            self.fault[k], self.began[k], self.well[k] = kind, since[k], 0.0
            yield Fault(t, KINDS[kind - 1], *self._channel(k), float(since[k]))

    def _recovered(self, t: float, there: NDArray[np.bool_]) -> Iterator[Event]:
        if not self.fault.any():
            return
        works = there & ((self.run == 0) | (self.fault == 1))
        self.well = np.where(self.fault > 0, np.where(works, self.well + 1, 0.0), 0.0)
        for k in np.flatnonzero((self.well >= RECOVERED) | (works & (self.fault == 3))):
            yield Back(t, *self._channel(k), float(self.began[k]))
            self.fault[k] = self.well[k] = self.run[k] = 0.0

    def _channel(self, k: int) -> tuple[Signal, str]:
        n = len(self.joints)
        return (Signal.POSITION if k < n else Signal.TORQUE), self.joints[k % n]
