"""What is known of a robot before it moves."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import dynident as dy
from dynident.apps.excitation.config import (
    NoiseOrigin,
    PriorKnowledge,
    knowledge_of_result,
    nominal_knowledge,
    torque_noise,
)
from dynident.models import Model, RigidBodies
from dynident.models.friction import Coulomb, Viscous
from dynident.models.lagrangian import pendulum
from dynident.runtime import ModelError
from tests.apps.excitation.arms import LIMITS, MODEL, THETA, TWO


def test_friction_is_that_of_the_robot_file_where_it_says_any() -> None:
    rusty = TWO.replace('<limit effort="40"', '<dynamics damping="0.7" friction="0.3"/><limit effort="40"')
    bodies = RigidBodies(rusty, source="two.urdf")
    found = nominal_knowledge(Model((bodies, Viscous(bodies.joints, on=("lift",)), Coulomb(bodies.joints))))
    assert bodies.damping == {"lift": 0.7}
    np.testing.assert_array_equal(found.theta[:20], THETA[:20])
    np.testing.assert_array_equal(found.theta[20:], [0.7, 0.3, 0.0])


def test_a_body_without_inertia_is_named() -> None:
    odd = [replace(one, value=None) if one.body == "lower" else one for one in MODEL.parameters]
    unknown: Any = SimpleNamespace(parameters=odd, name="two.urdf", terms=())
    with pytest.raises(ModelError, match=r"two.urdf: the inertia of lower is not in the robot file"):
        nominal_knowledge(unknown)


def residual(size: float, decorrelation: float) -> Any:
    return SimpleNamespace(
        role="train",
        errors=SimpleNamespace(rmse={"lift": size, "bend": 2 * size}),
        residuals={"lift": SimpleNamespace(decorrelation=decorrelation), "bend": SimpleNamespace(decorrelation=np.nan)},
    )


def test_a_correlated_residual_counts_as_many_samples_as_are_independent() -> None:
    held = SimpleNamespace(role="validation", errors=None, residuals=None)
    found: Any = SimpleNamespace(validations=[residual(0.1, 0.04), held, residual(0.3, 0.04)])
    known = PriorKnowledge(MODEL, THETA, found, NoiseOrigin.RESULT)
    mean = np.sqrt((0.1**2 + 0.3**2) / 2)
    for rate, factor in ((100.0, 2.0), (400.0, 4.0), (10.0, 1.0)):
        origin, sigma = torque_noise(known, None, LIMITS, 0.1, rate)
        assert origin is NoiseOrigin.RESULT
        np.testing.assert_allclose(sigma, [mean * factor, 2 * mean])


def test_a_joint_without_a_residual_has_the_noise_of_the_rule() -> None:
    found: Any = SimpleNamespace(validations=[residual(0.0, 0.0)])
    _, sigma = torque_noise(PriorKnowledge(MODEL, THETA, found, NoiseOrigin.RESULT), None, LIMITS, 0.1, 100.0)
    np.testing.assert_allclose(sigma, [0.4, 0.15])
    free = replace(LIMITS, torque=np.array([np.inf, 9.0]))
    _, sigma = torque_noise(PriorKnowledge(MODEL, THETA), None, free, 0.1, 100.0)
    np.testing.assert_allclose(sigma, [1.0, 0.1])


def test_the_information_of_a_result_gives_its_standard_errors() -> None:
    arm = pendulum()
    motion = dy.simulate(arm, arm.values, lambda s: [np.sin(5 * s)], np.arange(501) * 0.01)
    log = dy.record(motion, sigma_q=1e-4, sigma_tau=1e-2, rng=np.random.default_rng(0)).log
    found = dy.identify(arm, log)
    known = knowledge_of_result(found)
    assert known.information is not None
    covariance = np.linalg.inv(known.information)
    np.testing.assert_allclose(covariance, found.errors.base_covariance, rtol=1e-6)
    np.testing.assert_allclose(np.sqrt(np.diag(covariance)), found.errors.std, rtol=0.01)
    old = replace(found, errors=replace(found.errors, base_covariance=None))
    assert knowledge_of_result(old).information is None
    assert "identify again" in knowledge_of_result(old).loss_reason
