"""The cross-validated error over the degree of smoothing."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.apps.tuning import Bench, curve
from dynident.identification import choose_smoother
from dynident.motion.smoothers import Spline
from dynident.motion.smoothers.spline import NOISE_FACTORS
from dynident.runtime import ConfigError
from tests.apps.tuning.arms import JOINTS, bench, logs, recording


def test_it_is_the_error_by_which_a_smoother_is_chosen(arm: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(curve, "DEGREES", tuple(2 * np.log10(one) for one in NOISE_FACTORS[:6]))
    monkeypatch.setattr(curve, "ROWS", 10_000)
    found = arm.curve(arm.start.with_degree(0.05))
    candidates = [Spline(factor=one) for one in NOISE_FACTORS[:6]]
    choice = choose_smoother(arm.identification.model, list(arm.logs["train"].values()), candidates)
    np.testing.assert_allclose(found.errors, choice.errors, rtol=1e-6)
    assert isinstance(choice.smoother, Spline)
    assert found.marks["torque"] == pytest.approx((2 * np.log10(choice.smoother.factor),) * 3)


def test_marks_are_what_rules_choose(arm: Bench) -> None:
    found = arm.curve(arm.start)
    assert found.marks["S = n"] == (0.0,) * 3
    assert np.abs(found.marks["GCV"]).max() < 0.2
    assert -0.7 < min(found.marks["REML"]) <= max(found.marks["REML"]) < 0.0  # its prior is rougher than sines
    assert found.joint is None
    assert (np.diff(found.degrees) > 0).all()
    assert found.errors[0] > found.errors.min() < found.errors[-1]


def test_a_joint_alone_moves_alone(arm: Bench) -> None:
    tuning = arm.start.with_degree(1.4, 0)
    found = arm.curve(tuning, JOINTS[1])
    assert found.joint == JOINTS[1]
    assert found.marks["torque"][0] == 1.4
    assert found.marks["torque"][2] == tuning.degree[2]
    assert arm.curve(tuning.with_degree(0.9, 1), JOINTS[1]) is found
    assert arm.curve(tuning) is arm.curve(arm.start)
    with pytest.raises(ConfigError, match="there is no joint 'knee'"):
        arm.curve(tuning, "knee")


def test_wide_kernels_leave_the_curve_of_a_short_log() -> None:
    on = bench(logs(recording(1, 1.5)))
    found = on.curve(on.start)
    assert found.degrees[-1] < max(curve.DEGREES)
