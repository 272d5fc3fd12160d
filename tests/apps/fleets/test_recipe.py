"""The recipe of a fleet: what differs by robot, and what tells one recipe from another."""

from __future__ import annotations

from pathlib import Path

import pytest

from dynident.apps.fleets.config import fleet_logs, read_fleet_settings
from dynident.apps.fleets.recipe import FleetRecipe, fleet_recipe, merge_settings
from dynident.runtime import ConfigError, InputError
from tests.apps.fleets.made import FLEET, RECIPE, URDF, make_fleet


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


def test_settings_are_merged_key_by_key() -> None:
    recipe = {"model": {"file": "a.urdf", "terms": []}, "time_offset": 0}
    found = merge_settings(recipe, {"model": {"file": "b.urdf"}, "time_offset": 1, "zero": {"a": 2}})
    assert found == {"model": {"file": "b.urdf", "terms": []}, "time_offset": 1, "zero": {"a": 2}}
    assert recipe == {"model": {"file": "a.urdf", "terms": []}, "time_offset": 0}


def test_a_recipe_is_another_one_where_settings_or_files_differ(folder: Path) -> None:
    (folder / "other.urdf").write_text(URDF)
    (folder / "longer.urdf").write_text(URDF.replace("0.4 0 0", "0.41 0 0"))
    changes = "robots: { same: { model: other.urdf }, long: { model: longer.urdf }, gain: { time_offset: 0.001 } }\n"
    found = recipe_of(folder, FLEET + changes).digests(["", "arm-1", "same", "long", "gain"])
    assert found[""] == found["arm-1"] == found["same"]  # of a file the content counts, and not its name
    assert len(set(found.values())) == 3
    assert recipe_of(folder, FLEET + "window: [0, 3]\n").digest("") not in found.values()


def test_a_robot_file_alone_may_be_the_model(folder: Path) -> None:
    recipe = RECIPE.replace("{ file: arm.urdf, terms: [viscous, coulomb, offset], base_tilt: none }", "arm.urdf")
    changes = "robots: { arm-1: { model: { gravity: [0, 0, -9.8] } } }\n"
    found = recipe_of(folder, FLEET + changes, recipe.replace("estimator", "min_speed: 0.01\nestimator")).of("arm-1")
    assert (found["model"]["file"], found["model"]["gravity"]) == ("arm.urdf", [0, 0, -9.8])
    assert "auto" not in found["model"]["terms"]


@pytest.mark.parametrize(
    ("recipe", "words"),
    [("- 1", "is no configuration"), (RECIPE.replace("time_offset", "time_ofset"), "unknown key 'time_ofset'")],
)
def test_a_wrong_recipe_is_named(folder: Path, recipe: str, words: str) -> None:
    with pytest.raises(ConfigError, match=f"robot.yaml: .*{words}"):
        recipe_of(folder, recipe=recipe)


def test_where_no_log_can_be_read_the_first_reason_is_said(tmp_path: Path) -> None:
    folder = make_fleet(tmp_path).parent
    for log in folder.glob("logs/*/*.csv"):
        log.write_text("t,q1\n0,1\n")
    with pytest.raises(InputError, match=r"no log can be read to choose the recipe: .*2026-01-01"):
        recipe_of(folder)


def test_a_joint_that_is_not_there_is_named_with_its_robot(tmp_path: Path) -> None:
    folder = make_fleet(tmp_path).parent
    with pytest.raises(ConfigError, match=r"robots.arm-1: torque: there is no 'elbw'; did you mean 'elbow'"):
        recipe_of(folder, FLEET + "robots: { arm-1: { torque: { elbw: { gain: 2 } } } }\n")
