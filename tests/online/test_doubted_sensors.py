"""A sensor that is doubted: what it may have spoiled is not used, what does not depend on it is."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

import dynident as dy
from dynident.identification import Identification
from dynident.models.gallery import MODELS
from dynident.online import BaselineKnown, Changed, Event, Fault, FaultKind, Resting, Signal, Watcher, WatchSettings

Array = NDArray[np.float64]
HOW = WatchSettings(block=1.0, baseline=25.0, settle=6.0)
RATE, COUNT = 100.0, 2 * np.pi / 2**17


def samples(stop: float, seed: int = 0, parked: tuple[float, float] = (0.0, 0.0), change: float = 1e9) -> list[Array]:
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
def found() -> Identification:
    t, q, tau = samples(10.0, seed=3)
    return dy.identify(MODELS["two_link_arm"](), dy.Log(t, q, tau, ("joint1", "joint2")))


def said(t: Array, q: Array, tau: Array) -> list[Event]:
    one, events = Watcher(found(), np.random.default_rng(0), HOW), list[Event]()
    for k in range(0, len(t), 1777):
        some = slice(k, k + 1777)
        events += one.push(t[some], q[some], tau[some])
    return events


def test_an_encoder_that_dies_at_a_turn_spoils_nothing() -> None:
    t, q, tau = samples(55.0)
    turns = np.flatnonzero(np.diff(np.sign(np.diff(q[:, 1]))))
    k = int(turns[turns > 32 * RATE][0])
    q[k : k + 1500, 1] = q[k, 1]
    baseline, fault, *rest = said(t, q, tau)
    assert isinstance(baseline, BaselineKnown)
    assert isinstance(fault, Fault)
    assert (fault.kind, fault.joint) == (FaultKind.STILL, "joint2")
    assert 5.0 <= fault.time - fault.since < 6.0
    assert not [one for one in rest if not isinstance(one, Fault) and type(one).__name__ != "Back"]


def test_a_joint_that_rests_for_longer_than_usual_is_no_fault_and_changes_are_still_found() -> None:
    events = said(*samples(65.0, parked=(30.0, 64.0), change=50.0))
    assert not [one for one in events if isinstance(one, Fault)]
    (changed,) = [one for one in events if isinstance(one, Changed)]
    assert changed.joint == "joint1"
    assert abs(changed.since - 50.0) <= 2.0


def test_without_the_torque_of_one_joint_the_others_are_watched() -> None:
    t, q, tau = samples(65.0, change=50.0)
    tau[3500:, 1] = np.nan
    _, fault, *events = said(t, q, tau)
    assert isinstance(fault, Fault)
    assert (fault.kind, fault.signal, fault.joint) == (FaultKind.MISSING, Signal.TORQUE, "joint2")
    (changed,) = [one for one in events if isinstance(one, Changed)]
    assert changed.joint == "joint1"
    assert abs(changed.since - 50.0) <= 2.0


def test_of_a_robot_that_does_not_move_this_is_said_once() -> None:
    t = np.arange(7000) / 10.0
    q = np.zeros((len(t), 2))
    events = [one for one in said(t, q, q) if isinstance(one, Resting)]
    assert events == [Resting(300.0, 0.0)]
