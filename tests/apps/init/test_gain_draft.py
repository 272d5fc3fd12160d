"""`init` proposes gains for currents, as an assumption to confirm."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from dynident.cli import main
from dynident.project.config import parse_config
from dynident.project.shortcuts import read_robot
from tests.robots import joint, link, urdf

TENSOR = np.diag([0.05, 0.05, 0.02])
LIMIT = '<limit effort="60" velocity="5" lower="-3" upper="3"/>'
GAINS = np.array([9.0, -5.0])


def arm(folder: Path, mass: float = 1.0) -> Path:
    (folder / "arm.urdf").write_text(
        urdf(
            link("base", 1.0),
            link("upper", 3.0 * mass, (0.05, 0.03, 0.2), tensor=mass * TENSOR),
            link("fore", 2.0 * mass, (0.05, 0.0, 0.15), tensor=mass * TENSOR),
            joint("shoulder", "revolute", "base", "upper", axis=(0, 1, 0), inside=LIMIT),
            joint("elbow", "revolute", "upper", "fore", (0, 0, 0.4), axis=(0, 1, 0), inside=LIMIT),
        )
    )
    return folder / "arm.urdf"


def record(folder: Path, name: str, phase: float) -> Path:
    t = np.arange(3000) * 0.005
    w, a = np.array([[1.1, 0.9], [2.7, 2.3]]), np.array([[0.8, 0.9], [0.4, 0.35]])
    angle = w[None] * t[:, None, None] + phase + np.array([0.0, 1.0])
    q, dq, ddq = ((a * wave).sum(axis=1) for wave in (np.sin(angle), w * np.cos(angle), -(w**2) * np.sin(angle)))
    model = read_robot(arm(folder), terms=["viscous", "coulomb"])
    theta = np.array([one.value if one.value is not None else 1.2 for one in model.parameters])
    rng = np.random.default_rng(int(10 * phase))
    tau = model.torque(q, dq, ddq, theta) + 0.1 * rng.standard_normal(q.shape)
    rows = np.column_stack([t, q + 1e-4 * rng.standard_normal(q.shape), tau / GAINS])
    header = "t,shoulder_pos,elbow_pos,shoulder_current,elbow_current"
    np.savetxt(folder / name, rows, delimiter=",", header=header, comments="")
    return folder / name


def draft(folder: Path, robot: Path) -> str:
    logs = [str(record(folder, name, phase)) for name, phase in (("a.csv", 0.0), ("b.csv", 1.3))]
    robot = arm(folder, 2.0) if robot.parent != folder else robot
    done = CliRunner().invoke(main, ["init", str(robot), *logs, "-o", str(folder / "c.yaml")])
    assert done.exit_code == 0, done.output
    return done.output


def test_gains_are_proposed_with_a_question(tmp_path: Path) -> None:
    said = draft(tmp_path, arm(tmp_path))
    text = (tmp_path / "c.yaml").read_text()
    config = parse_config(text, tmp_path / "c.yaml")
    gains = [config.torque[name].gain for name in ("shoulder", "elbow")]
    assert gains == pytest.approx(GAINS, rel=0.05)
    assert "are its masses right?" in said
    assert text.count("from the robot file") == 2


def test_a_heavier_robot_file_makes_larger_gains(tmp_path: Path) -> None:
    """The assumption is what it says: gains go with the masses."""
    draft(tmp_path, Path("heavier"))
    config = parse_config((tmp_path / "c.yaml").read_text(), tmp_path / "c.yaml")
    assert config.torque["shoulder"].gain == pytest.approx(2 * GAINS[0], rel=0.05)


def test_without_masses_the_gains_are_to_be_filled_in(tmp_path: Path) -> None:
    logs = [str(record(tmp_path, "a.csv", 0.0))]
    text = arm(tmp_path).read_text()
    bare = tmp_path / "bare.urdf"
    bare.write_text("".join(part.rpartition("</inertial>")[2] for part in text.split("<inertial>")))
    done = CliRunner().invoke(main, ["init", str(bare), *logs, "-o", str(tmp_path / "c.yaml")])
    assert done.exit_code == 0, done.output
    assert "the gains: torque constant times gear ratio" in done.output
    assert "# shoulder: { column: shoulder_current, gain: ," in (tmp_path / "c.yaml").read_text()
