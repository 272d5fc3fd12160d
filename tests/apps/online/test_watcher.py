"""A watcher: samples in, what there is to say out."""

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
import pytest

import dynident as dy
from dynident.apps.online import (
    Alarm,
    Back,
    BaselineKnown,
    Changed,
    ClockReset,
    Event,
    Fault,
    FaultKind,
    Gap,
    Resting,
    Signal,
    Unreadable,
    Watcher,
    WatchSettings,
    tracker,
)
from dynident.apps.online.fixed_lag import FinalMotion, FixedLag
from dynident.apps.online.scores import Scores, Sums
from dynident.identification import Identification
from dynident.models.lagrangian import MODELS
from dynident.motion.smoothers import Smoother
from dynident.runtime import ConfigError, InputError
from dynident.runtime.arrays import Array
from tests.project.watched import RATE, samples

HOW = WatchSettings(block=1.0, baseline=25.0, settle=6.0)
CLOCK = "last", "step", "back", "replay"  # of a state
COUNT = 2 * np.pi / 2**17  # rad, of an encoder


@cache
def identification() -> Identification:
    t, q, tau = samples(0.0, 10.0, seed=3)
    model = MODELS["slider"]()
    return dy.identify(model, dy.Log(t, q, tau, tuple(joint.name for joint in model.joints)))


@cache
def state_after(seconds: float) -> Mapping[str, Any]:
    test_watcher = watcher()
    test_watcher.push(*samples(0, seconds))
    return test_watcher.state


def watcher(seconds: float = 0.0) -> Watcher:
    """A watcher that has seen the slider for some seconds."""
    case = Watcher(identification(), np.random.default_rng(0), HOW)
    if seconds:
        case.restore(state_after(seconds))
    return case


def same_scores(some: Sequence[Scores | Sums], others: Sequence[Scores | Sums]) -> None:
    assert len(some) == len(others) > 0
    for a, b in zip(some, others, strict=True):
        np.testing.assert_array_equal(a.score, b.score)


def types(events: Sequence[Event]) -> list[type]:
    return [type(event) for event in events]


def test_single_samples_are_watched_as_many_are() -> None:
    t, q, tau = samples(0, 16)
    t[1200:] += 2.0
    q[700, 0], tau[800, 0], t[900], tau[1300:1340, 0] = 1e7, np.inf, np.nan, np.nan
    test_watcher, case, events = watcher(), watcher(), list[Event]()
    expected = test_watcher.push(t, q, tau)
    for k in range(len(t)):
        events += case.push(t[k : k + 1], q[k : k + 1], tau[k : k + 1])
    assert [repr(event) for event in events] == [repr(event) for event in expected]
    assert types(expected) == [Gap, Fault, Back]
    for name in (*CLOCK, "moved", "refused", "deaf", "smoothing"):
        assert repr(case.state[name]) == repr(test_watcher.state[name]), name
    for part in ("sensors", "tracker"):
        for name, value in case.state[part].items():
            np.testing.assert_array_equal(value, test_watcher.state[part][name], err_msg=name)


def test_gaps_and_clocks_that_are_set_back_end_a_motion_and_no_more() -> None:
    test_watcher = watcher()
    test_watcher.push(*samples(0, 30.3))
    assert test_watcher.push(*samples(34, 40.2)) == (Gap(34.0, pytest.approx(3.71)),)  # type: ignore[arg-type]
    again = test_watcher.push(*samples(0, 20.0))
    assert again == (ClockReset(pytest.approx(0.09), pytest.approx(40.19)),)  # type: ignore[arg-type]


def test_what_was_before_a_gap_is_none_of_the_first_seconds() -> None:
    monitor = watcher()
    monitor.push(*samples(0, 5))
    assert types(monitor.push(*samples(20, 29))) == [Gap]
    assert monitor.state["held"][0] == pytest.approx(np.arange(2000, 2900) / RATE)


def test_samples_that_come_again_are_left_out() -> None:
    first, second = watcher(30), watcher(30)
    first.push(*samples(30, 40))
    second.push(*samples(29.97, 30))
    second.resume_by_replay()
    t, q, tau = (np.concatenate([a, b]) for a, b in zip(samples(0, 30), samples(30, 40), strict=True))
    second.push(t, q, tau)
    assert [repr(first.state[name]) for name in CLOCK] == [repr(second.state[name]) for name in CLOCK]
    same_scores(first.knowledge.windows, second.knowledge.windows)


