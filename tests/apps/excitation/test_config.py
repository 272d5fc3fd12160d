"""What is asked and known before a robot moves: settings, limits, noise and information."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dynident.apps.excitation.config import (
    ExcitationSettings,
    NoiseOrigin,
    PriorKnowledge,
    nominal_knowledge,
    settings_in,
    torque_noise,
)
from dynident.models import Model, RigidBodies
from dynident.models.friction import Coulomb, Viscous
from dynident.project.config import parse_config
from dynident.project.fields import read_settings
from dynident.runtime import ConfigError, ModelError
from tests.apps.excitation.arms import LIMITS, MODEL, THETA, TWO
from tests.project.configurations import changed

BOX = {"name": "table", "centre": [0, 0, 0], "size": [1, 1, 1]}


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"duratoin": 3}, "unknown key 'duratoin'; did you mean 'duration'"),
        ({"duration": 0}, "duration: a number from 0.1 to 3600 s"),
        ({"program": "dance"}, "program: 'dance' is not a choice"),
        ({"parameters": ["m"]}, "`parameters`, those that matter, go with `criterion: a`"),
        ({"seed": -1}, "seed: a whole number of at least 0"),
        ({"limits": {"j": {"lower": 1, "upper": -1}}}, "limits.j: `lower` must be below `upper`, but 1 >= -1"),
        ({"limits": {"j": {"speed": 1}}}, "limits.j: unknown key 'speed'"),
        ({"boxes": [{**BOX, "size": [1, 1, 0]}]}, "boxes[0].size[2]: a number greater than 0"),
        ({"boxes": [BOX, BOX]}, "two of `boxes` and `cylinders` have the name 'table'"),
        (
            {"cylinders": [{"name": "post", "centre": [0, 0], "radius": 1, "bottom": 2, "top": 1}]},
            "`bottom` must be below `top`",
        ),
    ],
)
def test_a_wrong_setting_is_named(given: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError) as caught:
        read_settings(ExcitationSettings, given, "arm.yaml: excitation")
    assert str(caught.value).startswith("arm.yaml: excitation: ")
    assert words in str(caught.value)


def test_the_section_of_a_file() -> None:
    assert settings_in({"excitation": {"duration": 3}}, "x", alone=True) == {"duration": 3}
    assert settings_in({"duration": 3}, "x", alone=True) == {"duration": 3}
    assert settings_in({"model": "a.urdf", "excitation": None}, "x", alone=False) == {}
    for data, alone in (({"excitation": [1]}, False), ([1], True)):
        with pytest.raises(ConfigError, match="a mapping of settings"):
            settings_in(data, "x", alone=alone)


def test_a_configuration_may_hold_them() -> None:
    config = parse_config(changed(excitation={"duration": 12, "limits": {"slider": {"velocity": 0.2}}}))
    assert config.excitation is not None
    assert (config.excitation.duration, config.excitation.limits["slider"].velocity) == (12, 0.2)
    with pytest.raises(ConfigError, match=r"excitation.duration: a number from 0.1"):
        parse_config(changed(excitation={"duration": -1}))


def test_friction_is_that_of_the_robot_file_where_it_says_any() -> None:
    rusty = TWO.replace('<limit effort="40"', '<dynamics damping="0.7" friction="0.3"/><limit effort="40"')
    bodies = RigidBodies(rusty, source="two.urdf")
    result = nominal_knowledge(Model((bodies, Viscous(bodies.joints, on=("lift",)), Coulomb(bodies.joints))))
    assert bodies.damping == {"lift": 0.7}
    np.testing.assert_array_equal(result.theta[:20], THETA[:20])
    np.testing.assert_array_equal(result.theta[20:], [0.7, 0.3, 0.0])


def test_a_body_without_inertia_is_named() -> None:
    odd = [replace(parameter, value=None) if parameter.body == "lower" else parameter for parameter in MODEL.parameters]
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
    result: Any = SimpleNamespace(validations=[residual(0.1, 0.04), held, residual(0.3, 0.04)])
    reference = PriorKnowledge(MODEL, THETA, result, NoiseOrigin.RESULT)
    mean = np.sqrt((0.1**2 + 0.3**2) / 2)
    for rate, factor in ((100.0, 2.0), (400.0, 4.0), (10.0, 1.0)):
        origin, sigma = torque_noise(reference, None, LIMITS, 0.1, rate)
        assert origin is NoiseOrigin.RESULT
        np.testing.assert_allclose(sigma, [mean * factor, 2 * mean])


def test_a_joint_without_a_residual_has_the_noise_of_the_rule() -> None:
    result: Any = SimpleNamespace(validations=[residual(0.0, 0.0)])
    _, sigma = torque_noise(PriorKnowledge(MODEL, THETA, result, NoiseOrigin.RESULT), None, LIMITS, 0.1, 100.0)
    np.testing.assert_allclose(sigma, [0.4, 0.15])
    free = replace(LIMITS, torque=np.array([np.inf, 9.0]))
    _, sigma = torque_noise(PriorKnowledge(MODEL, THETA), None, free, 0.1, 100.0)
    np.testing.assert_allclose(sigma, [1.0, 0.1])
