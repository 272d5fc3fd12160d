"""The first configuration a reader meets does what the pages say: a simulated arm, logged as a user's drive would."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
from click.testing import CliRunner

from dynident.cli import main
from dynident.models import Model
from dynident.project.shortcuts import read_robot
from tests.saved_results import errors_by_log

ROOT = Path(__file__).parents[2]
ARM = """<robot name="arm">
<link name="base"/>
<link name="upper"><inertial><origin xyz="0.2 0 0"/><mass value="2"/>
  <inertia ixx="0.002" iyy="0.03" izz="0.03" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="fore"><inertial><origin xyz="0.15 0 0.01"/><mass value="1"/>
  <inertia ixx="0.001" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="continuous"><parent link="base"/><child link="upper"/>
  <origin rpy="1.5707963267948966 0 0"/><axis xyz="0 0 1"/></joint>
<joint name="elbow" type="continuous"><parent link="upper"/><child link="fore"/>
  <origin xyz="0.4 0 0"/><axis xyz="0 0 1"/></joint>
</robot>"""
TRUE = {"Ia": 0.05, "Fv": 0.8, "Fc": 0.5, "of": 0.1}
CURRENT = np.array([0.0105, 0.0062])  # N m per mA, as in the configuration


def shown(page: str) -> str:
    """The first configuration on a page."""
    outcome = re.search(r"^```yaml\n(.*?)^```$", (ROOT / page).read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    assert outcome
    return outcome[1]


def truth(model: Model) -> list[float]:
    return [TRUE[x.name[:2]] if x.value is None else x.value for x in model.parameters]


def write_recording(path: Path, model: Model, rate: float, rng: np.random.Generator) -> None:
    """Sums of sines in the columns and units that the pages declare, with noise of 2e-5 rad and 0.02 N m."""
    t = np.arange(2000) * 0.005
    w, amplitude = rate * np.array([[1.0, 2.3, 3.7], [1.3, 2.9, 4.1]]), np.array([[0.8, 0.4, 0.2], [0.9, 0.4, 0.3]])
    angle = w * t[:, None, None]
    q, dq = (amplitude * np.sin(angle)).sum(axis=2), (amplitude * w * np.cos(angle)).sum(axis=2)
    tau = model.regressor(q, dq, -(amplitude * w**2 * np.sin(angle)).sum(axis=2)) @ truth(model)
    pos = np.degrees(q + 2e-5 * rng.standard_normal(q.shape))
    cur = (tau + 0.02 * rng.standard_normal(q.shape)) / CURRENT
    columns = {"time_ms": 1e3 * t, "pos1": pos[:, 0], "pos2": pos[:, 1], "cur1": cur[:, 0], "cur2": cur[:, 1]}
    pl.DataFrame(columns).write_csv(path)


def run(folder: Path, text: str) -> dict[str, Any]:
    (folder / "arm.urdf").write_text(ARM, encoding="utf-8")
    model = read_robot(folder / "arm.urdf")
    rng = np.random.default_rng(0)
    for name, rate in (("monday", 1.0), ("tuesday", 1.2)):
        write_recording(folder / f"{name}.csv", model, rate, rng)
    (folder / "robot.yaml").write_text(text, encoding="utf-8")
    done = CliRunner().invoke(main, ["identify", str(folder / "robot.yaml"), "--out", str(folder / "out")])
    assert done.exit_code == 0, done.output
    result: dict[str, Any] = json.loads((folder / "out" / "result.json").read_text(encoding="utf-8"))
    return result


def test_the_first_configuration_identifies_an_arm(tmp_path: Path) -> None:
    result = run(tmp_path, shown("docs/robots.md"))
    (held_out,) = errors_by_log(result, "validation").values()
    assert held_out["relative_error"] < 1.0
    actual = {x["name"]: x["value"] for x in result["parameters"]}
    for name, value in actual.items():
        if name[:2] in TRUE and not name.startswith("Ia"):
            assert value == pytest.approx(TRUE[name[:2]], abs=0.02), name
    assert actual["Ia_elbow"] + actual["fore.Izz"] == pytest.approx(0.05 + 0.01 + 0.15**2, rel=0.02)
