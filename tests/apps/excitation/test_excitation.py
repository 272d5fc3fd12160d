"""From a robot file, a configuration or a result to what is designed for it: settings, limits, noise, information."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml

import dynident as dy
from dynident.apps.excitation import Criterion, Program
from dynident.apps.excitation.config import (
    ExcitationSettings,
    NoiseOrigin,
    PriorKnowledge,
    knowledge_of_result,
    settings_in,
    torque_noise,
)
from dynident.apps.excitation.expected_report import body_words, shape_words
from dynident.apps.excitation.files import recording_config
from dynident.apps.excitation.robot import DURATIONS, read_excitation
from dynident.models import Box, Cylinder, EmptySpace, Floor, Model, RigidBodies
from dynident.models.friction import Coulomb, Viscous
from dynident.project.config import nominal_values
from dynident.runtime import ConfigError, InputError, ModelError
from tests.apps.excitation.arms import LIMITS, MODEL, THETA, TWO
from tests.cli.commands import settings, write_log

CHANNELS = {
    "time": {"column": "t", "unit": "s"},
    "position": {name: {"column": f"q{k}", "unit": "deg"} for k, name in enumerate(("lift", "bend"))},
    "torque": {name: {"column": f"i{k}", "gain": 2.0, "unit": "N m"} for k, name in enumerate(("lift", "bend"))},
    "train": [{"file": "monday.csv"}],
}
SLIDER = {"limits": {"slider": {"lower": -0.3, "upper": 0.3, "velocity": 1.0}}}


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    path = tmp_path / "two.urdf"
    path.write_text(TWO)
    return path


def written(path: Path, data: object) -> Path:
    path.write_text(yaml.safe_dump(data))
    return path


def test_settings_of_a_file_and_changes_of_them(robot: Path, tmp_path: Path) -> None:
    given = {
        "duration": 12,
        "criterion": "condition",
        "program": "friction",
        "noise": {"lift": 0.2},
        "start": {"bend": 0.5},
        "limits": {"lift": {"velocity": 1.0}},
        "margin": 0.2,
        "floor": -1,
        "boxes": [{"name": "table", "centre": [1, 0, 0], "size": [0.2, 0.2, 0.2]}],
        "cylinders": [{"name": "post", "centre": [0, 1], "radius": 0.1, "top": 2}],
    }
    excitation = read_excitation(robot, written(tmp_path / "cell.yaml", given), {"duration": 20.0})
    assert excitation.request.duration == 20.0
    assert excitation.request.criterion is Criterion.CONDITION
    assert excitation.request.program is Program.FRICTION
    assert excitation.origin is NoiseOrigin.GIVEN
    np.testing.assert_allclose(excitation.request.sigma, [0.2, 0.15])
    np.testing.assert_array_equal(excitation.request.start, [0.0, 0.5])
    np.testing.assert_allclose(excitation.limits.velocity, [0.8, 2.4])
    floor, box, post = excitation.obstacles
    assert floor == Floor(-1.0)
    assert box == Box("table", (1, 0, 0), (0.2, 0.2, 0.2))
    assert post == Cylinder("post", (0, 1), 0.1, -np.inf, 2.0)
    assert {"floor", "table", "post"} <= {name for pair in excitation.space.pairs for name in pair}


def test_a_configuration_without_recordings_yet(robot: Path, tmp_path: Path) -> None:
    config = {"model": {"file": robot.name, "joints": ["bend", "lift"], "terms": ["viscous"]}}
    excitation = read_excitation(written(tmp_path / "arm.yaml", {**config, "excitation": {"duration": 7}}))
    assert [joint.name for joint in excitation.prior.model.joints] == ["bend", "lift"]
    assert excitation.prior.model.names[-1] == "Fv_lift"
    assert excitation.request.duration == 7
    assert excitation.file == robot
    with pytest.raises(ConfigError, match=r"model: terms\[0\]: 'glue'"):
        read_excitation(written(tmp_path / "wrong.yaml", {"model": {"file": robot.name, "terms": ["glue"]}}))


def test_a_configuration_whose_logs_are_not_there(robot: Path, tmp_path: Path) -> None:
    excitation = read_excitation(written(tmp_path / "arm.yaml", {"model": {"file": robot.name}, **CHANNELS}))
    assert excitation.origin is NoiseOrigin.RULE
    assert excitation.prior.loss_reason == "the configuration names monday.csv, which is not there"


def test_logs_of_a_configuration_give_parameters_and_noise_and_a_result_its_information(tmp_path: Path) -> None:
    write_log(tmp_path)
    config = written(tmp_path / "arm.yaml", settings(excitation=SLIDER))
    excitation = read_excitation(config)
    assert excitation.origin is NoiseOrigin.LOGS
    assert excitation.request.prior is None
    assert excitation.prior.theta[0] == pytest.approx(5.0, rel=0.01)
    assert (
        0.005 < excitation.request.sigma[0] < 0.2
    )  # N; white noise of 0.01 N, and friction that is not quite Coulomb's
    assert isinstance(excitation.space, EmptySpace)
    result = dy.run(config)
    result.save(tmp_path / "result.json")
    again = read_excitation(tmp_path / "result.json")
    assert again.origin is NoiseOrigin.RESULT
    assert again.limits.velocity[0] == pytest.approx(0.9)  # the settings are those of its configuration
    covariance = np.linalg.inv(again.request.prior)
    np.testing.assert_allclose(covariance, result.errors.base_covariance, rtol=1e-6)
    old = knowledge_of_result(replace(result, errors=replace(result.errors, base_covariance=None)))
    assert old.information is None
    assert "identify again" in old.loss_reason


def test_what_cannot_be_read_is_said(robot: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"log.csv: give a robot file \(.urdf"):
        read_excitation(tmp_path / "log.csv")
    for given, words in (
        ({"start": {"bent": 1}}, "excitation.start: there is no joint 'bent'; did you mean 'bend'"),
        ({"noise": {"bent": 1}}, "excitation.noise: there is no joint 'bent'; did you mean 'bend'"),
        ({"limits": {"bent": {}}}, "no joint 'bent' moves"),
    ):
        with pytest.raises(ConfigError) as caught:
            read_excitation(robot, None, given)
        assert words in str(caught.value)
    with pytest.raises(ConfigError, match="nothing can keep it clear of obstacles"):
        _ = read_excitation(
            written(tmp_path / "slider.yaml", {"model": "gallery:slider"}), None, {**SLIDER, "floor": 0}
        ).space


def test_a_period_that_nobody_gives_fits_the_duration_and_that_the_program(robot: Path) -> None:
    assert read_excitation(robot, None, {"duration": 3.0}).request.period == pytest.approx(1.8)
    assert read_excitation(robot).request.period == 5.0
    assert read_excitation(robot, None, {"duration": 3.0, "period": 2.5}).request.period == 2.5
    durations = {name: read_excitation(robot, None, {"program": name}).request.duration for name in DURATIONS}
    assert durations == {"motion": 30.0, "friction": 60.0, "gravity": 30.0, "all": 150.0}
    assert read_excitation(robot, None, {"program": "all", "duration": 40.0}).request.duration == 40.0


def test_folders_of_packages_are_relative_to_their_settings(robot: Path, tmp_path: Path) -> None:
    (tmp_path / "far" / "arm").mkdir(parents=True)
    (tmp_path / "far" / "arm" / "part.obj").write_text("v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 2 3\nf 1 2 4\n")
    shape = '<collision><geometry><mesh filename="package://arm/part.obj"/></geometry></collision></link>'
    robot.write_text(robot.read_text().replace("</link>", shape))
    lost = read_excitation(robot)
    assert set(lost.geometry.missing) == {"package://arm/part.obj"}
    assert any("name the folder of their package (`packages`" in line for line in shape_words(lost))
    (tmp_path / "cell").mkdir()
    excitation = read_excitation(robot, written(tmp_path / "cell" / "cell.yaml", {"packages": ["../far"]}))
    assert not excitation.geometry.missing
    assert yaml.safe_load(recording_config(excitation, tmp_path / "out"))["excitation"]["packages"] == ["../far"]
    for folder, words in (("nowhere", r"packages: there is no folder '.*nowhere'"), (3, r"packages\[0\]: the name of")):
        with pytest.raises(ConfigError, match=words):
            read_excitation(robot, None, {"packages": [folder]})


def test_masses_and_inertias_that_cannot_be_are_said(robot: Path) -> None:
    assert list(body_words(read_excitation(robot))) == []

    robot.write_text(robot.read_text().replace('ixx="', 'ixx="9'))
    (said,) = body_words(read_excitation(robot))
    assert "where mass or inertia of upper, lower cannot be right: see `dynident check`" in said


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
        ExcitationSettings.read(given, "arm.yaml: excitation")
    assert str(caught.value).startswith("arm.yaml: excitation: ")
    assert words in str(caught.value)


def test_the_section_of_a_file() -> None:
    assert settings_in({"excitation": {"duration": 3}}, "x", alone=True) == {"duration": 3}
    assert settings_in({"duration": 3}, "x", alone=True) == {"duration": 3}
    assert settings_in({"model": "a.urdf", "excitation": None}, "x", alone=False) == {}
    for data, alone in (({"excitation": [1]}, False), ([1], True)):
        with pytest.raises(ConfigError, match="a mapping of settings"):
            settings_in(data, "x", alone=alone)


def test_friction_is_that_of_the_robot_file_where_it_says_any() -> None:
    rusty = TWO.replace('<limit effort="40"', '<dynamics damping="0.7" friction="0.3"/><limit effort="40"')
    bodies = RigidBodies(rusty, source="two.urdf")
    theta = nominal_values(Model((bodies, Viscous(bodies.joints, on=("lift",)), Coulomb(bodies.joints))))
    assert bodies.damping == {"lift": 0.7}
    np.testing.assert_array_equal(theta[:20], THETA[:20])
    np.testing.assert_array_equal(theta[20:], [0.7, 0.3, 0.0])


def test_a_body_without_inertia_is_named() -> None:
    odd = [replace(parameter, value=None) if parameter.body == "lower" else parameter for parameter in MODEL.parameters]
    unknown: Any = SimpleNamespace(parameters=odd, name="two.urdf", terms=())
    with pytest.raises(ModelError, match=r"two.urdf: the inertia of lower is not in the robot file"):
        nominal_values(unknown)


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
        origin, sigma = torque_noise(reference, ExcitationSettings(rate=rate), LIMITS)
        assert origin is NoiseOrigin.RESULT
        np.testing.assert_allclose(sigma, [mean * factor, 2 * mean])
