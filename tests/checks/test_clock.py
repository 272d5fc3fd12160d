"""Time stamps of another rate than that of the recording."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynident.checks.explain import explained
from dynident.checks.finding import Finding, Topic
from dynident.checks.robot_notes import ClockWrong
from dynident.errors import Use
from tests.checks.moving_arm import arm, case, motion, truth

MOVED = motion()


def stamped(rate: float) -> list[Finding]:
    """What is found where a second of the stamps is ``rate`` seconds."""
    return list(explained(case(replace(MOVED, dq=rate * MOVED.dq, ddq=rate**2 * MOVED.ddq))))


@pytest.mark.parametrize("rate", [0.8, 1.25])
def test_a_wrong_rate_is_named_with_its_factor_and_cost(rate: float) -> None:
    (found,) = stamped(rate)
    assert (found.joint, found.topic) == (None, Topic.CLOCK)
    assert isinstance(found.message, ClockWrong)
    assert found.message.factor == pytest.approx(rate, abs=5 * found.message.std)
    assert found.message.std < 0.03
    assert found.forbids is not None


def test_its_cost_is_what_the_wrong_model_says_of_the_true_motion() -> None:
    """Inertias are too small by the square of the rate, friction by the rate; gravity is right."""
    rate, model, theta = 1.25, arm(), truth(arm())
    (found,) = stamped(rate)
    fast = MOVED.q, 2 * MOVED.dq, 4 * MOVED.ddq
    right, held = model.torque(*fast, theta), model.torque(MOVED.q, 0 * MOVED.dq, 0 * MOVED.ddq, theta)
    friction = np.array([x.role in ("viscous", "coulomb") for x in model.parameters])
    rubs = model.torque(*fast, np.where(friction, theta, 0.0))
    said = held + (right - held - rubs) / rate**2 + rubs
    worst = np.linalg.norm(said - right, axis=0) / np.linalg.norm(right, axis=0)
    assert found.message.joint_cost == pytest.approx(100 * worst.max(), rel=0.3)
    assert (found.forbids is Use.CONTROL) is (found.message.joint_cost > 25)
