"""A robot that is watched: samples in, what there is to say out."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.errors import ConfigError, InputError
from dynident.identification import Identification
from dynident.log import Log
from dynident.online.candidates import Candidates
from dynident.online.detector import Detector, Knowledge
from dynident.online.events import Back, ClockReset, Event, Fault, FaultKind, Gap, Resting, Signal, Unreadable
from dynident.online.evidence import threshold
from dynident.online.scores import Gram, Scorer
from dynident.online.sensors import Sensors
from dynident.online.tracker import Block, Tracker, smoothing_of
from dynident.regression import Group, GroupKind, groups_of

__all__ = ["WatchSettings", "Watcher"]

Array = NDArray[np.float64]
Part = tuple[Gram, float, float, int]
FIRST = 10.0  # s of motion that show how much is to be smoothed
LAG = 12.0  # bandwidths: exp(-12 / sqrt 2) = 2e-4 is left of the error at a cut
EVERY = 0.5  # s of samples that are smoothed together
SLOWEST = 0.01  # rad/s, m/s: below, Coulomb friction has no known sign
MOVING = 0.2  # share of a block's rows in which joints move: with less, it says nothing
BACK = 10  # samples in a row of an earlier time: the clock was set back
BREAK = 1.0  # s without a sample that are said
GAP = 12.0  # usual steps: a longer one ends a motion
PUSHED = 256  # samples that are looked at together
RESTS = 300.0  # s without a block of motion that are said
SMEAR = 0.5  # s beside a torque that cannot be used, by filters


@dataclass(frozen=True)
class WatchSettings:
    """How a robot is watched: ``false_alarms`` a day, blocks of ``block`` s, a ``baseline`` of s, ``settle`` s after an
    alarm that show what has changed.

    ``tolerance``: changes of the torque by this share of the noise are none. Raises ConfigError for a value out of its
    range.
    """

    false_alarms: float = 0.03
    block: float = 5.0
    baseline: float = 600.0
    settle: float = 30.0
    tolerance: float = 0.05

    def __post_init__(self) -> None:
        ranges = {"false_alarms": (1e-6, 1e3), "block": (0.5, 600.0), "tolerance": (0.0, 10.0)}
        ranges |= {"baseline": (20 * self.block, 1e6), "settle": (2 * self.block, 1e5)}
        for name, (low, high) in ranges.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise ConfigError(f"watch: {name} is {value:g}; give a number from {low:g} to {high:g}.")


class Watcher:
    """Watches a robot by the result of its identification: ``push`` takes samples and returns what there is to say.

    ``rng`` draws what the threshold is computed from. ``position`` and ``torque`` in SI, joints as in the model. Memory
    is constant. Raises ConfigError where the result cannot be used: no groups, no spline.
    """

    def __init__(self, found: Identification, rng: np.random.Generator, settings: WatchSettings | None = None) -> None:
        self.settings = how = settings or WatchSettings()
        model = found.model
        self.joints = tuple(joint.name for joint in model.joints)
        speeds = found.recipe.min_speeds(self.joints) or (0.0,) * len(self.joints)
        least = {name: max(v, SLOWEST) for name, v in zip(self.joints, speeds, strict=True)}
        self._found = replace(found, recipe=replace(found.recipe, min_speed=least))
        self._scorer = Scorer.of(found)
        candidates = Candidates(self._groups(), self._scorer.scale, how.tolerance)
        blocks, settle = (max(2, round(x / how.block)) for x in (how.baseline, how.settle))
        dof = max(blocks / 2.0, 4.0)
        self.threshold = threshold(how.false_alarms, how.block, candidates.ranks, dof, rng, blocks)
        sigma = self._scorer.sigma
        self._detector = Detector(candidates, blocks, settle, self.threshold.evidence, sigma)
        limits = [model.limits.get(name) for name in self.joints]
        self._sensors = Sensors(self.joints, [None if one is None else one.velocity or None for one in limits])
        self._made(0.01, np.full(len(self.joints), 0.05))  # a result that cannot be followed is said now
        self._tracker: Tracker | None = None
        self._smoothing: tuple[float, Array] | None = None
        self._known: Knowledge = self._detector.start()
        self._held = self._empty()  # samples of the first seconds
        self._gram, self._span = self._scorer.nothing, (math.nan, math.nan, 0)
        self._waiting = tuple[Part, ...]()  # complete blocks of which a sensor may still be doubted
        self._deaf = dict[int, tuple[float, float]]()  # by joint the times (s) of torques that cannot be used
        self._moved = math.nan  # when it moved last, infinite once it was said that it does not
        self._refused = ""  # what was unreadable
        self._last, self._step, self._back, self._replay = math.nan, math.nan, 0, False

    @property
    def knowledge(self) -> Knowledge:
        """What is known so far."""
        return self._known

    @property
    def baseline_blocks(self) -> tuple[int, int]:
        """How many blocks of the baseline there are so far, and how many it takes."""
        need = self._detector.baseline
        return (need if self._known.reference is not None else len(self._known.blocks)), need

    @property
    def groups(self) -> tuple[Group, ...]:
        """What may change."""
        return self._detector.candidates.groups

    @property
    def latest(self) -> float:
        """The stamp (s) of the last sample, nan before the first."""
        return self._last

    def push(self, t: ArrayLike, q: ArrayLike, tau: ArrayLike) -> tuple[Event, ...]:
        """Take samples, t (N) s, q and tau (N, n), nan where there is no number, and return what there is to say.

        It does not depend on how many are given at a time, but for when it is said. Raises InputError for shapes that
        do not fit.
        """
        time, x, y = (np.asarray(one, dtype=float) for one in (t, q, tau))
        if x.shape != (len(time), len(self.joints)) or y.shape != x.shape:
            raise InputError(f"samples: {time.shape} stamps, {x.shape} positions, {y.shape} torques do not match.")
        events = list[Event]()
        for k in range(0, len(time), PUSHED):
            some = slice(k, k + PUSHED)
            events += self._ordered(time[some], x[some], y[some])
        return tuple(events)

    def resume_by_replay(self) -> None:
        """Skip what was seen before: samples come again from an earlier one on."""
        self._replay = True

    def _ordered(self, t: Array, q: Array, tau: Array) -> list[Event]:
        """Take samples in the order of time; cut the motion at gaps, and where the clock was set back."""
        events, start = list[Event](), 0
        keep = np.ones(len(t), dtype=bool)
        for k, at in enumerate(t.tolist()):
            step = at - self._last
            if step <= 0:
                self._back += not self._replay and step < 0
                if self._back < BACK:
                    keep[k] = False
                    continue
            if self._back >= BACK or step > GAP * self._step:
                events += self._checked(
                    t[start:k][keep[start:k]], q[start:k][keep[start:k]], tau[start:k][keep[start:k]]
                )
                if self._back >= BACK:
                    events.append(ClockReset(at, self._last))
                elif step > BREAK:
                    events.append(Gap(at, step))
                self._cut(used=self._back < BACK)
                self._sensors.forget()
                events += self._released()
                self._moved = at
                if self._back >= BACK:
                    self._deaf = {j: (-math.inf, stop) for j, (_, stop) in self._deaf.items() if stop == math.inf}
                if self._back >= BACK and self._smoothing is not None:
                    self._tracker = self._made(*self._smoothing)  # its stamps may only increase
                start = k
            elif not math.isnan(step):
                self._step = step if math.isnan(self._step) else self._step + 0.01 * (step - self._step)
            self._last, self._back, self._replay = at, 0, False
        keep = keep[start:]
        return events + self._checked(t[start:][keep], q[start:][keep], tau[start:][keep])

    def _checked(self, t: Array, q: Array, tau: Array) -> list[Event]:
        """Take samples between which there is no gap, without those of sensors that fail."""
        events = list[Event]()
        if math.isnan(self._moved) and len(t):
            self._moved = float(t[0])
        while len(t):
            found = self._sensors.check(t, q, tau)
            n, start, heard = len(found.rows), 0, np.where(found.heard, tau[: len(found.rows)], 0.0)
            said = list(found.events)
            for cut in (*found.cuts, n):
                rows = start + np.flatnonzero(found.rows[start:cut])
                events += self._motion(t[rows], q[rows], heard[rows])
                for one in [one for one in said if cut < n and one.time == t[cut] and isinstance(one, Fault)]:
                    if one.signal is Signal.POSITION and not self._doubted(one):
                        said.remove(one)
                start = cut
            self._hear(said)
            events += [*said, *self._released()]
            t, q, tau = t[n:], q[n:], tau[n:]
        return sorted([*events, *self._rests()], key=lambda one: one.time)

    def _doubted(self, fault: Fault) -> bool:
        """Drop what a failed position may have spoiled; return False where torques show that the joint only rests."""
        spoiled = [one for one in self._waiting if one[2] > fault.since]
        if fault.kind is FaultKind.STILL:
            gram = sum((one[0] for one in spoiled), self._gram)
            samples = self._span[2] + sum(one[3] for one in spoiled)
            whole = self._scorer.scores(gram, fault.since, fault.time, samples)
            if not self._detector.differs(self._known, whole):
                self._sensors.excuse(fault.joint)
                return False
        self._waiting = self._waiting[: len(self._waiting) - len(spoiled)]
        self._cut(used=False)
        return True

    def _hear(self, events: list[Event]) -> None:
        """Note from when to when the torques of joints cannot be used, and when positions can be used again."""
        for one in events:
            if not isinstance(one, Fault | Back):
                continue
            if one.signal is Signal.POSITION:
                self._moved = one.time
            else:
                stop = math.inf if isinstance(one, Fault) else one.time
                self._deaf[self.joints.index(one.joint)] = (one.since, stop)

    def _released(self) -> list[Event]:
        """Give the blocks to the detector of which no sensor is doubted."""
        events, sure = list[Event](), self._sensors.doubtful
        while self._waiting and self._waiting[0][2] <= sure:
            (gram, start, stop, samples), *rest = self._waiting
            self._waiting = tuple(rest)
            for j, (since, until) in self._deaf.items():
                if since - SMEAR < stop and start < until + SMEAR:
                    gram = gram.without(j)
            if gram.rows.max() < MOVING * samples:
                continue
            self._moved = stop
            self._known, found = self._detector.step(self._known, self._scorer.scores(gram, start, stop, samples))
            events += found
        return events

    def _rests(self) -> list[Event]:
        """Say once of a rest that it is long."""
        if self._sensors.dead or self._last - self._moved < RESTS:
            return []
        since, self._moved = self._moved, math.inf
        return [Resting(since + RESTS, since)]

    def _motion(self, t: Array, q: Array, tau: Array) -> list[Event]:
        """Smooth samples, and reduce what is final to blocks."""
        if not len(t):
            return []
        if self._tracker is not None:
            self._scored(self._tracker.push(t, q, tau))
            return []
        first = float(self._held[0][0]) if len(self._held[0]) else float(t[0])
        enough = int(np.searchsorted(t, first + FIRST)) + 1  # whatever comes at a time
        held, rest = ([x[:enough] for x in (t, q, tau)], [x[enough:] for x in (t, q, tau)])
        self._held = tuple(np.concatenate(pair) for pair in zip(self._held, held, strict=True))
        if len(t) < enough:
            return []
        return self._begin() + self._motion(*rest)

    def _begin(self) -> list[Event]:
        """Find out from the first seconds how much to smooth; wait for more where no joint moves in them."""
        (t, q, tau), self._held = self._held, self._empty()
        try:
            log = Log(t, q, tau, self.joints, "the first seconds of the stream")
            self._smoothing = smoothing_of(self._found, log)
        except (ConfigError, InputError) as error:
            before, self._refused = self._refused, str(error)
            return [] if before == str(error) else [Unreadable(float(t[-1]), len(t), str(error))]
        self._tracker = self._made(*self._smoothing)
        self._scored(self._tracker.push(t, q, tau))
        return []

    def _made(self, step: float, bandwidth: Array) -> Tracker:
        lag = LAG * float(bandwidth.max()) + 2 * step
        return Tracker(self._found, step, bandwidth, lag, every=max(2, round(EVERY / step)))

    def _scored(self, blocks: tuple[Block, ...]) -> None:
        """Add to the block that was begun, and to those that wait when it is complete."""
        for one in blocks:
            gram, t = self._scorer.gram(one.entries), one.motion.t
            start, _, samples = self._span
            begin = float(t[0]) if math.isnan(start) else start
            self._gram, self._span = self._gram + gram, (begin, float(t[-1]), samples + int(one.motion.mask.sum()))
            if t[-1] - begin >= self.settings.block - EVERY / 2:
                if self._span[2]:
                    self._waiting = (*self._waiting, (self._gram, *self._span))
                self._gram, self._span = self._scorer.nothing, (math.nan, math.nan, 0)

    def _cut(self, *, used: bool) -> None:
        """End a motion; what is left of it is ``used``, or dropped together with the block that was begun."""
        blocks = () if self._tracker is None else self._tracker.finish()
        if self._tracker is None:
            self._held = self._empty()
        if used:
            self._scored(blocks)
        else:
            self._gram, self._span = self._scorer.nothing, (math.nan, math.nan, 0)

    def _groups(self) -> tuple[Group, ...]:
        """Return what may change: groups of base parameters, and what is left of each joint."""
        n, unit = len(self.joints), ("",)
        rest = (
            Group(GroupKind.RESIDUAL, joint, np.eye(n)[:, [j]], (f"residual of {joint}",), unit)
            for j, joint in enumerate(self.joints)
        )
        return (*groups_of(self._found.model, self._scorer.basis), *rest)

    def _empty(self) -> tuple[Array, ...]:
        n = len(self.joints)
        return np.zeros(0), np.zeros((0, n)), np.zeros((0, n))

    @property
    def state(self) -> dict[str, Any]:
        """All that it knows: arrays, numbers, and nouns of this package by name; ``restore`` takes them again."""
        return {
            "known": self._known, "gram": self._gram, "span": self._span, "held": self._held,
            "smoothing": self._smoothing, "threshold": self.threshold,
            "tracker": None if self._tracker is None else self._tracker.state, "sensors": self._sensors.state,
            "waiting": self._waiting, "rest": (self._moved, self._refused),
            "deaf": [(j, *one) for j, one in self._deaf.items()],
            "clock": (self._last, self._step, self._back, self._replay),
        }  # fmt: skip

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from a saved state of a watcher of the same result and settings."""
        self._known, self._gram, self._span = state["known"], state["gram"], tuple(state["span"])
        self._held, self._smoothing, self.threshold = tuple(state["held"]), state["smoothing"], state["threshold"]
        self._detector = replace(self._detector, threshold=self.threshold.evidence)
        self._sensors.restore(state["sensors"])
        self._last, self._step, self._back, self._replay = state["clock"]
        self._waiting, (self._moved, self._refused) = tuple(state["waiting"]), state["rest"]
        self._deaf = {j: (since, until) for j, since, until in state["deaf"]}
        if self._smoothing is not None:
            self._tracker = self._made(*self._smoothing)
            self._tracker.restore(state["tracker"])
