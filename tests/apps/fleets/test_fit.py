"""The base parameters that all logs of a fleet have."""

from __future__ import annotations

from pathlib import Path

import dynident as dy
from dynident.apps.fleets.fit import model_of
from dynident.apps.fleets.recipe import FleetRecipe
from dynident.files.yaml_text import load_yaml
from dynident.identification import tilt_base
from dynident.regression import structural_base_parameters
from tests.apps.fleets.made import RECIPE, URDF

SHOULDER = '<parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>'


def test_a_tilt_of_any_robot_shows_more_of_all(tmp_path: Path) -> None:
    robot = tmp_path / "arm.urdf"
    robot.write_text(URDF.replace(SHOULDER, SHOULDER.replace("0 1 0", "0 0 1")))
    settings = dict(load_yaml(RECIPE, "recipe"))
    turned = {"model": settings["model"] | {"base_tilt": [0.02, 0.01]}}
    level = model_of(FleetRecipe(settings, tmp_path, {}, {}))[1]
    tilted = model_of(FleetRecipe(settings | turned, tmp_path, {}, {}))[1]
    one = model_of(FleetRecipe(settings, tmp_path, {"arm-2": turned}, {}))[1]
    model = dy.read_robot(robot, terms=["viscous", "coulomb", "offset"])
    assert level.rank == structural_base_parameters(model).rank
    assert tilted.rank == structural_base_parameters(tilt_base(model, 0.02, 0.01)).rank > level.rank
    assert one.independent == tilted.independent
