"""Sensors that fail are seen at once, and those that do not are left alone."""

import numpy as np
import pytest
from numpy.typing import NDArray

from dynident.apps.online import Back, Fault, FaultKind, Signal
from dynident.apps.online.sensors import Sensors
from dynident.runtime.arrays import Array

RATE, START, STOP = 125.0, 10.0, 20.0
T = np.arange(3000) / RATE
BEGIN, END = round(START * RATE), round(STOP * RATE)
COUNT = 2 * np.pi / 2**19


def recorded(count: float = COUNT, rests: bool = False) -> tuple[Array, Array]:
    """Return two joints in motion, by encoders; one may rest now and then, for longer than a second."""
    s = T if not rests else np.cumsum(np.clip(2 * np.sin(2 * np.pi * T / 8) + 1, 0, 1)) / RATE
    q = np.stack([np.sin(1.3 * T), 0.8 * np.cos(2.1 * s)], axis=1)
    rng = np.random.default_rng(0)
    return count * np.round(q / count), 0.01 * np.round((3 * q + 0.2 * rng.standard_normal(q.shape)) / 0.01)


def fault_seen(q: Array, tau: Array) -> tuple[Fault, Back, NDArray[np.bool_]]:
    """Return the only fault, its end, and the rows that are used."""
    (fault, back), rows = seen(q, tau)
    assert isinstance(fault, Fault)
    assert isinstance(back, Back)
    return fault, back, rows


def seen(q: Array, tau: Array, velocity: float | None = 3.0) -> tuple[list[Fault | Back], NDArray[np.bool_]]:
    sensors, events, rows = Sensors(("one", "two"), (velocity, velocity)), list[Fault | Back](), np.zeros(0, dtype=bool)
    while len(rows) < len(T):
        some = slice(len(rows), None)
        result = sensors.check(T[some], q[some], tau[some])
        events += [event for event in result.events if isinstance(event, Fault | Back)]
        rows = np.append(rows, result.rows)
    return events, rows


@pytest.mark.parametrize(
    ("count", "rests", "velocity"), [(COUNT, True, None), (2 * np.pi / 2**12, True, 3.0), (COUNT, False, 0.2)]
)
def test_sound_sensors_are_left_alone(count: float, rests: bool, velocity: float | None) -> None:
    events, rows = seen(*recorded(count, rests), velocity)
    assert events == []
    assert rows.all()


def test_samples_that_are_logged_several_times_and_torques_that_never_were_are_no_fault() -> None:
    q, tau = (np.repeat(x[::4], 4, axis=0) for x in recorded())
    tau[:, 1] = 0.0
    assert seen(q, tau)[0] == []


def test_an_encoder_that_freezes_is_seen_within_a_tenth_of_a_second() -> None:
    q, tau = recorded()
    q[BEGIN:END, 1] = q[BEGIN, 1]
    fault, back, rows = fault_seen(q, tau)
    assert (fault.kind, fault.signal, fault.joint, fault.since) == (FaultKind.FROZEN, Signal.POSITION, "two", START)
    assert START < fault.time < START + 0.1
    assert STOP < back.time < STOP + 0.1
    assert not rows[BEGIN + 25 : END].any()
    assert rows[END + 10 :].all()


@pytest.mark.parametrize("signal", list(Signal))
def test_no_numbers_are_seen_after_three_samples(signal: Signal) -> None:
    q, tau = recorded()
    (q if signal is Signal.POSITION else tau)[BEGIN:END, 0] = np.nan
    fault, _, rows = fault_seen(q, tau)
    assert (fault.kind, fault.signal, fault.joint) == (FaultKind.MISSING, signal, "one")
    assert fault.time == T[BEGIN + 2]
    assert not rows[BEGIN : BEGIN + 2].any()
    assert rows[BEGIN + 2 : END].any() == (signal is Signal.TORQUE)  # of the other joint
    assert rows[:BEGIN].all()


