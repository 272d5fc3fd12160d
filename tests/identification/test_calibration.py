"""What torque and motion must agree on: a time offset and a tilt that were put in are found again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynident.errors import ConfigError
from dynident.estimators import LeastSquares, PhysicallyConsistent
from dynident.identification import Pairing, Recipe, find_base_tilt, find_time_offset, identify, mounted, pair
from dynident.log import Motion
from dynident.models import Model, RigidBodies, Viscous, record, simulate
from dynident.models.gallery import two_link_arm
from dynident.smoothers import Spline, TimeShifted
from tests.robots import joint, link, urdf


def swing(n: int = 4001, h: float = 0.0025) -> tuple[Model, Motion]:
    arm, t = two_link_arm(), np.arange(n) * h
    return arm, simulate(arm, arm.values, lambda s: (4 * np.sin(2 * s), 3 * np.sin(4 * s + 1)), t)


@pytest.mark.parametrize("time_offset", [0.0033, -0.0061, 0.012])
def test_a_time_offset_is_found(time_offset: float) -> None:
    arm, motion = swing()
    rng = np.random.default_rng(3)
    noisy = record(motion, 1e-5, 1e-2, rng).log
    moved = replace(noisy, q=noisy.q - motion.q + motion.shifted(-time_offset).q).window(0.1, 9.9)
    found = find_time_offset(arm, [Spline()(moved)], LeastSquares())
    assert found.seconds == pytest.approx(time_offset, abs=1e-4)
    assert found.after < 0.9 * found.before


def test_no_time_offset_is_left_alone() -> None:
    arm, motion = swing()
    noise = 0.03 * np.random.default_rng(0).standard_normal(motion.tau.shape)
    found = find_time_offset(arm, [replace(motion, tau=motion.tau + noise)], LeastSquares())
    assert found.seconds == 0.0
    assert found.after == found.before


def test_a_misfit_that_grows_to_the_end_of_the_range_is_no_time_offset() -> None:
    arm, motion = swing()
    log = replace(record(motion, 1e-5, 1e-2, np.random.default_rng(0)).log, q=motion.shifted(-0.2).q)
    assert find_time_offset(arm, [Spline()(log.window(0.5, 9.5))], LeastSquares()).seconds == 0.0


def test_a_log_too_short_for_it_has_no_time_offset() -> None:
    arm, motion = swing(40)
    found = find_time_offset(arm, [motion], LeastSquares())
    assert found.seconds == 0.0


def test_identify_takes_the_time_offset_into_account_and_says_so() -> None:
    arm, motion = swing()
    noisy = record(motion, 1e-5, 1e-2, np.random.default_rng(1)).log
    moved = replace(noisy, q=noisy.q - motion.q + motion.shifted(-0.005).q).window(0.1, 9.9)
    recipe = Recipe(smoother=(Spline(), Spline(factor=2.0)), time_offset="estimate")
    found = identify(arm, [moved], (), recipe)
    plain = identify(arm, [moved])
    assert found.calibration.time_offset is not None
    assert found.calibration.time_offset.seconds == pytest.approx(0.005, abs=1e-4)
    assert found.calibration.smoother is not None
    assert all(isinstance(one, TimeShifted) for one in found.calibration.smoother.candidates)
    assert found.validations[0].errors.relative_error < 0.7 * plain.validations[0].errors.relative_error
    np.testing.assert_allclose(found.estimate.value, arm.values, rtol=0.1)


def test_a_given_time_offset_is_used_as_it_is() -> None:
    arm, motion = swing()
    log = record(motion, 1e-5, 1e-2, np.random.default_rng(1)).log
    assert pair(arm, [log], [Spline()], 0.004, LeastSquares()) == Pairing(TimeShifted(Spline(), 0.004))


ARM = urdf(
    link("base"),
    link("shoulder", 3.0, (0.1, 0.02, 0.05)),
    link("upper", 2.0, (0.15, 0.0, 0.02)),
    link("fore", 1.0, (0.1, 0.01, 0.0)),
    joint("j1", "revolute", "base", "shoulder", axis=(0, 0, 1)),
    joint("j2", "revolute", "shoulder", "upper", xyz=(0.2, 0, 0.3), axis=(0, 1, 0)),
    joint("j3", "revolute", "upper", "fore", xyz=(0.4, 0, 0), axis=(1, 0, 0)),
)


def tilted(x: float, y: float) -> tuple[Model, Motion]:
    """An arm of three joints, its motion, and the torque that it needs where its base is tilted."""
    bodies = RigidBodies(ARM)
    model = Model((bodies, Viscous(bodies.joints)))
    rng = np.random.default_rng(5)
    n, t = len(bodies.joints), np.arange(3000) * 0.002
    phase, rate = rng.uniform(0, 6, (3, n)), rng.uniform(2, 7, (3, n))
    angle = [rate[k] * t[:, None] + phase[k] for k in range(3)]
    q, dq, ddq = (sum(parts) for parts in (
        [0.5 * np.sin(a) for a in angle],
        [0.5 * rate[k] * np.cos(a) for k, a in enumerate(angle)],
        [-0.5 * rate[k] ** 2 * np.sin(a) for k, a in enumerate(angle)],
    ))  # fmt: skip
    truth = np.array([0.3 if p.value is None else p.value for p in model.parameters])
    tau = mounted(model, x, y).torque(q, dq, ddq, truth)
    tau = tau + 0.002 * np.abs(tau).max() * rng.standard_normal(tau.shape)
    names = tuple(joint.name for joint in bodies.joints)
    return model, Motion(t, q, dq, ddq, tau, names, np.ones(len(t), bool))


@pytest.mark.parametrize("estimator", [LeastSquares(), PhysicallyConsistent()], ids=["least squares", "consistent"])
def test_a_tilt_is_found_within_its_standard_errors(estimator: LeastSquares | PhysicallyConsistent) -> None:
    model, motion = tilted(0.02, -0.035)
    found = find_base_tilt(model, [motion], estimator)
    assert found.x == pytest.approx(0.02, abs=4 * found.std[0])
    assert found.y == pytest.approx(-0.035, abs=4 * found.std[1])
    assert max(found.std) < 0.003
    assert found.after < 0.7 * found.before


def test_a_tilt_that_no_motion_shows_is_left_level() -> None:
    model, motion = tilted(0.0, 0.0)
    found = find_base_tilt(model, [motion], LeastSquares())
    assert abs(found.x) < 4 * found.std[0]
    assert abs(found.y) < 4 * found.std[1]


def test_torques_that_are_all_zero_show_no_tilt() -> None:
    model, motion = tilted(0.02, 0.0)
    found = find_base_tilt(model, [replace(motion, tau=0 * motion.tau)], LeastSquares())
    assert (found.before, found.after) == (0.0, 0.0)


def test_only_robot_files_can_tilt() -> None:
    with pytest.raises(ConfigError, match="no term has a gravity"):
        mounted(two_link_arm(), 0.1, 0.0)


def test_a_base_that_lies_on_its_side_is_not_a_tilt() -> None:
    model, motion = tilted(0.6, 0.0)
    with pytest.raises(ConfigError, match="set `gravity`, and check the zeros"):
        find_base_tilt(model, [motion], LeastSquares())


def test_gravity_turns_the_other_way() -> None:
    model, _ = tilted(0.0, 0.0)
    turned = mounted(model, 0.1, 0.0)
    np.testing.assert_allclose(turned.terms[0].gravity, 9.81 * np.array([0, -np.sin(0.1), -np.cos(0.1)]), atol=1e-12)