def test_an_arm_at_rest_says_nothing() -> None:
    test_watcher = watcher(30)
    t, q, tau = samples(30, 60)
    slow = np.clip((t - 30.0) / 1.0, 0, 1)
    q = q[:1] + (q - q[:1]) * (1 - slow[:, None]) + 1e-5 * np.random.default_rng(1).standard_normal(q.shape)
    rest = 2.0 + 0.3 * np.random.default_rng(2).standard_normal(tau.shape)  # what static friction carries
    events = test_watcher.push(t[200:], q[200:], rest[200:])
    assert not [event for event in events if isinstance(event, Changed | Alarm)]


def test_a_robot_that_does_not_move_at_first_is_waited_for() -> None:
    test_watcher = watcher()
    t, q, tau = samples(0, 12)
    assert types(test_watcher.push(t, np.zeros_like(q), tau)) == [Unreadable]
    assert types(test_watcher.push(*samples(12, 50))) == [BaselineKnown]


def test_no_push_waits_for_the_first_seconds_to_be_worked_off(monkeypatch: pytest.MonkeyPatch) -> None:
    worked = [0]  # samples that were smoothed, times joints, in each push
    smooth_window, smooth_log = FixedLag._smooth_window, tracker.smooth_log

    def count_window(self: FixedLag, stop: int, *, ended: bool = False) -> tuple[FinalMotion, ...]:
        worked[-1] += len(self.joints) * self._filled
        return smooth_window(self, stop, ended=ended)

    def count_log(smoother: Smoother, log: dy.Log) -> dy.Motion:
        worked[-1] += log.q.size
        return smooth_log(smoother, log)

    monkeypatch.setattr(FixedLag, "_smooth_window", count_window)
    monkeypatch.setattr(tracker, "smooth_log", count_log)
    watch, (t, q, tau) = Watcher(arm(), np.random.default_rng(0), HOW), arm_samples(14.0)
    for k in range(len(t)):
        worked.append(0)
        watch.push(t[k : k + 1], q[k : k + 1], tau[k : k + 1])
    first_seconds = round(10 * RATE) + 1
    assert max(worked) == first_seconds  # of one joint
    assert sum(worked) > 5 * first_seconds
    assert max(worked[round(12 * RATE) :]) < first_seconds
    assert not len(watch.state["held"][0])


def test_it_does_not_matter_how_fast_the_first_seconds_are_worked_off(monkeypatch: pytest.MonkeyPatch) -> None:
    t, q, tau = arm_samples(42.0)
    q[1055:1300, 1] = q[1055, 1]  # an encoder dies while samples wait
    keep = np.ones(len(t), dtype=bool)
    keep[1600:1800] = False  # a gap

    def watched() -> tuple[tuple[Event, ...], Watcher]:
        watch = Watcher(arm(), np.random.default_rng(0), HOW)
        events = watch.push(t[keep], q[keep], tau[keep])
        assert watch.push([100.0], q[:1], tau[:1])
        return events, watch

    expected_events, expected = watched()
    assert types(expected_events)[:3] == [Fault, Back, Gap]
    assert BaselineKnown in types(expected_events)
    for portion in (1e-6, 0.5):
        monkeypatch.setattr("dynident.apps.online.watcher.PORTION_TIME", portion)
        events, watch = watched()
        assert events == expected_events
        same_scores(watch.knowledge.windows, expected.knowledge.windows)


def test_a_watch_that_was_saved_while_samples_wait_goes_on_the_same() -> None:
    t, q, tau = arm_samples(20.0)
    full, watch = (Watcher(arm(), np.random.default_rng(0), HOW) for _ in range(2))
    full.push(t, q, tau)
    for rows in (slice(0, 1004), slice(1004, 1020), slice(1020, None)):  # within the estimate, within the windows
        watch.push(t[rows], q[rows], tau[rows])
        state = watch.state
        watch = Watcher(arm(), np.random.default_rng(0), HOW)
        watch.restore(state)
    same_scores(watch.knowledge.blocks, full.knowledge.blocks)


def test_shapes_and_settings_are_checked() -> None:
    with pytest.raises(InputError, match="do not match"):
        watcher().push([0.0], [[0.0, 1.0]], [[0.0, 1.0]])
    with pytest.raises(ConfigError, match=r"watch: block is 0\.1"):
        WatchSettings(block=0.1)