def test_a_joint_that_is_known_to_rest_is_not_still_until_it_moved_again() -> None:
    q, tau = recorded(2 * np.pi / 2**10)
    q[BEGIN:END, 1] = q[BEGIN, 1]
    sensors = Sensors(("one", "two"), (3.0, 3.0))
    end = len(sensors.check(T, q, tau).rows)
    sensors.excuse("two")
    result = sensors.check(T[end:], q[end:], tau[end:])
    (jump,) = result.events  # this one was dead: where it moves again is said
    assert (jump.kind, jump.since) == (FaultKind.JUMP, STOP)
    assert result.rows.all()
    assert len(result.rows) == len(T) - end
    assert not sensors.excused.any()


@pytest.mark.parametrize("fine", [0.0, 1e-6])
def test_a_torque_that_freezes_while_the_robot_moves_is_seen_in_about_a_second(fine: float) -> None:
    q, tau = recorded()
    tau += fine * np.random.default_rng(1).standard_normal(tau.shape)  # no two values are equal
    tau[BEGIN:END, 1] = 0.0
    fault, *_ = fault_seen(q, tau)
    assert (fault.kind, fault.signal, fault.joint) == (FaultKind.FROZEN, Signal.TORQUE, "two")
    assert START + 0.9 < fault.time < START + 2.5


def test_torques_that_are_zero_while_the_robot_stands_are_no_fault() -> None:
    tau = recorded()[1]
    tau[BEGIN:END] = 0.0
    s = np.cumsum(np.clip(np.minimum(np.abs(T - (START + STOP) / 2) - 5.0, 1.0), 0, 1)) / RATE  # slows down and rests
    q = COUNT * np.round(np.stack([np.sin(1.3 * s), np.cos(2.1 * s)], axis=1) / COUNT)
    assert seen(q, tau)[0] == []


@pytest.mark.parametrize("velocity", [3.0, None])
def test_a_jump_is_seen_and_a_spike_is_not(velocity: float | None) -> None:
    q, tau = recorded()
    spike = q.copy()
    spike[BEGIN, 0] += 0.5
    assert seen(spike, tau, velocity)[0] == []
    q[BEGIN:, 0] += 0.5
    (fault,), rows = seen(q, tau, velocity)
    assert (fault.kind, fault.joint, fault.since) == (FaultKind.JUMP, "one", START)
    assert fault.size == pytest.approx(0.5, abs=0.02)
    assert fault.time < START + 4 / RATE
    assert rows.all()


def test_positions_that_jump_again_and_again_are_said_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dynident.apps.online.sensors.JUMP_PAUSE", 3.0)
    q, tau = recorded()
    q[BEGIN:END, 0] += np.arange(END - BEGIN) // 125 % 2
    (first, second, fault, back), rows = seen(q, tau)
    kinds = [event.kind for event in (first, second, fault) if isinstance(event, Fault)]
    assert kinds == [FaultKind.JUMP, FaultKind.JUMP, FaultKind.JUMPING]
    assert "its sensor fails" in fault.words(str, ())
    assert STOP + 3.0 <= back.time < STOP + 3.2
    assert not rows[BEGIN + 380 : END].any()
    assert rows[-50:].all()


@pytest.mark.parametrize("size", [1, 7])
def test_samples_may_come_one_by_one_and_the_sensors_be_saved(size: int) -> None:
    q, tau = recorded()
    q[BEGIN:END, 1] = q[BEGIN, 1]
    q[300:302, 1] += 0.4
    q[400:, 0] += 2.0
    tau[500:520, 0] = np.nan
    together = Sensors(("one", "two"), (3.0, None))
    result = together.check(T, q, tau)
    case, events, rows, usable = Sensors(("one", "two"), (3.0, None)), list[object](), list[bool](), list[list[bool]]()
    for k in range(0, len(T), size):
        part = slice(k, k + size)
        test_result = case.check(T[part], q[part], tau[part])
        events += test_result.events
        rows += test_result.rows.tolist()
        usable += test_result.torque_usable.tolist()
        assert test_result.is_plain == (
            test_result.rows.all() and test_result.torque_usable.all() and not test_result.events
        )
        if k % 70 == 0:
            other = Sensors(("one", "two"), (3.0, None))
            other.restore(case.state)
            case = other
    assert tuple(events) == result.events
    assert rows == result.rows.tolist()
    assert usable == result.torque_usable.tolist()
    for name, value in together.state.items():
        np.testing.assert_array_equal(value, case.state[name], err_msg=name)
