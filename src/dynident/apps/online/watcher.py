"""Watch of a robot: samples in, events out."""

from __future__ import annotations

import math
from collections.abc import Generator, Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from dynident.apps.online.candidates import Candidates, threshold
from dynident.apps.online.detector import Detector, Knowledge
from dynident.apps.online.events import Back, ClockReset, Event, Fault, FaultKind, Gap, Resting, Signal, Unreadable
from dynident.apps.online.fixed_lag import StreamSmoothing
from dynident.apps.online.scores import Gram, Scorer
from dynident.apps.online.sensors import Sensors, possible_values
from dynident.apps.online.tracker import MotionBlock, Tracker, smoothing_steps
from dynident.identification import Identification
from dynident.motion.log import Log
from dynident.regression import GroupKind, ParameterGroup, groups_of, one_thread
from dynident.runtime import ConfigError, InputError, check_type
from dynident.runtime.arrays import Array, as_numbers

WaitingBlock = tuple[Gram, float, float, int]
SMOOTHING_TIME = 10.0  # s of motion that show how much is to be smoothed
LAG_BANDWIDTHS = 12.0  # bandwidths: exp(-12 / sqrt 2) = 2e-4 is left of the error at a cut
WINDOW_TIME = 0.5  # s of samples that are smoothed together
PORTION_TIME = 0.02  # s of samples after which a portion of the first seconds is worked off
MIN_SPEED = 0.01  # rad/s, m/s: below, Coulomb friction has no known sign
MIN_MOVING_SHARE = 0.2  # share of a block's rows in which joints move: with less, it says nothing
CLOCK_RESET_SAMPLES = 10  # samples in a row of an earlier time: the clock was set back
MAX_STEP_RATIO = 12.0  # usual steps: a longer one ends a motion
BATCH_SAMPLES = 256  # samples that are looked at together
MIN_REPORTED_GAP, MIN_REPORTED_REST = 1.0, 300.0  # s without a sample, or without a block of motion, that are said
EMPTY_SPAN = (math.nan, math.nan, 0)  # first and last time (s) and samples of a block to begin
MAX_TIME, MIN_STEP = 1e11, 1e-6  # s: stamps are within, and further apart
GAP_STEP_GROWTH = 1.1  # of the usual step at a gap: after many in a row it was another
SAVED = (  # attributes of a watcher that are its state, beside its parts
    "smoothing", "known", "gram", "span", "waiting", "deaf", "moved", "refused", "last", "step", "back", "replay",
)  # fmt: skip
MAX_REFUSALS = 3  # times that samples are unreadable for another reason, which are said; of more every tenth power
FILTER_MARGIN = 0.5  # s beside a torque that cannot be used, by filters


