"""The configuration that reads the recordings of a designed motion."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from dynident.apps.excitation import Piece, Purpose, Trajectory
from dynident.apps.excitation.family import Fourier
from dynident.apps.excitation.files import recording_config, sample_trajectory
from dynident.apps.excitation.robot import read_excitation
from dynident.identification import Sources
from dynident.project.project import parse_project
from tests.apps.excitation.arms import MODEL, THETA, TWO
from tests.apps.excitation.test_excitation import CHANNELS, written


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    path = tmp_path / "cad" / "two.urdf"
    path.parent.mkdir()
    path.write_text(TWO)
    return path


def test_a_recording_of_the_motion_is_read(robot: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    out.mkdir()
    text = recording_config(read_excitation(robot, None, {"duration": 9}), out)
    assert "# ? columns and units" in text
    series = Fourier(2.0, 3)
    one = sample_trajectory(
        Trajectory(("lift", "bend"), (Piece(series.course(np.full((2, series.size), 0.1)), Purpose.MOTION),) * 4), 200.0
    )
    tau = MODEL.torque(one.q, one.dq, one.ddq, THETA)
    for name in ("motion_recorded.csv", "validation_recorded.csv"):
        table = np.column_stack([one.t, one.q, tau])
        np.savetxt(out / name, table, delimiter=",", header="t,q_lift,q_bend,tau_lift,tau_bend", comments="")
    project = parse_project(text, out / "identify.yaml")
    logs, _ = project.logs()
    assert [*logs["train"], *logs["validation"]] == ["motion_recorded", "validation_recorded"]
    np.testing.assert_allclose(logs["train"]["motion_recorded"].tau, tau, atol=1e-9)
    assert project.config.min_speed == {"lift": 0.054, "bend": 0.081}
    assert project.config.excitation is not None
    assert project.config.excitation.duration == 9


def test_channels_and_settings_stay_those_of_the_configuration(robot: Path, tmp_path: Path) -> None:
    given = {"model": {"file": "cad/two.urdf"}, **CHANNELS, "smoother": {"kind": "spline", "rule": "fixed", "p": 0.5}}
    path = written(tmp_path / "arm.yaml", given)
    found = yaml.safe_load(recording_config(read_excitation(path), tmp_path / "out"))
    assert found["model"] == {"file": "../cad/two.urdf"}
    for key in ("time", "position", "torque", "smoother"):
        assert found[key] == given[key]
    assert set(found["min_speed"]) == {"lift", "bend"}
    kept = written(tmp_path / "kept.yaml", {**given, "min_speed": 0.3})
    assert yaml.safe_load(recording_config(read_excitation(kept), tmp_path / "out"))["min_speed"] == 0.3
    assert found["train"] == [{"file": "motion_recorded.csv"}]  # monday.csv is not there
    assert found["validation"] == [{"file": "validation_recorded.csv"}]
    assert robot.exists()


@pytest.mark.parametrize("model", ["cad/two.urdf", {"file": "cad/two.urdf"}])
def test_a_model_alone_gets_channels(robot: Path, tmp_path: Path, model: object) -> None:
    path = written(tmp_path / "arm.yaml", {"model": model, "excitation": {"period": 5}})
    found = yaml.safe_load(recording_config(read_excitation(path), tmp_path))
    assert found["model"] == {"file": "cad/two.urdf"}
    assert found["position"]["bend"] == {"column": "q_bend", "unit": "rad"}
    assert found["torque"]["bend"] == {"column": "tau_bend", "unit": "N m"}
    assert found["excitation"] == {"program": "motion", "period": 5}
    assert robot.exists()


def test_logs_that_count_stay_and_new_ones_are_like_them(robot: Path, tmp_path: Path) -> None:
    old = [{"file": {"i": "a/motion_recorded_i.dat", "q": "a/positions.txt"}, "width": {"q": 2}}]
    path = written(tmp_path / "arm.yaml", {"model": {"file": "cad/two.urdf"}, **CHANNELS, "train": old})
    project = read_excitation(path)
    p = len(project.prior.theta)
    known = replace(project.prior, identification=object(), information=np.eye(p))
    found = yaml.safe_load(recording_config(replace(project, prior=known), tmp_path))
    new = {"file": {"i": "motion_recorded_2_i.dat", "q": "motion_recorded_2_q.txt"}, "width": {"q": 2}}
    assert found["train"] == [*old, new]
    alone = replace(
        project.prior, identification=object()
    )  # their noise was taken, but what they tell is not announced
    found = yaml.safe_load(recording_config(replace(project, prior=alone), tmp_path))
    assert len(found["train"]) == 1
    assert found["validation"][0]["file"]["q"] == "validation_recorded_q.txt"
    assert robot.exists()


def test_a_model_made_in_python_has_no_configuration(robot: Path, tmp_path: Path) -> None:
    class Found:
        provenance = Sources()

    project = read_excitation(robot)
    assert not recording_config(replace(project, prior=replace(project.prior, identification=Found())), tmp_path)
