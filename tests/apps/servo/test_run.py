"""From `init` to a model of MuJoCo with nothing edited, and what is refused."""

from __future__ import annotations

import json
import sys

import mujoco
import numpy as np
import polars as pl
import pytest

from dynident.apps.demo import TRUE_DELAY, TRUE_VALUES
from dynident.apps.demo.servo_arm import FILE_VALUES, KP, SERVO_JOINTS, servo_mjcf
from dynident.apps.servo.plant import import_mujoco
from dynident.apps.servo.run import nominal_values
from dynident.project.drive_settings import ServoSettings
from dynident.runtime import ModelError
from tests.apps.servo.arms import plant
from tests.cli.commands import refuse, succeed


def test_the_demo_drafts_identifies_and_compares_with_the_truth(demo_output, folder) -> None:
    output = demo_output[1]
    assert "servos: good for simulation" in output
    assert float(output.partition("dry friction are at most ")[2].split()[0]) < 2.0  # %
    assert "kp: 17.8, limit: 3.35" in (folder / "servos.yaml").read_text()
    numbers = json.loads((folder / "servos" / "servo.json").read_text())
    assert (numbers["warnings"], numbers["backlash"]) == ([], [])
    rows = {(row["joint"], row["quantity"]): row for row in numbers["parameters"]}
    assert rows[None, "delay"]["value"] == pytest.approx(TRUE_DELAY, abs=5e-4)
    for k, joint in enumerate(numbers["joints"]):
        assert rows[joint, "armature"]["value"] == pytest.approx(TRUE_VALUES["armature"][k], rel=0.02)
        assert rows[joint, "damping"]["low"] < rows[joint, "damping"]["high"]
    model = mujoco.MjModel.from_xml_path(str(folder / "servos" / "robot.xml"))
    assert model.dof_damping == pytest.approx(TRUE_VALUES["damping"], rel=0.02)
    page = (folder / "servos" / "report.html").read_text()
    assert "armature of elbow" in page
    assert "good for simulation" in page


def test_commands_of_torques_say_what_they_need(folder) -> None:
    refuse("bound", "servos.yaml", says="have no torque, which this needs")
    refuse("watch", "servos/servo.json", "x.csv", says="`dynident predict` alone reads this file")
    refuse("identify", "servos.yaml", "--write-config", "x.yaml", says="leave it out")


def test_torque_beside_servos_and_neither_are_refused(folder) -> None:
    text = (folder / "servos.yaml").read_text()
    changes = {
        text + "torque: { base: { column: cmd_base, unit: N m } }\n": "`torque` is left out",
        text.partition("simulation:")[0] + "train: [{ file: monday.csv }]\n": "`torque` is missing",
        "\n".join(line for line in text.splitlines() if "elbow: { command" not in line): "simulation.joints",
    }
    for change, words in changes.items():
        (folder / "changed.yaml").write_text(change)
        refuse("identify", "changed.yaml", says=words)


def test_without_mujoco_the_extra_is_named(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ModelError, match=r"dynident\[mujoco\]"):
        import_mujoco()


def test_the_files_of_the_demo_alone(tmp_path) -> None:
    succeed("demo", "--servo", "--files", "--out", tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["monday.csv", "servos.xml", "tuesday.csv"]


def test_a_kp_of_zero_in_the_file_is_none() -> None:
    """So that it is sought, as where the actuator says nothing of it."""
    servo = {"command": {"column": "x", "unit": "rad"}, "kp": "estimate"}
    settings = ServoSettings.model_validate({"kind": "servo", "joints": dict.fromkeys(SERVO_JOINTS, servo)})
    text = servo_mjcf(FILE_VALUES).replace(f'joint="elbow" kp="{KP}"', 'joint="elbow" kp="0"')
    np.testing.assert_array_equal(nominal_values(plant(text), settings).kp, [KP, KP, np.nan])


def test_positions_before_their_commands_are_a_warning(folder) -> None:
    # without damping the digits of the written values grow in the simulation that proves them
    table = pl.read_csv("monday.csv").head(300)
    columns = [pl.col(name).shift(-10).forward_fill() for name in table.columns if name.startswith("pos")]
    table.with_columns(columns).write_csv("early.csv")
    succeed("init", "servos.xml", "early.csv", "-o", "early.yaml")
    output = " ".join(succeed("identify", "early.yaml").output.split())
    assert "commands are interpolated: so the positions are explained better" in output
    assert "ms before their commands" in output
