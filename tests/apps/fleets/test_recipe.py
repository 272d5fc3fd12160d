"""The recipe of a fleet, and what one log says of the base parameters."""

from pathlib import Path

import numpy as np
import pytest

import dynident as dy
from dynident.apps.fleets.config import fleet_logs, read_fleet_settings
from dynident.apps.fleets.fit import information_of, model_of
from dynident.apps.fleets.recipe import FleetRecipe, fleet_recipe
from dynident.files.yaml_text import load_yaml
from dynident.identification import Recipe, identify, tilt_base
from dynident.models import Model
from dynident.motion.log import Log
from dynident.motion.smoothers import Difference, Spline
from dynident.motion.splines import GCV
from dynident.regression import structural_base_parameters
from dynident.runtime import ConfigError, InputError
from tests.apps.fleets.made import FLEET, RECIPE, URDF, arm, make_fleet, recording, truth


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a fleet."""
    return make_fleet(tmp_path_factory.mktemp("fleet")).parent


def recipe_of(folder: Path, fleet: str = FLEET, recipe: str = RECIPE) -> FleetRecipe:
    (folder / "robot.yaml").write_text(recipe)
    (folder / "fleet.yaml").write_text(fleet)
    settings = read_fleet_settings(folder / "fleet.yaml")
    logs, _ = fleet_logs(settings, folder)
    return fleet_recipe(settings, logs, folder, None)


def test_a_recipe_is_another_one_where_settings_or_files_differ(folder: Path) -> None:
    (folder / "other.urdf").write_text(URDF)
    (folder / "longer.urdf").write_text(URDF.replace("0.4 0 0", "0.41 0 0"))
    changes = "robots: { same: { model: other.urdf }, long: { model: longer.urdf }, gain: { time_offset: 0.001 } }\n"
    result = recipe_of(folder, FLEET + changes).digests(["", "arm-1", "same", "long", "gain"])
    assert result[""] == result["arm-1"] == result["same"]  # of a file the content counts, and not its name
    assert len(set(result.values())) == 3
    assert recipe_of(folder, FLEET + "window: [0, 3]\n").digest("") not in result.values()


def test_a_robot_file_alone_may_be_the_model(folder: Path) -> None:
    recipe = RECIPE.replace("{ file: arm.urdf, terms: [viscous, coulomb, offset], base_tilt: none }", "arm.urdf")
    changes = "robots: { arm-1: { model: { gravity: [0, 0, -9.8] } } }\n"
    result = recipe_of(folder, FLEET + changes, recipe.replace("estimator", "min_speed: 0.01\nestimator")).of("arm-1")
    assert (result["model"]["file"], result["model"]["gravity"]) == ("arm.urdf", [0, 0, -9.8])
    assert "auto" not in result["model"]["terms"]


@pytest.mark.parametrize(
    ("recipe", "words"),
    [("- 1", "is no configuration"), (RECIPE.replace("time_offset", "time_ofset"), "unknown key 'time_ofset'")],
)
def test_a_wrong_recipe_is_named(folder: Path, recipe: str, words: str) -> None:
    with pytest.raises(ConfigError, match=f"robot.yaml: .*{words}"):
        recipe_of(folder, recipe=recipe)


def test_a_joint_that_is_not_there_is_named_with_its_robot(folder: Path) -> None:
    with pytest.raises(ConfigError, match=r"robots.arm-1: torque: there is no 'elbw'; did you mean 'elbow'"):
        recipe_of(folder, FLEET + "robots: { arm-1: { torque: { elbw: { gain: 2 } } } }\n")


def test_where_no_log_can_be_read_the_first_reason_is_said(tmp_path: Path) -> None:
    folder = make_fleet(tmp_path).parent
    for log in folder.glob("logs/*/*.csv"):
        log.write_text("t,q1\n0,1\n")
    with pytest.raises(InputError, match=r"no log can be read to choose the recipe: .*2026-01-01"):
        recipe_of(folder)


SHOULDER = '<parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>'


def test_a_tilt_of_any_robot_shows_more_of_all(tmp_path: Path) -> None:
    robot = tmp_path / "arm.urdf"
    robot.write_text(URDF.replace(SHOULDER, SHOULDER.replace("0 1 0", "0 0 1")))
    settings = dict(load_yaml(RECIPE, "recipe"))
    turned = {"model": settings["model"] | {"base_tilt": [0.02, 0.01]}}
    level = model_of(FleetRecipe(settings, tmp_path, {}, {}))[1]
    tilted = model_of(FleetRecipe(settings | turned, tmp_path, {}, {}))[1]
    case = model_of(FleetRecipe(settings, tmp_path, {"arm-2": turned}, {}))[1]
    model = dy.read_robot(robot, terms=["viscous", "coulomb", "offset"])
    assert level.rank == structural_base_parameters(model).rank
    assert tilted.rank == structural_base_parameters(tilt_base(model, 0.02, 0.01)).rank > level.rank
    assert case.independent == tilted.independent


GCV_RECIPE = Recipe(Spline(GCV()))


def logged(model: Model, seed: int, *, still: bool = False) -> Log:
    """A recording, in which the elbow may stand still."""
    t = recording(model, truth(model), seed, still=still)
    q, tau = t.select("q1", "q2").to_numpy() * [1, not still], t.select("tau1", "tau2").to_numpy()
    return Log(t["t"].to_numpy(), q, tau, ("shoulder", "elbow"), f"log {seed}")


def test_errors_are_as_large_as_the_information_says(tmp_path: Path) -> None:
    model = arm(tmp_path)
    basis = structural_base_parameters(model)
    true, distances = basis.to_base(truth(model)), []
    for seed in range(6):
        result = identify(model, [logged(model, seed)], recipe=GCV_RECIPE)
        value, information, residual = information_of(result, basis)
        error = value - true
        distances.append(error @ information @ error)
        np.testing.assert_allclose(residual, list(result.validations[0].errors.rmse.values()), rtol=0.05)
    assert 0.6 < np.mean(distances) / basis.rank < 1.5  # chi-squared with 60 degrees of freedom, over these


def test_what_a_motion_does_not_show_has_no_information(tmp_path: Path) -> None:
    model = arm(tmp_path)
    basis = structural_base_parameters(model)
    result = identify(model, [logged(model, 0, still=True)], recipe=Recipe(Difference("central")))
    _, information, _ = information_of(result, basis)
    names = [basis.names[k] for k in basis.independent]
    viscous = names.index("Fv_elbow")
    assert np.abs(information[viscous]).max() < 1e-9 * np.abs(information).max()
    assert np.linalg.eigvalsh(information).min() > -1e-9 * np.abs(information).max()
    assert information[names.index("Fv_shoulder"), names.index("Fv_shoulder")] > 0
