"""Torques after a low-pass are named as such, and late ones are not."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.checks.explain import robot_findings
from dynident.checks.low_pass import low_pass_findings
from dynident.checks.motion_notes import LowPassed
from dynident.checks.robot_notes import LeftAtReversals, MissingTerm, TermKind
from dynident.motion.log import Motion
from tests.checks.moving_arm import arm, motion

MOVED = motion()


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


@pytest.mark.parametrize("delay", [0.0, 0.02, 0.06])
def test_late_torques_are_not_named_as_low_passed(delay: float) -> None:
    tau = np.column_stack([np.interp(MOVED.t - delay, MOVED.t, x) for x in MOVED.tau.T])
    for offset in (delay, 0.9 * delay, 1.1 * delay):
        assert list(low_pass_findings(arm(), [replace(MOVED, tau=tau).shift(-offset)])) == []
