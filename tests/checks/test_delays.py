"""The torque of one joint that is stamped late, or early, against those of the others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynident.checks.explain import delay_findings, robot_findings
from dynident.checks.low_pass import low_pass_findings
from dynident.checks.misfit import fit_case, misfit
from dynident.checks.motion_notes import LowPassed
from dynident.checks.robot_notes import LeftAtReversals, MissingTerm, TermKind
from dynident.motion.log import Motion
from dynident.runtime import Finding, Severity
from tests.checks.moving_arm import VALUES, arm, motion

MOVED = motion(5)


def found(moved: Motion) -> list[Finding]:
    return list(delay_findings(misfit(fit_case(arm(), [moved])), [moved]))


def with_torque(joint: int, torque: np.ndarray) -> Motion:
    tau = MOVED.tau.copy()
    tau[:, joint] = torque
    return replace(MOVED, tau=tau)


@pytest.mark.parametrize(("joint", "late"), [(0, 0.01), (2, 0.01), (2, -0.015), (2, 0.03)])
def test_the_joint_is_named_with_its_delay(joint: int, late: float) -> None:
    (one,) = found(with_torque(joint, np.interp(MOVED.t - late, MOVED.t, MOVED.tau[:, joint])))
    assert (one.severity, one.joint) == (Severity.WARNING, f"j{joint + 1}")
    assert isinstance(one.message, MissingTerm)
    assert one.message.effect is TermKind.DELAY
    assert one.message.value == pytest.approx(late, rel=0.3, abs=3 * one.message.std)
    assert one.message.std < abs(late) / 4
    assert one.message.cost < 10.0


def test_torques_in_time_are_not_named() -> None:
    assert found(MOVED) == []


def test_friction_that_follows_its_reversal_late_is_no_delay() -> None:
    """As presliding has it: the rest of the torque is in time."""
    sign = np.sign(MOVED.dq[:, 2])
    late = np.interp(MOVED.t - 0.02, MOVED.t, sign)
    assert found(with_torque(2, MOVED.tau[:, 2] + VALUES["coulomb"] * (late - sign))) == []


def test_recordings_too_short_to_be_shifted_say_nothing() -> None:
    late = with_torque(2, np.interp(MOVED.t - 0.01, MOVED.t, MOVED.tau[:, 2]))
    fit = misfit(fit_case(arm(), [late]))
    assert list(delay_findings(fit, [late])) != []
    assert list(delay_findings(fit, [replace(late, mask=MOVED.t < 0.05)])) == []


def low_passed(cutoff: float) -> Motion:
    """The motion with torques after a causal filter of first order (Hz), aligned by an offset as identify finds it."""
    share, tau = 1.0 - np.exp(-2 * np.pi * cutoff * (MOVED.t[1] - MOVED.t[0])), MOVED.tau.copy()
    for k in range(1, len(tau)):
        tau[k] = tau[k - 1] + share * (tau[k] - tau[k - 1])
    return replace(MOVED, tau=tau).shift(-0.7 / (2 * np.pi * cutoff))


@pytest.mark.parametrize("cutoff", [3.0, 5.0, 8.0])
def test_torques_after_a_low_pass_are_not_named_as_late(cutoff: float) -> None:
    (finding,) = low_pass_findings(arm(), [low_passed(cutoff)])
    assert isinstance(finding.message, LowPassed)
    assert finding.joint is None
    assert finding.message.cutoff == pytest.approx(cutoff, rel=0.35)


def test_no_joint_is_late_where_all_torques_are_low_passed() -> None:
    findings = list(robot_findings(arm(), [low_passed(5.0)], {}))
    assert [finding for finding in findings if isinstance(finding.message, LowPassed)]
    effects = {finding.message.effect for finding in findings if isinstance(finding.message, MissingTerm)}
    assert TermKind.DELAY not in effects
    assert not [finding for finding in findings if isinstance(finding.message, LeftAtReversals)]


@pytest.mark.parametrize("late", [0.0, 0.005, 0.02, 0.06])
def test_late_torques_are_not_named_as_low_passed(late: float) -> None:
    tau = np.column_stack([np.interp(MOVED.t - late, MOVED.t, x) for x in MOVED.tau.T])
    for offset in (late, 0.9 * late, 1.1 * late):
        assert list(low_pass_findings(arm(), [replace(MOVED, tau=tau).shift(-offset)])) == []
