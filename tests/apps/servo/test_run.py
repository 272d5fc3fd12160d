"""From `init` to a model of MuJoCo with nothing edited, and what is refused."""

from __future__ import annotations

import json
import sys
from functools import partial

import mujoco
import numpy as np
import polars as pl
import pytest

from dynident.apps.demo import TRUE_DELAY, TRUE_VALUES, servo_files
from dynident.apps.demo.servo_arm import FILE_VALUES, KP, SERVO_JOINTS, servo_mjcf
from dynident.apps.servo.run import nominal_values
from dynident.project.drive_settings import ServoSettings
from tests.apps.servo.arms import plant
from tests.cli.commands import run


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("servos")
    servo_files(made, 6.0)
    return made


def test_init_and_identify_with_nothing_edited(folder, monkeypatch) -> None:
    monkeypatch.chdir(folder)
    drafted = run("init", "servos.xml", "monday.csv", "tuesday.csv", "-o", "servos.yaml", "--force")
    assert drafted.exit_code == 0, drafted.output
    assert "identify servos.yaml --out" in drafted.output.replace("\n", " ")
    assert "kp: 17.8, limit: 3.35" in (folder / "servos.yaml").read_text()
    done = run("identify", "servos.yaml", "--out", "out")
    assert len(done.output.splitlines()) <= 12
    assert done.exit_code == 0, done.output
    assert "good for simulation" in done.output
    numbers = json.loads((folder / "out" / "servo.json").read_text())
    assert numbers["warnings"] == []
    rows = {(row["joint"], row["quantity"]): row for row in numbers["parameters"]}
    assert rows[None, "delay"]["value"] == pytest.approx(TRUE_DELAY, abs=5e-4)
    for k, joint in enumerate(numbers["joints"]):
        assert rows[joint, "armature"]["value"] == pytest.approx(TRUE_VALUES["armature"][k], rel=0.02)
        assert rows[joint, "damping"]["low"] < rows[joint, "damping"]["high"]
    model = mujoco.MjModel.from_xml_path(str(folder / "out" / "robot.xml"))
    assert model.dof_damping == pytest.approx(TRUE_VALUES["damping"], rel=0.02)
    page = (folder / "out" / "report.html").read_text()
    assert "armature of elbow" in page
    assert "good for simulation" in page
    # what needs torques, and what has nothing to write out
    assert "have no torque, which this needs" in " ".join(run("bound", "servos.yaml").output.split())
    assert "`dynident predict` alone reads this file" in " ".join(
        run("watch", "out/servo.json", "x.csv").output.split()
    )
    refused = run("identify", "servos.yaml", "--write-config", "x.yaml")
    assert refused.exit_code == 1
    assert "leave it out" in refused.output


def test_torque_beside_servos_and_neither_are_refused(folder, monkeypatch) -> None:
    monkeypatch.chdir(folder)
    run("init", "servos.xml", "monday.csv", "-o", "one.yaml", "--force")
    text = (folder / "one.yaml").read_text()
    (folder / "both.yaml").write_text(text + "torque: { base: { column: cmd_base, unit: N m } }\n")
    assert "`torque` is left out" in " ".join(run("identify", "both.yaml").output.split())
    (folder / "none.yaml").write_text(text.partition("simulation:")[0] + "train: [{ file: monday.csv }]\n")
    assert "`torque` is missing" in " ".join(run("identify", "none.yaml").output.split())
    (folder / "two.yaml").write_text("\n".join(line for line in text.splitlines() if "elbow: { command" not in line))
    refused = run("identify", "two.yaml")
    assert refused.exit_code == 1, refused.output
    assert "simulation.joints" in refused.output


def test_without_mujoco_the_extra_is_named(folder, monkeypatch) -> None:
    from dynident.apps.servo.plant import import_mujoco
    from dynident.runtime import ModelError

    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ModelError, match=r"dynident\[mujoco\]"):
        import_mujoco()


def test_the_demo_shows_how_far_it_is_from_the_truth(tmp_path) -> None:
    done = run("demo", "--servo", "--files", "--out", str(tmp_path / "arm"))
    assert done.exit_code == 0, done.output
    assert sorted(path.name for path in (tmp_path / "arm").iterdir()) == ["monday.csv", "servos.xml", "tuesday.csv"]


def test_the_demo_drafts_identifies_and_compares_with_the_truth(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr("dynident.apps.demo.servo_files", partial(servo_files, duration=6.0))
    done = run("demo", "--servo", "--out", str(tmp_path / "arm"))
    assert done.exit_code == 0, done.output
    assert "kp: 17.8, limit: 3.35" in (tmp_path / "arm" / "servos.yaml").read_text()
    shown = " ".join(done.output.split())
    assert "servos: good for simulation" in shown
    assert float(shown.partition("dry friction are at most ")[2].split()[0]) < 2.0  # %


def test_a_kp_of_zero_in_the_file_is_none() -> None:
    """So that it is sought, as where the actuator says nothing of it."""
    servo = {"command": {"column": "x", "unit": "rad"}, "kp": "estimate"}
    settings = ServoSettings.model_validate({"kind": "servo", "joints": dict.fromkeys(SERVO_JOINTS, servo)})
    text = servo_mjcf(FILE_VALUES).replace(f'joint="elbow" kp="{KP}"', 'joint="elbow" kp="0"')
    np.testing.assert_array_equal(nominal_values(plant(text), settings).kp, [KP, KP, np.nan])


def test_positions_before_their_commands_are_a_warning(folder, monkeypatch) -> None:
    # without damping the digits of the written values grow in the simulation that proves them
    monkeypatch.chdir(folder)
    table = pl.read_csv("monday.csv").head(300)
    columns = [pl.col(name).shift(-10).forward_fill() for name in table.columns if name.startswith("pos")]
    table.with_columns(columns).write_csv("early.csv")
    run("init", "servos.xml", "early.csv", "-o", "early.yaml", "--force")
    done = run("identify", "early.yaml")
    assert done.exit_code == 0, done.output
    assert "ms before their commands" in " ".join(done.output.split())
