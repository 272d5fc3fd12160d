"""Time stamps of another rate than that of the recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynident.checks.explain import explain_residual
from dynident.checks.misfit import FitCase, misfit
from dynident.checks.robot_notes import ClockWrong, SuspectQuantity
from dynident.checks.suspects import clock_suspect, estimate_suspect
from dynident.runtime import Use
from tests.checks.moving_arm import arm, case, motion, truth

MOVED = motion()


def stamped(rate: float) -> FitCase:
    """The arm where a second of the stamps is ``rate`` seconds."""
    return case(replace(MOVED, dq=rate * MOVED.dq, ddq=rate**2 * MOVED.ddq))


@pytest.mark.parametrize("rate", [0.8, 1.25])
def test_the_rate_is_found(rate: float) -> None:
    found = estimate_suspect(misfit(stamped(rate)), clock_suspect())
    assert found is not None
    note = clock_suspect().note(found.value, found.std, found.share, ())
    assert isinstance(note, ClockWrong)
    assert note.value == pytest.approx(rate, abs=5 * note.std)
    assert note.std < 0.03


def test_a_right_clock_is_not_suspected() -> None:
    assert estimate_suspect(misfit(stamped(1.0)), clock_suspect()) is None


def test_friction_that_is_different_at_low_speed_at_all_joints_is_no_clock() -> None:
    speed = np.sqrt(np.mean(MOVED.dq**2, axis=0))
    stribeck = 4.0 * np.exp(-((MOVED.dq / (0.2 * speed)) ** 2)) * np.sign(MOVED.dq)
    found = [one.message for one in explain_residual(case(replace(MOVED, tau=MOVED.tau + stribeck)))]
    assert found
    assert not any(isinstance(note, ClockWrong) for note in found)


def test_where_it_cannot_be_told_from_a_length_its_cost_counts() -> None:
    """The cost is that of inertias too small by the square of the rate, and friction by the rate; gravity is right."""
    rate, model, theta = 1.25, arm(), truth(arm())
    (found,) = explain_residual(stamped(rate))
    assert isinstance(found.message, ClockWrong)
    assert [one.quantity for one in found.message.others] == [SuspectQuantity.LENGTH]
    assert found.message.value == pytest.approx(rate, abs=0.1)
    fast = MOVED.q, 2 * MOVED.dq, 4 * MOVED.ddq
    right, held = model.torque(*fast, theta), model.torque(MOVED.q, 0 * MOVED.dq, 0 * MOVED.ddq, theta)
    friction = np.array([x.role in ("viscous", "coulomb") for x in model.parameters])
    rubs = model.torque(*fast, np.where(friction, theta, 0.0))
    said = held + (right - held - rubs) / rate**2 + rubs
    worst = np.linalg.norm(said - right, axis=0) / np.linalg.norm(right, axis=0)
    assert found.message.joint_cost == pytest.approx(100 * worst.max(), rel=0.3)
    assert found.forbids is Use.CONTROL
