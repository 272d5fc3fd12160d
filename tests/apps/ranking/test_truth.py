"""True values from the files that can hold them."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

import dynident as dy
from dynident.apps.ranking.differences import read_truth
from dynident.project.settings import RobotSettings, robot_settings
from dynident.runtime import ConfigError, InputError
from tests.apps.ranking.made import make_project

ARM = Path(__file__).parents[3] / "src/dynident/apps/demo/files/arm.urdf"


def test_values_are_read_from_yaml_results_and_robot_files(tmp_path: Path) -> None:
    assert read_truth({"M": 5}, tmp_path, "gallery:slider") == {"M": 5.0}
    (tmp_path / "truth.yaml").write_text("M: 5\nFv: 8.0\n")
    assert read_truth("truth.yaml", tmp_path, "gallery:slider") == {"M": 5.0, "Fv": 8.0}
    (tmp_path / "parameters.yaml").write_text("parameters:\n- {name: M, value: 5.5, unit: kg}\n")
    assert read_truth("parameters.yaml", tmp_path, "gallery:slider") == {"M": 5.5}
    found = dy.run(make_project(tmp_path))
    found.save(tmp_path / "result.json")
    values = read_truth("result.json", tmp_path, "gallery:slider")
    assert values == pytest.approx(dict(zip(found.estimate.names, found.estimate.value.tolist(), strict=True)))


def test_a_robot_file_has_bodies_friction_and_rotors(tmp_path: Path) -> None:
    text = ARM.read_text().replace('velocity="', 'velocity="', 1)
    (tmp_path / "true.urdf").write_text(text)
    shutil.copytree(ARM.parent / "meshes", tmp_path / "meshes")
    spec = robot_settings(str(ARM), {"folder": ARM.parent})
    assert isinstance(spec, RobotSettings)
    values = read_truth("true.urdf", tmp_path, spec)
    model = dy.read_robot(ARM)
    known = {one.name: one.value for one in model.parameters if one.value is not None}
    assert {name: values[name] for name in known} == pytest.approx(known)
    with pytest.raises(ConfigError, match="is a robot file, and the model is none"):
        read_truth("true.urdf", tmp_path, "gallery:slider")


@pytest.mark.parametrize("text", ["M: heavy\n", "- 5\n", "M: .nan\n", "parameters: [{name: M}]\n", "parameters: [3]\n"])
def test_what_is_no_list_of_values_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "truth.yaml").write_text(text)
    with pytest.raises(ConfigError, match=r"truth\.yaml"):
        read_truth("truth.yaml", tmp_path, "gallery:slider")
    (tmp_path / "truth.json").write_text(json.dumps({"M": 5}))
    with pytest.raises((ConfigError, InputError)):
        read_truth("truth.json", tmp_path, "gallery:slider")
