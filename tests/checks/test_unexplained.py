"""What is left of the torque, and no cause explains it."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.checks.explain import explain_residual, robot_findings
from dynident.checks.misfit import fit_case, misfit
from dynident.checks.missing import reversal_findings, unexplained_findings
from dynident.checks.motion_notes import OddLog
from dynident.checks.robot_notes import LeftAtReversals, MissingTerm, TermKind, Unexplained
from dynident.runtime import Severity, Use
from tests.checks.moving_arm import MOVED, T, arm, case, motion, with_torque


def after_reversals(joint: int, only: int | None = None) -> np.ndarray:
    """Three N m for 40 ms after the reversals of a joint, or after one of them."""
    turns = T[np.flatnonzero(np.diff(np.signbit(MOVED.dq[:, joint])))]
    turns = turns if only is None else turns[only : only + 1]
    since = T[:, None] - turns
    return 3.0 * ((since > 0) & (since < 0.04)).any(axis=1)


def test_a_torque_that_no_state_explains_is_said_with_its_size_last() -> None:
    foreign = 0.4 * MOVED.tau[:, 2].std() * np.sin(9.1 * T)
    *_, last = explain_residual(case(with_torque(foreign, 2)))
    assert isinstance(last.message, Unexplained)
    assert (last.severity, last.joint, last.forbids) == (Severity.WARNING, "j3", Use.SIMULATION)
    own = 100 * np.linalg.norm(foreign) / np.linalg.norm(MOVED.tau[:, 2] + foreign)
    assert last.message.joint_unexplained == pytest.approx(own, rel=0.2)


def test_what_an_odd_log_explains_is_not_left() -> None:
    odd = motion(1)
    logs = [replace(MOVED, source="a"), replace(odd, tau=odd.tau * [1.0, 1.6, 1.0], source="b")]
    assert any(isinstance(x.message, Unexplained) for x in explain_residual(fit_case(arm(), logs)))
    kinds = {type(robot_finding.message) for robot_finding in robot_findings(arm(), logs, {})}
    assert OddLog in kinds
    assert Unexplained not in kinds


@pytest.mark.parametrize("noise", [0.02, 0.3])
def test_white_noise_of_any_size_is_nothing(noise: float) -> None:
    assert list(unexplained_findings(misfit(case(motion(3, noise=noise))))) == []


@pytest.mark.parametrize("width", [0.02, 0.1])
def test_friction_that_turns_smoothly_is_no_backlash(width: float) -> None:
    velocity, sign = MOVED.dq[:, 2], np.sign(MOVED.dq[:, 2])
    smooth = with_torque(20.0 * (np.tanh(velocity / (width * velocity.std())) - sign), 2)
    for finding in reversal_findings(arm(), [smooth]):
        assert finding.severity is Severity.INFO
        assert "backlash" not in str(finding)
        assert finding.message.width == pytest.approx(width * velocity.std(), rel=0.6)


def test_a_right_arm_a_single_event_and_no_samples_leave_nothing_there() -> None:
    assert list(reversal_findings(arm(), [MOVED])) == []
    assert list(reversal_findings(arm(), [with_torque(10.0 * after_reversals(0, only=3))])) == []
    turned = np.append(np.diff(np.sign(MOVED.dq[:, 0])), 0.0)  # the sign of one sample, which noise decides
    assert list(reversal_findings(arm(), [with_torque(3.0 * turned)])) == []
    moved = with_torque(after_reversals(0))
    assert list(reversal_findings(arm(), [moved], (0.5, 0.5, 0.5))) == []
    assert list(reversal_findings(arm(), [replace(moved, mask=T < 0.005)])) == []


def test_what_a_delay_explains_is_not_said_again() -> None:
    delayed = with_torque(np.interp(T - 0.03, T, MOVED.tau[:, 2]) - MOVED.tau[:, 2], 2)
    result = [
        robot_finding.message for robot_finding in robot_findings(arm(), [delayed], {}) if robot_finding.joint == "j3"
    ]
    assert [x.effect for x in result if isinstance(x, MissingTerm)] == [TermKind.DELAY]
    assert not any(isinstance(x, LeftAtReversals) for x in result)
    (said,) = reversal_findings(arm(), [delayed])
    assert said.joint == "j3"