def arm_samples(
    stop: float, seed: int = 0, parked: tuple[float, float] = (0.0, 0.0), change: float = 1e9
) -> list[Array]:
    """Two links to and fro, by encoders; the second is slowed to a rest and started again, the first rubs more from
    ``change`` (s) on."""
    t = np.arange(round(stop * RATE)) / RATE
    pace = 1.0 - np.clip(np.minimum(t - parked[0], parked[1] - t) / 0.5, 0.0, 1.0)
    s = np.cumsum(pace) / RATE
    q = np.stack([0.8 * np.sin(2.1 * t) + 0.4 * np.sin(1.3 * t), np.sin(1.7 * s) + 0.5 * np.sin(2.9 * s)], axis=1)
    dq, ddq = np.gradient(q, 1 / RATE, axis=0), np.gradient(np.gradient(q, 1 / RATE, axis=0), 1 / RATE, axis=0)
    model = MODELS["two_link_arm"]()
    tau = model.torque(q, dq, ddq, model.values)
    tau[:, 0] += np.where(t > change, 0.3, 0.0) * dq[:, 0]
    return [t, COUNT * np.round(q / COUNT), tau + 0.02 * np.random.default_rng(seed).standard_normal(q.shape)]


@cache
def arm() -> Identification:
    t, q, tau = arm_samples(10.0, seed=3)
    return dy.identify(MODELS["two_link_arm"](), dy.Log(t, q, tau, ("joint1", "joint2")))


def arm_said(t: Array, q: Array, tau: Array) -> list[Event]:
    case, events = Watcher(arm(), np.random.default_rng(0), HOW), list[Event]()
    for k in range(0, len(t), 1777):
        some = slice(k, k + 1777)
        events += case.push(t[some], q[some], tau[some])
    return events


def check_change(events: list[Event]) -> None:
    """The first joint rubs more from 42 s on."""
    (changed,) = [event for event in events if isinstance(event, Changed)]
    assert (changed.joint, changed.since) == ("joint1", pytest.approx(42.0, abs=2.0))


def test_an_encoder_that_dies_at_a_turn_spoils_nothing() -> None:
    t, q, tau = arm_samples(50.0)
    turns = np.flatnonzero(np.diff(np.sign(np.diff(q[:, 1]))))
    k = int(turns[turns > 32 * RATE][0])
    q[k : k + 1500, 1] = q[k, 1]
    baseline, fault, *rest = arm_said(t, q, tau)
    assert isinstance(baseline, BaselineKnown)
    assert (fault.kind, fault.joint) == (FaultKind.STILL, "joint2")
    assert 5.0 <= fault.time - fault.since < 6.0
    assert {type(x) for x in rest} <= {Fault, Back}


def test_a_joint_that_rests_for_longer_than_usual_is_no_fault_and_changes_are_still_found() -> None:
    events = arm_said(*arm_samples(55.0, parked=(30.0, 54.0), change=42.0))
    assert Fault not in types(events)
    check_change(events)


def test_without_the_torque_of_one_joint_the_others_are_watched() -> None:
    t, q, tau = arm_samples(55.0, change=42.0)
    tau[3500:, 1] = np.nan
    _, fault, *events = arm_said(t, q, tau)
    assert (fault.kind, fault.signal, fault.joint) == (FaultKind.MISSING, Signal.TORQUE, "joint2")
    check_change(events)


def test_of_a_robot_that_does_not_move_this_is_said_once() -> None:
    t = np.arange(4000) / 10.0
    q = np.zeros((len(t), 2))
    events = [x for x in arm_said(t, q, q) if isinstance(x, Resting)]
    assert events == [Resting(300.0, 0.0)]


@pytest.mark.parametrize("seed", range(3))
def test_numbers_that_no_sensor_gives_do_no_harm(seed: int) -> None:
    rng, robot_watcher = np.random.default_rng(seed), watcher()
    t, q, tau = samples(0, 40)
    wild = [1e99, -1e99, 1e50, -1e12, 5e-324, np.nan, np.inf]
    for _ in range(18):
        signal, k = (t, q, tau)[rng.integers(3)], int(rng.integers(len(t)) if rng.random() < 0.7 else rng.integers(30))
        signal[k : k + rng.integers(1, 4)] = rng.choice(wild)
    assert BaselineKnown in types(robot_watcher.push(t, q, tau))


def test_a_first_step_that_is_none_hides_no_motion() -> None:
    t, q, tau = samples(0, 40)
    t[1] = t[0] + 1e-5
    assert BaselineKnown in types(watcher().push(t, q, tau))
