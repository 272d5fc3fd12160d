"""What could be reached: against least squares, with better sensors and longer records, for bodies, and its noise."""

from functools import cache

import numpy as np
import pytest

from dynident.estimators import LeastSquares
from dynident.identification import CHANGES, AccuracyBound, Measure, Origin, Recipe, accuracy_bound, noise_of
from dynident.models import Model, RigidBodies
from dynident.models.friction import Viscous
from dynident.models.lagrangian import pendulum
from dynident.models.simulation import record, simulate
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import Spline
from dynident.runtime import ConfigError
from tests.robots import ARM


@cache
def swinging() -> Motion:
    model, t = pendulum(), np.arange(1001) * 0.005
    return simulate(model, model.values, lambda s: [np.sin(5 * s) + np.cos(2 * s)], t, tolerance=1e-9)


def swing(seed: int = 0, sigma_q: float = 1e-4, sigma_tau: float = 0.05) -> tuple[Model, Log]:
    return pendulum(), record(swinging(), sigma_q, sigma_tau, np.random.default_rng(seed), f"swing {seed}").log


@cache
def arm() -> AccuracyBound:
    bodies = RigidBodies(ARM)
    model = Model((bodies, Viscous(bodies.joints)))
    theta, t = np.array([1.0 if x.value is None else x.value for x in model.parameters]), np.arange(801) * 0.005
    motion = simulate(
        model, theta, lambda s: [8 * np.sin(3 * s), 12 * np.cos(5 * s), 0.6 * np.sin(4 * s)], t, tolerance=1e-8
    )
    log = record(motion, 1e-7, 0.02, np.random.default_rng(0), "arm").log
    recipe = Recipe(Spline(sigma=1e-7), LeastSquares(weights="per_joint"))
    sigma = accuracy_bound(model, [log], recipe).identification.estimate.residual.sigma  # that of its standard errors
    return accuracy_bound(model, [log], recipe, sigma_tau=dict(zip(log.joints, sigma.tolist(), strict=True)))


def test_a_record_of_known_motion_reaches_what_least_squares_says() -> None:
    model, log = swing(sigma_q=1e-7)
    bound = accuracy_bound(model, [log])
    np.testing.assert_allclose(bound.std["now"], bound.identification.estimate.std, rtol=0.02)
    assert (bound.position_share < 0.01).all()
    assert bound.alone.all()
    assert bound.names == model.names


def test_what_is_bought() -> None:
    model, log = swing(sigma_q=1e-3)
    bound = accuracy_bound(model, [log])
    np.testing.assert_allclose(bound.std["longer"], bound.std["now"] / 2, rtol=1e-9)
    np.testing.assert_allclose(bound.std["twice"], bound.std["now"] / np.sqrt(2), rtol=1e-9)
    for change in CHANGES:
        assert (bound.std[change] <= bound.std["now"] * (1 + 1e-9)).all()
    assert (bound.std["bit"] >= bound.std["now"] / 2 * (1 - 1e-9)).all()  # half the noise cannot do more
    assert (bound.std["torque"] >= bound.std["now"] / 10 * (1 - 1e-9)).all()
    assert ((bound.position_share > 0) & (bound.position_share < 1)).all()
    assert (bound.inflation >= 1 - 1e-9).all()


def test_two_logs_tell_as_much_as_one_twice_as_long() -> None:
    model, log = swing()
    bound = accuracy_bound(model, [log], sigma_q=1e-4, sigma_tau=0.05)
    two = accuracy_bound(model, {"a": log, "b": log}, sigma_q=1e-4, sigma_tau=0.05)
    np.testing.assert_allclose(two.std["now"], bound.std["twice"], rtol=1e-9)
    assert two.samples == 2 * bound.samples


def test_a_robot_of_bodies_has_bounds_of_its_base_parameters() -> None:
    test_arm = arm()
    basis = test_arm.identification.base.on_data
    assert test_arm.names == basis.groupings
    assert len(test_arm.names) < len(test_arm.identification.model.parameters)
    assert not test_arm.alone.all()
    assert np.isfinite(test_arm.std["now"]).all()
    # the motion is known but for the accelerations at both ends, which tell much of a few parameters here
    ratio = test_arm.identification.errors.base_std_independent / test_arm.std["now"]
    assert (ratio < 1.01).all()
    assert np.median(ratio) == pytest.approx(1.0, abs=0.02)


def test_the_noise_of_the_sensors_is_found() -> None:
    model, log = swing(sigma_q=1e-4, sigma_tau=0.05)
    bound = accuracy_bound(model, [log])
    noise = noise_of(bound.identification, [log], "sensor")
    np.testing.assert_allclose(noise.q, 1e-4, rtol=0.15)
    np.testing.assert_allclose(noise.tau, 0.05, rtol=0.15)
    np.testing.assert_allclose(bound.noise.tau, 0.05, rtol=0.15)
    assert (noise.positions, noise.torques) == (Origin(Measure.SCATTER), Origin(Measure.SCATTER))
    assert bound.noise.torques == Origin(Measure.RESIDUAL)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"sigma_q": {"elbw": 1.0}}, "sigma_q: there is no joint 'elbw'"),
        ({"sigma_tau": 0.0}, "sigma_tau of .* is 0.0; give a positive number"),
        ({"sigma_q": float("nan")}, "sigma_q of .* is nan"),
    ],
)
def test_what_cannot_be_noise(options: dict, words: str) -> None:
    model, log = swing()
    with pytest.raises(ConfigError, match=words):
        accuracy_bound(model, [log], **options)
