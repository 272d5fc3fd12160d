"""What motions show, with motions whose speeds, turns and limits are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynident.checks import ExcitedRank, motion_notes
from dynident.checks.motion import excitation, excited_rank, hardly_moving_findings, limit_findings, rank_findings
from dynident.models import Joint, Model, RotorInertia
from dynident.models.friction import Offset, Viscous
from dynident.models.lagrangian import slider
from dynident.models.robot_files import RobotJointLimits
from dynident.motion.log import Motion
from dynident.regression import Regression
from dynident.runtime import Note

T = np.arange(0, 4 * np.pi, 0.002)


def motion(amplitude: float = 0.5, rate: float = 2.0, tau: float = 3.0) -> Motion:
    q, dq, ddq = (
        amplitude * np.sin(rate * T),
        amplitude * rate * np.cos(rate * T),
        -amplitude * rate**2 * np.sin(rate * T),
    )
    return Motion(T, *(x[:, None] for x in (q, dq, ddq, tau * np.cos(T))), ("a",), np.ones(len(T), bool))


def test_the_facts_are_those_of_a_sine() -> None:
    found = excitation([motion()], "a")
    assert (found.lower, found.upper) == pytest.approx((-0.5, 0.5), rel=1e-3)
    assert (found.peak_speed, found.rms_speed) == pytest.approx((1.0, np.sqrt(0.5)), rel=1e-2)
    assert (found.peak_acceleration, found.rms_acceleration) == pytest.approx((2.0, np.sqrt(2)), rel=1e-2)
    assert found.reversals == 8
    assert found.slow == pytest.approx(2 * np.arcsin(0.02) / np.pi, rel=0.1)
    assert excitation([motion(), motion()], "a").reversals == 16


def test_only_usable_samples_count() -> None:
    part = replace(motion(), mask=np.less(T, np.pi))
    assert excitation([part], "a").reversals == 2


WIDE = RobotJointLimits(effort=10, velocity=2, lower=-1, upper=1)
CASES = {
    "inside": (motion(), WIDE, []),
    "no limits": (motion(40, 5, 500), None, []),
    "position": (motion(), replace(WIDE, upper=0.2), ["position limit"]),
    "velocity": (motion(), replace(WIDE, velocity=0.5), ["velocity limit"]),
    "effort": (motion(), replace(WIDE, effort=2), ["effort limit"]),
    "far too much": (motion(tau=3000), WIDE, ["effort limit"]),
    "far too little": (motion(tau=1e-3), WIDE, ["effort limit"]),
    "one turn": (motion(0.5, 0.2), WIDE, ["reversals"]),
}


@pytest.mark.parametrize(("moved", "limits", "topics"), CASES.values(), ids=CASES)
def test_limits(moved: Motion, limits: RobotJointLimits | None, topics: list[str]) -> None:
    assert [one.topic for one in limit_findings(excitation([moved], "a"), limits, "N m")] == topics


def test_the_figures_are_those_of_the_motion_and_the_limits() -> None:
    def note(moved: Motion, limits: RobotJointLimits) -> Note:
        return next(limit_findings(excitation([moved], "a"), limits, "N m")).message

    low, high = (pytest.approx(x, rel=1e-3) for x in (-0.5, 0.5))
    assert note(motion(), replace(WIDE, upper=0.2)) == motion_notes.PositionBeyondLimits(low, high, -1, 0.2)
    motor = note(motion(5.0), replace(WIDE, velocity=None))
    assert isinstance(motor, motion_notes.PositionBeyondLimits)
    assert motor.far
    assert note(motion(), replace(WIDE, velocity=0.5)) == motion_notes.VelocityAboveLimit(
        pytest.approx(1.0, rel=1e-3), 0.5
    )
    assert note(motion(0.5, 0.2), WIDE) == motion_notes.FewReversals(1)


def test_a_joint_that_its_controller_holds_is_named() -> None:
    t = np.arange(1001) * 0.01
    q = np.column_stack([np.sin(t), 0.7 + 1e-3 * np.sin(9 * t), 0.02 * np.sin(3 * t), np.full(t.shape, 0.1)])
    model = Model((Offset(tuple(map(Joint, "abcd"))),))
    moved = Motion(t, q, np.gradient(q, t, axis=0), np.zeros(q.shape), np.ones(q.shape), tuple("abcd"), t >= 0)
    (found,) = hardly_moving_findings([excitation([moved], joint) for joint in "abcd"], model)
    assert (found.joint, found.topic) == ("b", "still")
    assert found.message == motion_notes.HardlyMoves(
        pytest.approx(2e-3, rel=0.01), pytest.approx(2.0, rel=0.01), pytest.approx(0.7), "rad"
    )


def test_a_current_is_suspected_only_far_beyond_the_limit() -> None:
    def note(tau: float) -> Note:
        return next(limit_findings(excitation([motion(tau=tau)], "a"), WIDE, "N m")).message

    far, near, below = map(note, (300, 12, 1e-3))
    assert far == motion_notes.EffortAboveLimit(pytest.approx(300, rel=0.01), 10, "N m", far=True)
    assert near == motion_notes.EffortAboveLimit(pytest.approx(12, rel=0.01), 10, "N m", far=False)
    assert below == motion_notes.EffortFarBelowLimit(pytest.approx(1e-3, rel=0.01), 10, "N m")


def test_what_is_not_excited_is_named_with_the_joint_to_move() -> None:
    joints = tuple(map(Joint, "ab"))
    model = Model((RotorInertia(joints), Viscous(joints)))
    q, dq, ddq = np.random.default_rng(0).standard_normal((3, 500, 2))
    full = Motion(np.arange(500.0), q, dq, ddq, np.zeros_like(q), ("a", "b"), np.ones(500, bool))
    held = replace(full, q=q * [1, 0], dq=dq * [1, 0], ddq=ddq * [1, 0])
    good, poor = (excited_rank(model, Regression(model, (one,))) for one in (full, held))
    assert good.on_data == good.structural == good.count
    assert list(rank_findings(good)) == []
    assert poor.on_data < poor.structural
    told = list(rank_findings(poor))
    assert told
    assert [one.message for one in told] == list(poor.missing)
    assert all(one.joints == ("b",) for one in poor.missing)


def test_a_bad_condition_is_said_where_nothing_is_missing() -> None:
    (found,) = rank_findings(ExcitedRank(6, 5, 5, 1e6, ()))
    assert (found.topic, found.message) == ("condition", motion_notes.CorrelatedParameters(5, 1e6))
    assert list(rank_findings(ExcitedRank(5, 5, 5, 1e3, ()))) == []


def test_a_slider_is_well_excited_by_a_sine() -> None:
    moved = replace(motion(), joints=(slider().joints[0].name,))
    assert excited_rank(slider(), Regression(slider(), (moved,))).condition < 10
