"""What motions show, with motions whose speeds, turns and limits are known."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.checks import ExcitedRank, motion_notes
from dynident.checks.motion import excitation, excited_rank, hardly_moving_findings, limit_findings, rank_findings
from dynident.models import Joint, Model, RotorInertia
from dynident.models.friction import Offset, Viscous
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
    result = excitation([motion()], "a")
    assert (result.lower, result.upper) == pytest.approx((-0.5, 0.5), rel=1e-3)
    assert (result.peak_speed, result.rms_speed) == pytest.approx((1.0, np.sqrt(0.5)), rel=1e-2)
    assert (result.peak_acceleration, result.rms_acceleration) == pytest.approx((2.0, np.sqrt(2)), rel=1e-2)
    assert result.reversals == 8
    assert result.slow == pytest.approx(2 * np.arcsin(0.02) / np.pi, rel=0.1)
    assert excitation([motion(), motion()], "a").reversals == 16


WIDE = RobotJointLimits(effort=10, velocity=2, lower=-1, upper=1)


def near(value: float) -> object:
    return pytest.approx(value, rel=0.01)


def effort(tau: float, *, far: bool) -> motion_notes.EffortAboveLimit:
    return motion_notes.EffortAboveLimit(near(tau), 10, "N m", far=far)


BEYOND = motion_notes.PositionBeyondLimits
CASES = {
    "inside": (motion(), WIDE, None),
    "a whole turn away": (replace(motion(), q=motion().q + 2 * np.pi), WIDE, None),
    "a zero in degrees": (replace(motion(), q=motion().q + 44), WIDE, BEYOND(near(43.5), near(44.5), -1, 1)),
    "no limits": (motion(40, 5, 500), None, None),
    "position": (motion(), replace(WIDE, upper=0.2), BEYOND(near(-0.5), near(0.5), -1, 0.2)),
    "position of a motor": (motion(12), replace(WIDE, velocity=None), BEYOND(near(-12), near(12), -1, 1, far=True)),
    "velocity": (motion(), replace(WIDE, velocity=0.5), motion_notes.VelocityAboveLimit(near(1.0), 0.5)),
    "effort": (motion(tau=12), WIDE, effort(12, far=False)),
    "a current": (motion(tau=300), WIDE, effort(300, far=True)),
    "far too little": (motion(tau=1e-3), WIDE, motion_notes.EffortFarBelowLimit(near(1e-3), 10, "N m")),
    "one turn": (motion(0.5, 0.2), WIDE, motion_notes.FewReversals(1)),
}


@pytest.mark.parametrize(("moved", "limits", "note"), CASES.values(), ids=CASES)
def test_limits_that_are_exceeded_are_said_with_their_figures(
    moved: Motion, limits: RobotJointLimits | None, note: Note | None
) -> None:
    notes = [limit_finding.message for limit_finding in limit_findings(excitation([moved], "a"), limits, Joint("a"))]
    assert notes == ([] if note is None else [note])


def test_a_joint_that_its_controller_holds_is_named() -> None:
    t = np.arange(1001) * 0.01
    q = np.column_stack([np.sin(t), 0.7 + 1e-3 * np.sin(9 * t), 0.02 * np.sin(3 * t), np.full(t.shape, 0.1)])
    model = Model((Offset(tuple(map(Joint, "abcd"))),))
    moved = Motion(t, q, np.gradient(q, t, axis=0), np.zeros(q.shape), np.ones(q.shape), tuple("abcd"), t >= 0)
    (result,) = hardly_moving_findings([excitation([moved], joint) for joint in "abcd"], model)
    assert (result.joint, result.topic) == ("b", "still")
    assert result.message == motion_notes.HardlyMoves(
        pytest.approx(2e-3, rel=0.01), pytest.approx(2.0, rel=0.01), pytest.approx(0.7), "rad"
    )


def test_what_is_not_excited_is_named_with_the_joint_to_move() -> None:
    joints = tuple(map(Joint, "ab"))
    model = Model((RotorInertia(joints), Viscous(joints)))
    q, dq, ddq = np.random.default_rng(0).standard_normal((3, 500, 2))
    full = Motion(np.arange(500.0), q, dq, ddq, np.zeros_like(q), ("a", "b"), np.ones(500, bool))
    held = replace(full, q=q * [1, 0], dq=dq * [1, 0], ddq=ddq * [1, 0])
    good, poor = (excited_rank(model, Regression(model, (x,))) for x in (full, held))
    assert good.on_data == good.structural == good.count
    assert list(rank_findings(good)) == []
    assert poor.on_data < poor.structural
    told = list(rank_findings(poor))
    assert told
    assert [x.message for x in told] == list(poor.missing)
    assert all(x.joints == ("b",) for x in poor.missing)


def test_a_bad_condition_is_said_where_nothing_is_missing() -> None:
    (result,) = rank_findings(ExcitedRank(6, 5, 5, 1e6, ()))
    assert (result.topic, result.message) == ("condition", motion_notes.CorrelatedParameters(5, 1e6))
    assert list(rank_findings(ExcitedRank(5, 5, 5, 1e3, ()))) == []