@dataclass(frozen=True)
class WatchSettings:
    """Settings of a watch.

    ``false_alarms`` a day, blocks of ``block`` (s), a ``baseline`` (s), and ``settle`` (s) after an alarm
    that show what has changed. Changes of the torque by the share ``tolerance`` of the noise are none.
    Raises ConfigError for a value out of its range.
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
                shorter = f", or a shorter block than {self.block:g} s" if name in ("baseline", "settle") else ""
                raise ConfigError(f"watch: {name} is {value:g}; give a number from {low:g} to {high:g}{shorter}.")


class Watcher:
    """Watches a robot by the result of its identification: ``push`` takes samples and returns events.

    ``rng`` draws the simulations of the threshold. Positions and torques are in SI units, joints as in the
    model. Memory is constant. Raises ConfigError where the result cannot be used: no groups, no spline.
    """

    def __init__(self, result: Identification, rng: np.random.Generator, settings: WatchSettings | None = None) -> None:
        check_type("Watcher", result, Identification, "give that of the robot, as `load` reads it from a file")
        self.settings = options = settings or WatchSettings()
        model = result.model
        self.joints = tuple(joint.name for joint in model.joints)
        speeds = result.recipe.min_speeds(self.joints) or (0.0,) * len(self.joints)
        min_speeds = {name: max(v, MIN_SPEED) for name, v in zip(self.joints, speeds, strict=True)}
        self._found = replace(result, recipe=replace(result.recipe, min_speed=min_speeds))
        self._scorer = Scorer.from_identification(result)
        candidates = Candidates(self._groups(), self._scorer.scale, options.tolerance)
        blocks, settle = (max(2, round(x / options.block)) for x in (options.baseline, options.settle))
        dof = max(blocks / 2.0, 4.0)
        evidence = threshold(options.false_alarms, options.block, candidates.ranks, dof, rng, blocks)
        self._detector = Detector(candidates, blocks, settle, evidence, self._scorer.sigma)
        limits = [model.limits.get(name) for name in self.joints]
        self._sensors = Sensors(self.joints, [None if limit is None else limit.velocity or None for limit in limits])
        # build a tracker once: a result that cannot be followed is refused now
        self._make_tracker(StreamSmoothing(0.01, np.full(len(self.joints), 0.05)))
        self._tracker: Tracker | None = None
        self._smoothing: StreamSmoothing | None = None
        self._known: Knowledge = self._detector.start()
        self._parts = [self._empty_samples()]  # that wait; of single samples, until they are joined
        self._estimation: Generator[None, None, StreamSmoothing] | None = None  # of the smoothing; begun anew if lost
        self._gram, self._span = self._scorer.empty_gram, EMPTY_SPAN
        self._waiting = tuple[WaitingBlock, ...]()  # complete blocks of which a sensor may still be doubted
        self._deaf = dict[str, tuple[float, float]]()  # by joint the times (s) of torques that cannot be used
        self._moved = math.nan  # when it moved last, infinite once it was said that it does not
        self._refused = "", 0  # why samples were unreadable, and how many times
        self._last, self._step, self._back, self._replay = math.nan, math.nan, 0, False

    @property
    def knowledge(self) -> Knowledge:
        """Knowledge so far."""
        return self._known

    @property
    def baseline_blocks(self) -> tuple[int, int]:
        """Number of blocks of the baseline so far, and the number that it takes."""
        need = self._detector.baseline
        return (need if self._known.reference is not None else len(self._known.blocks)), need

    @property
    def latest(self) -> float:
        """Stamp (s) of the last sample, nan before the first."""
        return self._last

    def push(self, t: ArrayLike, q: ArrayLike, tau: ArrayLike) -> tuple[Event, ...]:
        """Take samples, t (N) s, q and tau (N, n), nan where there is no number, and return the events.

        The events do not depend on how many samples are given at a time, but their delay does. Raises InputError
        for shapes that do not fit.
        """
        time, x, y = map(as_numbers, (t, q, tau))
        if time.ndim != 1 or x.shape != (len(time), len(self.joints)) or y.shape != x.shape:
            raise InputError(f"samples: {time.shape} stamps, {x.shape} positions, {y.shape} torques do not match.")
        events = list[Event]()
        for k in range(0, len(time), BATCH_SAMPLES):
            rows = slice(k, k + BATCH_SAMPLES)
            events += self._take_in_order(time[rows], *possible_values(x[rows], y[rows]))
        return tuple(events)

    def resume_by_replay(self) -> None:
        """Skip samples that were seen before: a stream is read again from an earlier sample on."""
        self._replay = True

    def _take_in_order(self, t: Array, q: Array, tau: Array) -> list[Event]:
        """Take samples in the order of time; end the motion at gaps, and where the clock was set back."""
        events, indices = list[Event](), list[int]()
        for k, time in enumerate(t.tolist()):
            if not abs(time) <= MAX_TIME:
                continue
            step = time - self._last
            if step < MIN_STEP:
                # single samples of an earlier time are dropped; several in a row mean that the clock was set back
                self._back += not self._replay and step < 0
                if self._back < CLOCK_RESET_SAMPLES:
                    continue
            # a gap or a new clock ends the motion: what is before it is used, unless the clock is new
            if self._back >= CLOCK_RESET_SAMPLES or step > MAX_STEP_RATIO * self._step:
                events += [*self._take_checked(t[indices], q[indices], tau[indices]), *self._catch_up()]
                indices.clear()
                if self._back >= CLOCK_RESET_SAMPLES:
                    events.append(ClockReset(time, self._last))
                elif step > MIN_REPORTED_GAP:
                    events.append(Gap(time, step))
                self._end_motion(keep_rest=self._back < CLOCK_RESET_SAMPLES)
                self._sensors.forget()
                events += self._release_blocks()
                self._moved, self._step = time, GAP_STEP_GROWTH * self._step
                if self._back >= CLOCK_RESET_SAMPLES:
                    self._deaf = {name: (-math.inf, stop) for name, (_, stop) in self._deaf.items() if stop == math.inf}
                    if self._smoothing is not None:
                        self._tracker = self._make_tracker(self._smoothing)  # its stamps may only increase
            elif not math.isnan(step):
                # running mean of the step, by which gaps are recognised
                self._step = step if math.isnan(self._step) else self._step + 0.01 * (step - self._step)
            self._last, self._back, self._replay = time, 0, False
            indices.append(k)
        if len(indices) < len(t):
            t, q, tau = t[indices], q[indices], tau[indices]
        return events + self._take_checked(t, q, tau)

    def _take_checked(self, t: Array, q: Array, tau: Array) -> list[Event]:
        """Take samples without gaps, and leave out those of sensors that fail."""
        events = list[Event]()
        if math.isnan(self._moved) and len(t):
            self._moved = float(t[0])
        while len(t):
            check = self._sensors.check(t, q, tau)
            if check.is_plain:
                events += [*self._take_motion(t, q, tau), *self._release_blocks()]
                break
            n, start, torque = len(check.rows), 0, np.where(check.torque_usable, tau[: len(check.rows)], 0.0)
            sensor_events = list(check.events)
            for stop in (*check.cuts, n):
                rows = start + np.flatnonzero(check.rows[start:stop])
                events += self._take_motion(t[rows], q[rows], torque[rows])
                if sensor_events:  # what is dropped or not used because of them goes by the blocks before
                    events += self._catch_up()
                # a position that failed has spoiled what was not used yet, unless its joint only rests by the torques
                for event in [event for event in sensor_events if stop < n and event.time == t[stop]]:
                    if isinstance(event, Fault) and event.signal is Signal.POSITION and not self._confirm_fault(event):
                        sensor_events.remove(event)
                start = stop
            self._note_unusable_torques(sensor_events)
            events += [*sensor_events, *self._release_blocks()]
            t, q, tau = t[n:], q[n:], tau[n:]
        return sorted([*events, *self._report_rest()], key=lambda event: event.time)

    def _confirm_fault(self, fault: Fault) -> bool:
        """Drop what a failed position may have spoiled; return False where torques show that the joint only rests."""
        spoiled_blocks = [block for block in self._waiting if block[2] > fault.since]
        # the waiting blocks and the one begun together: do their torques fit a joint that rests?
        if fault.kind is FaultKind.STILL:
            gram = sum((block[0] for block in spoiled_blocks), self._gram)
            samples = self._span[2] + sum(block[3] for block in spoiled_blocks)
            scores = self._scorer.scores(gram, fault.since, fault.time, samples)
            if not self._detector.differs(self._known, scores):
                self._sensors.excuse(fault.joint)
                return False
        self._waiting = self._waiting[: len(self._waiting) - len(spoiled_blocks)]
        self._end_motion(keep_rest=False)
        return True

    def _note_unusable_torques(self, events: list[Event]) -> None:
        """Note from when to when the torques of joints cannot be used, and when positions can be used again."""
        for event in events:
            if not isinstance(event, Fault | Back):
                continue
            if event.signal is Signal.POSITION:
                self._moved = event.time
            else:
                stop = math.inf if isinstance(event, Fault) else event.time
                self._deaf[event.joint] = (event.since, stop)

    def _release_blocks(self) -> list[Event]:
        """Pass the blocks to the detector of which no sensor is in doubt."""
        events = list[Event]()
        # a block waits until no sensor is in doubt for its time
        while self._waiting and self._waiting[0][2] <= self._sensors.doubtful_since:
            (gram, start, stop, samples), *others = self._waiting
            self._waiting = tuple(others)
            for joint, (since, until) in self._deaf.items():
                # filters smear an unusable torque over its neighbourhood
                if since - FILTER_MARGIN < stop and start < until + FILTER_MARGIN:
                    gram = gram.without(self.joints.index(joint))
            if gram.rows.max() < MIN_MOVING_SHARE * samples:
                continue
            self._moved = stop
            with one_thread():
                scores = self._scorer.scores(gram, start, stop, samples)
                self._known, block_events = self._detector.step(self._known, scores)
            events += block_events
        return events

    def _report_rest(self) -> list[Event]:
        """Report a long rest once."""
        if self._sensors.dead or self._last - self._moved < MIN_REPORTED_REST:
            return []
        since, self._moved = self._moved, math.inf
        return [Resting(since + MIN_REPORTED_REST, since)]

    def _take_motion(self, t: Array, q: Array, tau: Array) -> list[Event]:
        """Smooth samples, and reduce what is final to blocks; hold them until the first seconds are worked off."""
        events = list[Event]()
        while len(t):
            if self._tracker is not None and not self._held[0].size:
                self._score_blocks(self._tracker.push(t, q, tau))
                break
            parts = self._parts = self._parts if self._parts[0][0].size else []
            first_time, last_time = (float(parts[k][0][k] if parts else t[0]) for k in (0, -1))
            # by their stamps, so that nothing depends on the size of the batches
            due_time = first_time + SMOOTHING_TIME if self._tracker is None else -math.inf
            portions = [(time, math.floor(time / PORTION_TIME)) for time in (last_time, *t.tolist())]
            is_due = [portion > before and time >= due_time for (_, before), (time, portion) in pairwise(portions)]
            count = is_due.index(True) + 1 if True in is_due else len(t)
            parts.append((t[:count].copy(), q[:count].copy(), tau[:count].copy()))
            t, q, tau = t[count:], q[count:], tau[count:]
            if True in is_due:
                events += self._work_off()
        return events

    def _catch_up(self) -> list[Event]:
        """Work off all held samples, unless the first seconds are not over."""
        events = list[Event]()
        while (held := self._held[0]).size and (self._tracker or held[-1] >= held[0] + SMOOTHING_TIME):
            events += self._work_off()
        return events

    def _work_off(self) -> list[Event]:
        """Work off a portion of the held samples: a step of the estimate of the smoothing, then window by window."""
        if self._tracker is not None:
            count = max(2, round(WINDOW_TIME / self._tracker.smoother.step))
            self._score_blocks(self._tracker.push(*self._take_held(count)))
            return []
        t, q, tau = self._held
        count = int(np.searchsorted(t, t[0] + SMOOTHING_TIME)) + 1
        try:
            if self._estimation is None:
                log = Log(t[:count], q[:count], tau[:count], self.joints, "the first seconds of the stream")
                self._estimation = smoothing_steps(self._found, log)
            next(self._estimation)
        except StopIteration as end:
            self._smoothing, self._estimation, self._tracker = end.value, None, self._make_tracker(end.value)
        # no joint moves yet, or the log cannot be smoothed: say why once, and wait for more
        except (ConfigError, InputError, np.linalg.LinAlgError) as error:
            (t, *_), self._estimation = self._take_held(count), None
            last_reason, count = self._refused[0], self._refused[1] + 1
            self._refused = str(error), count
            is_said = last_reason != str(error) and (count <= MAX_REFUSALS or math.log10(count).is_integer())
            return [Unreadable(float(t[-1]), len(t), str(error))] if is_said else []
        return []

    @property
    def _held(self) -> tuple[Array, ...]:
        """Samples that wait: of the first seconds, until they are worked off; joined when they are needed."""
        if len(self._parts) > 1:
            self._parts = [tuple(np.concatenate(signals) for signals in zip(*self._parts, strict=True))]
        return self._parts[0]

    def _take_held(self, count: int) -> tuple[Array, ...]:
        """Return the first of the held samples, which are held no longer."""
        samples, self._parts = self._held, [tuple(x[count:] for x in self._held)]
        return tuple(x[:count] for x in samples)

    def _make_tracker(self, smoothing: StreamSmoothing) -> Tracker:
        lag = LAG_BANDWIDTHS * float(smoothing.bandwidth.max()) + 2 * smoothing.step
        return Tracker(self._found, smoothing, lag, window=max(2, round(WINDOW_TIME / smoothing.step)), fits=False)

    def _score_blocks(self, blocks: tuple[MotionBlock, ...]) -> None:
        """Add to the current block, and to the waiting ones when it is complete."""
        for block in blocks:
            with one_thread():
                gram, t = self._scorer.gram(block.entries), block.motion.t
            start, _, samples = self._span
            first_time = float(t[0]) if math.isnan(start) else start
            self._gram = self._gram + gram
            self._span = first_time, float(t[-1]), samples + int(block.motion.mask.sum())
            # blocks end with a window of the smoother, so half a window may be missing
            if t[-1] - first_time >= self.settings.block - WINDOW_TIME / 2:
                if self._span[2]:
                    self._waiting = (*self._waiting, (self._gram, *self._span))
                self._gram, self._span = self._scorer.empty_gram, EMPTY_SPAN

    def _end_motion(self, *, keep_rest: bool) -> None:
        """End a motion, and use the rest of it, or drop it together with the current block."""
        blocks = () if self._tracker is None else self._tracker.finish()
        if self._tracker is None:
            self._parts = [self._empty_samples()]
        if keep_rest:
            self._score_blocks(blocks)
        else:
            self._gram, self._span = self._scorer.empty_gram, EMPTY_SPAN

    def _groups(self) -> tuple[ParameterGroup, ...]:
        """Return the groups that may change: those of base parameters, and the residual of each joint."""
        n, unit = len(self.joints), ("",)
        residual_groups = (
            ParameterGroup(GroupKind.RESIDUAL, joint, np.eye(n)[:, [j]], (f"residual of {joint}",), unit)
            for j, joint in enumerate(self.joints)
        )
        return (*groups_of(self._found.model, self._scorer.basis), *residual_groups)

    def _empty_samples(self) -> tuple[Array, ...]:
        return np.zeros(0), np.zeros((0, len(self.joints))), np.zeros((0, len(self.joints)))

    @property
    def state(self) -> dict[str, Any]:
        """State as arrays, numbers, and data classes of this package; ``restore`` takes them again."""
        values = {name: getattr(self, f"_{name}") for name in SAVED}
        tracker = None if self._tracker is None else self._tracker.state
        parts = {"held": self._held, "tracker": tracker, "sensors": self._sensors.state}
        return values | parts | {"threshold": self._detector.threshold}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Continue from a saved state of a watcher of the same result and settings."""
        for name in SAVED:
            setattr(self, f"_{name}", state[name])
        self._parts, self._estimation = [tuple(state["held"])], None
        self._detector = replace(self._detector, threshold=state["threshold"])
        self._sensors.restore(state["sensors"])
        if self._smoothing is not None:
            self._tracker = self._make_tracker(self._smoothing)
            self._tracker.restore(state["tracker"])
