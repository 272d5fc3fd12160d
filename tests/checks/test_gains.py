"""A torque that is too large at one joint, as the other joints show."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynident.checks.explain import explain_residual
from dynident.checks.robot_notes import PositionGear, TorqueGain
from dynident.checks.suspects import gain_suspects
from dynident.models.lagrangian import slider
from tests.checks.moving_arm import case, motion


@pytest.mark.parametrize(("joint", "gain"), [(1, 2.0), (1, 1.1), (2, 0.5), (2, 1.2)])
def test_a_gain_is_found_with_its_joint(joint: int, gain: float) -> None:
    moved, factor = motion(), np.ones(3)
    factor[joint] = gain
    (found,) = explain_residual(case(replace(moved, tau=factor * moved.tau)))
    assert (found.topic, found.joint) == ("gain", f"j{joint + 1}")
    assert isinstance(found.message, TorqueGain)
    assert found.message.value == pytest.approx(gain, abs=4 * found.message.std)
    assert found.message.std < 0.05 * gain


@pytest.mark.parametrize(("joint", "factor"), [(0, 1.2), (1, 1.05), (1, 0.8), (2, 1.05), (2, 1.2)])
def test_a_position_gear_is_found_with_its_joint(joint: int, factor: float) -> None:
    moved, factors = motion(), np.ones(3)
    factors[joint] = factor
    moved = replace(moved, q=factors * moved.q, dq=factors * moved.dq, ddq=factors * moved.ddq)
    (found,) = explain_residual(case(moved))
    assert (found.topic, found.joint) == ("gear", f"j{joint + 1}")
    assert isinstance(found.message, PositionGear)
    assert found.message.value == pytest.approx(1 / factor, abs=4 * found.message.std)
    assert found.message.std < 0.02


def test_a_gain_of_all_joints_cannot_be_seen() -> None:
    moved = motion()
    assert list(explain_residual(case(replace(moved, tau=1.1 * moved.tau)))) == []
    assert gain_suspects(slider()) == []
