"""Gains, gears, zeros, lengths, axes and clocks that are wrong: found with joint, value and cost, or not to be seen."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dynident.checks.explain import explain_residual
from dynident.checks.misfit import misfit
from dynident.checks.robot_notes import AxisTilted, ClockWrong, LengthWrong, PositionGear, TorqueGain, ZeroOff
from dynident.checks.suspects import _perpendicular_axes, gain_suspects, geometry_suspects
from dynident.models.lagrangian import slider
from dynident.motion.log import Motion
from dynident.runtime import Finding
from tests.checks.moving_arm import MOVED, arm, case, motion, text
from tests.kept import check_kept


def test_axes_across_another_are_unit_vectors_perpendicular_to_it() -> None:
    axis = np.array([0.48, 0.6, 0.64])
    axes = np.array([axis, *_perpendicular_axes(axis)])
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)


def on_joint(joint: int, value: float, others: float = 1.0) -> np.ndarray:
    return np.where(np.arange(3) == joint, value, others)


def scale_torque(joint: int, gain: float) -> Motion:
    return replace(MOVED, tau=on_joint(joint, gain) * MOVED.tau)


def turn_faster(joint: int, factor: float) -> Motion:
    factors = on_joint(joint, factor)
    return replace(MOVED, q=factors * MOVED.q, dq=factors * MOVED.dq, ddq=factors * MOVED.ddq)


def move_zero(joint: int, angle: float = 0.1) -> Motion:
    return replace(MOVED, q=MOVED.q - on_joint(joint, angle, 0.0))


def stamp(rate: float) -> Motion:
    """The motion where a second of the stamps is ``rate`` seconds."""
    return replace(MOVED, dq=rate * MOVED.dq, ddq=rate**2 * MOVED.ddq)


FAULTS = {  # the note, its joint, the right value, the largest standard error, and the case
    "gain 2": (TorqueGain, "j2", 2.0, 0.1, lambda: case(scale_torque(1, 2.0))),
    "gain 1.1": (TorqueGain, "j2", 1.1, 0.055, lambda: case(scale_torque(1, 1.1))),
    "gain 0.5": (TorqueGain, "j3", 0.5, 0.025, lambda: case(scale_torque(2, 0.5))),
    "gear 1.2": (PositionGear, "j1", 1 / 1.2, 0.02, lambda: case(turn_faster(0, 1.2))),
    "gear 0.8": (PositionGear, "j2", 1 / 0.8, 0.02, lambda: case(turn_faster(1, 0.8))),
    "gear 1.05": (PositionGear, "j3", 1 / 1.05, 0.02, lambda: case(turn_faster(2, 1.05))),
    "length 0.44": (LengthWrong, "j3", 0.4, 0.01, lambda: case(motion(noise=0.004), arm(text(0.44)))),
    "length 0.2": (LengthWrong, "j3", 0.4, 0.01, lambda: case(motion(noise=0.004), arm(text(0.2)))),
    "zero": (ZeroOff, "j2", 0.1, 0.05, lambda: case(move_zero(1))),
    "zero of another frame": (ZeroOff, "j2", 0.8, 0.05, lambda: case(move_zero(1, 0.8))),
    "clock": (ClockWrong, None, 1.25, 0.03, lambda: case(stamp(1.25))),
}


@cache
def explained(name: str) -> list[Finding]:
    return list(explain_residual(FAULTS[name][-1]()))


@pytest.mark.parametrize("name", FAULTS)
def test_a_wrong_value_is_found_with_its_joint(name: str) -> None:
    kind, joint, value, max_std, _ = FAULTS[name]
    finding, *more = explained(name)
    note = finding.message
    assert (type(note), finding.joint) == (kind, joint)
    assert note.value == pytest.approx(value, abs=max(4 * note.std, 0.1 * (kind is ClockWrong)))
    assert note.std < max_std
    if kind is ZeroOff:  # the simplest of what the data cannot tell apart
        assert {rival.joint for rival in note.others} <= {"j2", "j3"}
    else:
        assert more == []
    if kind is LengthWrong:
        assert (note.component, note.given) == ("x", float(name.split()[1]))


def test_a_gain_of_all_joints_cannot_be_seen() -> None:
    assert list(explain_residual(case(replace(MOVED, tau=1.1 * MOVED.tau)))) == []
    assert gain_suspects(slider()) == []


@pytest.mark.parametrize("joint", [0, 2])
def test_the_zeros_of_a_vertical_and_of_the_last_axis_cannot_be_seen(joint: int) -> None:
    off = case(move_zero(joint))
    assert list(explain_residual(off)) == []
    (zero,) = (x for x in geometry_suspects(arm()) if (x.quantity, x.joint) == ("zero", f"j{joint + 1}"))
    fit = misfit(off)
    (seen,) = fit.score_tests([zero.derivative(fit)])
    assert seen is None or seen.std > 1.0


def test_a_tilted_axis_is_found() -> None:
    tilt = 0.15
    notes = [x.message for x in explain_residual(case(model=arm(text(axis=(np.sin(tilt), np.cos(tilt), 0)))))]
    assert {type(note) for note in notes} == {AxisTilted}
    assert abs(notes[0].value) == pytest.approx(tilt, abs=0.03)


def test_friction_that_is_different_at_low_speed_at_all_joints_is_no_clock() -> None:
    speed = np.sqrt(np.mean(MOVED.dq**2, axis=0))
    stribeck = 4.0 * np.exp(-((MOVED.dq / (0.2 * speed)) ** 2)) * np.sign(MOVED.dq)
    kinds = {type(x.message) for x in explain_residual(case(replace(MOVED, tau=MOVED.tau + stribeck)))}
    assert kinds
    assert ClockWrong not in kinds


def test_all_that_is_said_of_faults_stays() -> None:
    check_kept("wrong_values", "\n".join(f"{name}: {finding}" for name in FAULTS for finding in explained(name)))
