"""`excite --for servo`: chirps within limits, whose recording shows the values of the arm."""

from __future__ import annotations

import mujoco
import numpy as np
import polars as pl
import pytest

from dynident.apps.demo.servo_arm import FILE_VALUES, SERVO_JOINTS, TRUE_VALUES, play_commands, servo_mjcf
from tests.cli.commands import run


def play(commands: str, out: str) -> None:
    """Record what the demo's arm does by the commands of a file."""
    table = pl.read_csv(commands)
    q = play_commands(table.select([f"cmd_{name}" for name in SERVO_JOINTS]).to_numpy())
    table.with_columns(**{f"pos_{name}": q[:, k] for k, name in enumerate(SERVO_JOINTS)}).write_csv(out)


def test_chirps_keep_their_limits_and_show_the_arm(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.xml").write_text(servo_mjcf(FILE_VALUES))
    (tmp_path / "limits.yaml").write_text("limits: { elbow: { lower: 0.3, upper: 1.0, velocity: 0.4 } }\n")
    done = run("excite", "--for", "servo", "arm.xml", "-o", "next", "--settings", "limits.yaml", "--duration", "8")
    assert done.exit_code == 0, done.output
    table = pl.read_csv("next/motion.csv")
    assert len(table) == 800
    elbow = table["cmd_elbow"].to_numpy()
    assert 0.3 < elbow.min() < elbow.max() < 1.0
    for name, fastest in (("elbow", 0.4), ("base", 1.5)):
        speed = np.gradient(table[f"cmd_{name}"].to_numpy(), 0.01)
        assert 0.3 * fastest < np.abs(speed).max() < fastest
        assert np.abs(speed[[0, -1]]).max() < 0.02
    for name in ("motion", "validation"):
        play(f"next/{name}.csv", f"next/{name}_recorded.csv")
    done = run("identify", "next/identify.yaml", "--out", "out")
    assert done.exit_code == 0, done.output
    assert "good for simulation" in done.output
    model = mujoco.MjModel.from_xml_path("out/robot.xml")
    assert model.dof_damping == pytest.approx(TRUE_VALUES["damping"], rel=0.03)
    assert model.dof_armature == pytest.approx(TRUE_VALUES["armature"], rel=0.05)


def test_settings_are_followed_and_what_cannot_be_designed_is_refused(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.xml").write_text(servo_mjcf(FILE_VALUES))
    (tmp_path / "pose.yaml").write_text("start: { elbow: 0.3 }\nlimits: { elbow: { lower: 0.29, upper: 0.3 } }\n")
    (tmp_path / "x.yaml").write_text("model: arm.xml\n")
    refused = run("excite", "--for", "servo", "x.yaml", "-o", "a")
    assert "takes a robot file" in " ".join(refused.output.split())
    refused = run("excite", "--for", "servo", "arm.xml", "-o", "b", "--settings", "pose.yaml")
    assert "joint 'elbow' has no room" in " ".join(refused.output.split())
    (tmp_path / "rate.yaml").write_text("rate: 50\nduration: 5\n")
    assert run("excite", "--for", "servo", "arm.xml", "-o", "c", "--settings", "rate.yaml").exit_code == 0
    assert len(pl.read_csv("c/motion.csv")) == 250
    refused = run("excite", "--for", "servo", "arm.xml", "-o", "d", "--program", "friction", "--file-rate", "50")
    assert "--program, --file-rate: of no use with --for servo" in " ".join(refused.output.split())
    again = run("excite", "--for", "servo", "arm.xml", "-o", "c")
    assert "exists already" in " ".join(again.output.split())
