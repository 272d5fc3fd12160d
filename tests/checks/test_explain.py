"""The causes of a residual, one after the other; and none on right arms."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from dynident.checks.explain import explain_residual, robot_findings
from dynident.checks.robot_notes import TiltedBase
from dynident.identification import BaseTilt, tilt_base
from dynident.regression import ParallelFilter
from dynident.runtime import Severity, Step, Use, progress_to
from tests.checks.moving_arm import MOVED, arm, case, motion, swap_torques, text, truth

MODEL = arm()


def topics(result) -> list[tuple[str, str | None]]:
    return [(x.topic, x.joint) for x in result]


@pytest.mark.parametrize("seed", range(3))
def test_a_right_arm_is_not_asked_about_and_the_search_says_how_far_it_is(seed: int) -> None:
    said: list[str] = []
    with progress_to(said.append):
        assert list(robot_findings(MODEL, [motion(seed)], {"other": motion(seed + 100)})) == []
    steps = [step for step in said if isinstance(step, Step)]
    assert len(steps) == len(said) >= 2
    assert [step.completed for step in steps[1:]] == list(range(len(steps) - 1))
    assert all(step.total is not None and step.total > step.completed for step in steps[1:])


@pytest.mark.parametrize("seed", range(2))
def test_noise_that_is_correlated_is_no_cause(seed: int) -> None:
    moved, rng = motion(seed, noise=0.0), np.random.default_rng([3, seed])
    noise = lfilter([np.sqrt(1 - 0.95**2)], [1, -0.95], rng.standard_normal(moved.tau.shape), axis=0)
    assert list(explain_residual(case(replace(moved, tau=moved.tau + 0.02 * moved.tau.std(axis=0) * noise)))) == []


def test_a_tilted_base_is_named_before_the_frames_that_would_do_the_same() -> None:
    tilted = tilt_base(MODEL, 0.05, -0.04)
    moved = motion(model=tilted)
    tilt = BaseTilt(0.05, -0.04, (1e-3, 1e-3), 5.0, 2.0)
    (result,) = explain_residual(case(moved), tilt)
    assert (result.severity, result.topic) == (Severity.WARNING, "base tilt")
    assert isinstance(result.message, TiltedBase)
    assert (result.message.x, result.message.y) == pytest.approx((0.05, -0.04), abs=0.01)
    assert result.forbids is Use.SIMULATION


def test_a_large_fault_is_named_alone() -> None:
    theta = truth(MODEL)
    theta[20] += 1.0
    result = robot_findings(arm(text(0.44)), [swap_torques(MOVED)], {"loaded": motion(1, theta=theta)})
    assert topics(result) == [("swapped", None)]


def test_where_no_sample_counts_nothing_is_looked_for() -> None:
    """A low-pass so slow that every sample lies near a reversal: nothing is left to explain, not even by a tilt."""
    tilt = BaseTilt(0.01, 0.01, (0.001, 0.001), 3.0, 2.0)
    slow = ParallelFilter(cutoff=0.3)
    assert list(robot_findings(arm(), [motion(1)], {"b": motion(2)}, slow, None, tilt)) == []
