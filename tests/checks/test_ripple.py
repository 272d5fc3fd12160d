"""The period and phase of a ripple, in the residual of a fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynident.checks.misfit import misfit
from dynident.checks.suspects import find_ripple
from tests.checks.moving_arm import case, motion

MOVED = motion()


def cogging(rate: float, phase: float = 0.7, joint: int = 0):
    tau = MOVED.tau.copy()
    tau[:, joint] += 0.5 * np.sin(rate * MOVED.q[:, joint] + phase)
    return misfit(case(replace(MOVED, tau=tau)))


@pytest.mark.parametrize(("rate", "joint"), [(17.3, 0), (24.0, 1), (21.5, 2)])
def test_the_period_and_the_phase_are_found(rate: float, joint: int) -> None:
    fit = cogging(rate, joint=joint)
    period, column = find_ripple(fit, joint)
    assert period == pytest.approx(2 * np.pi / rate, rel=0.01)
    assert np.abs(column).max() <= 1.0 + 1e-12
    assert np.corrcoef(column, np.sin(rate * fit.case.q[:, joint] + 0.7))[0, 1] > 0.98
    assert all(find_ripple(fit, j) is None for j in range(3) if j != joint)


def test_a_right_arm_has_none() -> None:
    fit = misfit(case(MOVED))
    assert [find_ripple(fit, j) for j in range(3)] == [None] * 3


def test_what_is_too_fast_for_the_low_pass_or_seen_but_once_is_none() -> None:
    assert find_ripple(cogging(200.0), 0) is None
    assert find_ripple(cogging(2 * np.pi / np.ptp(MOVED.q[:, 0])), 0) is None


def test_a_joint_that_stands_or_does_not_count_has_none() -> None:
    fit = cogging(17.3)
    still = fit.case.q * [0.0, 1.0, 1.0]
    assert find_ripple(replace(fit, case=replace(fit.case, q=still)), 0) is None
    assert find_ripple(replace(fit, weight=np.zeros_like(fit.weight)), 0) is None
    assert find_ripple(replace(fit, residual=np.zeros_like(fit.residual)), 0) is None
