"""The causes of a residual, one after the other; and none on right arms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from dynident.checks import explain
from dynident.checks.explain import explain_residual, robot_findings
from dynident.checks.robot_notes import TiltedBase
from dynident.estimators import LeastSquares
from dynident.identification import BaseTilt, find_base_tilt, tilt_base
from dynident.models import Model
from dynident.models.friction import Spring
from dynident.regression import ParallelFilter
from dynident.runtime import Severity, Step, Use, progress_to
from tests.checks.moving_arm import arm, case, motion, text, truth

MODEL = arm()


def topics(found) -> list[tuple[str, str | None]]:
    return [(one.topic, one.joint) for one in found]


@pytest.mark.parametrize("seed", range(8))
def test_a_right_arm_is_not_asked_about(seed: int) -> None:
    assert list(robot_findings(MODEL, [motion(seed)], {"other": motion(seed + 100)})) == []


@pytest.mark.parametrize("seed", range(4))
def test_noise_that_is_correlated_is_no_cause(seed: int) -> None:
    moved, rng = motion(seed, noise=0.0), np.random.default_rng([3, seed])
    noise = lfilter([np.sqrt(1 - 0.95**2)], [1, -0.95], rng.standard_normal(moved.tau.shape), axis=0)
    assert list(explain_residual(case(replace(moved, tau=moved.tau + 0.02 * moved.tau.std(axis=0) * noise)))) == []


def test_two_causes_are_both_found() -> None:
    moved = motion()
    tau = moved.tau * np.array([1.0, 1.0, 1.5])
    tau[:, 0] += 4.0 * moved.q[:, 0]
    found = topics(explain_residual(case(replace(moved, tau=tau))))
    assert sorted(found) == [("gain", "j3"), ("missing term", "j1")]


def test_what_the_data_cannot_tell_apart_is_named_with_it() -> None:
    moved = motion()
    found = next(iter(explain_residual(case(replace(moved, q=moved.q - np.array([0.0, 0.1, 0.0]))))))
    assert found.topic == "zero"  # the simplest of them
    assert {one.joint for one in found.message.others} <= {"j2", "j3"}


def test_a_tilted_base_is_named_before_the_frames_that_would_do_the_same() -> None:
    tilted = tilt_base(MODEL, 0.05, -0.04)
    moved = motion(model=tilted)
    tilt = find_base_tilt(MODEL, [moved], LeastSquares())
    (found,) = explain_residual(case(moved), tilt)
    assert (found.severity, found.topic) == (Severity.WARNING, "base tilt")
    assert isinstance(found.message, TiltedBase)
    assert (found.message.x, found.message.y) == pytest.approx((0.05, -0.04), abs=0.01)
    assert found.forbids is Use.SIMULATION


def test_a_large_fault_is_named_alone() -> None:
    moved = motion()
    swapped = replace(moved, tau=moved.tau[:, [0, 2, 1]])
    theta = truth(MODEL)
    theta[20] += 1.0
    found = robot_findings(arm(text(0.44)), [swapped], {"loaded": motion(1, theta=theta)})
    assert topics(found) == [("swapped", None)]


def test_where_no_sample_counts_nothing_is_looked_for() -> None:
    """A low-pass so slow that every sample lies near a reversal: nothing is left to explain, not even by a tilt."""
    tilt = BaseTilt(0.01, 0.01, (0.001, 0.001), 3.0, 2.0)
    slow = ParallelFilter(cutoff=0.3)
    assert list(robot_findings(arm(), [motion(1)], {"b": motion(2)}, slow, None, tilt)) == []


def test_each_cause_that_is_sought_tells_how_many_there_may_be() -> None:
    said: list[str] = []
    with progress_to(said.append):
        list(robot_findings(MODEL, [motion(1)], {}))
    steps = [one for one in said if isinstance(one, Step)]
    assert len(steps) == len(said) >= 2
    assert [one.completed for one in steps[1:]] == list(range(len(steps) - 1))
    assert all(one.total is not None and one.total > one.completed for one in steps[1:])


def test_large_faults_are_sought_without_the_terms_that_were_chosen_with_them(monkeypatch: pytest.MonkeyPatch) -> None:
    seen: list[Model] = []
    monkeypatch.setattr(explain, "better_alternative", lambda case: seen.append(case.model) or ())
    chosen = MODEL.with_terms(Spring(MODEL.joints, order=2))
    list(robot_findings(chosen, [motion(1)], {}, plain=MODEL))
    list(robot_findings(chosen, [motion(1)], {}))
    assert seen[0] is MODEL
    assert seen[1] is chosen
