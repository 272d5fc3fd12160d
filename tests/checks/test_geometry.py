"""Zeros, lengths and axes that the robot file has wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynident.checks.explain import explain_residual
from dynident.checks.misfit import misfit
from dynident.checks.robot_notes import AxisTilted, LengthWrong, ZeroOff
from dynident.checks.suspects import displace_joint, geometry_suspects
from dynident.models.lagrangian import two_link_arm
from tests.checks.moving_arm import arm, case, motion, text


@pytest.mark.parametrize("length", [0.44, 0.6, 0.2])
def test_a_wrong_length_is_found(length: float) -> None:
    (found,) = explain_residual(case(motion(noise=0.004), arm(text(length))))
    assert (found.topic, found.joint) == ("length", "j3")
    note = found.message
    assert isinstance(note, LengthWrong)
    assert (note.component, note.given) == ("x", length)
    assert note.value == pytest.approx(0.4, abs=4 * note.std)
    assert note.std < 0.01


def test_a_zero_is_found_where_gravity_shows_it() -> None:
    moved = motion()
    found = next(iter(explain_residual(case(replace(moved, q=moved.q - np.array([0.0, 0.1, 0.0]))))))
    assert (found.topic, found.joint) == ("zero", "j2")
    assert isinstance(found.message, ZeroOff)
    assert found.message.value == pytest.approx(0.1, abs=4 * found.message.std)


@pytest.mark.parametrize("joint", [0, 2])
def test_the_zeros_of_a_vertical_and_of_the_last_axis_cannot_be_seen(joint: int) -> None:
    moved = motion()
    off = case(replace(moved, q=moved.q - 0.1 * np.eye(3)[joint]))
    assert list(explain_residual(off)) == []
    (zero,) = (one for one in geometry_suspects(arm()) if (one.quantity, one.joint) == ("zero", f"j{joint + 1}"))
    fit = misfit(off)
    (seen,) = fit.score_tests([zero.derivative(fit)])
    assert seen is None or seen.std > 1.0


def test_a_tilted_axis_is_found() -> None:
    tilt = 0.15
    found = list(explain_residual(case(model=arm(text(axis=(np.sin(tilt), np.cos(tilt), 0))))))
    assert {one.topic for one in found} == {"axis"}
    note = found[0].message
    assert isinstance(note, AxisTilted)
    assert abs(note.value) == pytest.approx(tilt, abs=0.03)


def test_a_model_without_frames_has_zeros_only() -> None:
    model = two_link_arm()
    assert [(one.quantity, one.joint) for one in geometry_suspects(model)] == [
        ("zero", joint.name) for joint in model.joints
    ]
    assert displace_joint(model, "joint1", np.zeros(9)) == model
