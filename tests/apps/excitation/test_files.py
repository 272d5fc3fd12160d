"""Files of a designed motion: trajectories, the configuration for the recordings, and grippers, held still."""

import csv
from collections.abc import Sequence
from dataclasses import replace
from io import BytesIO, StringIO
from pathlib import Path

import numpy as np
import pytest
import yaml

from dynident.apps.excitation import MotionLimits, Piece, Purpose, Trajectory
from dynident.apps.excitation.family import Fourier, LinearCourse
from dynident.apps.excitation.files import recording_config, sample_trajectory, trajectory_files
from dynident.apps.excitation.robot import read_excitation
from dynident.apps.excitation.verify import LimitError
from dynident.identification import Sources
from dynident.runtime import InputError
from tests.apps.excitation.arms import LIMITS, TWO
from tests.apps.excitation.test_excitation import CHANNELS, written
from tests.robots import joint, link


def motion(joints: tuple[str, ...] = ("lift", "bend"), period: float = 2.0) -> Trajectory:
    series = Fourier(period, 3)
    x = np.random.default_rng(0).standard_normal((len(joints), series.size))
    return Trajectory(joints, (Piece(LinearCourse(series, x), Purpose.MOTION),))


def wide(joints: Sequence[str] = ("lift", "bend")) -> MotionLimits:
    """Limits of joints within which any motion is."""
    sizes = {"lower": -1e3, "upper": 1e3, "velocity": 1e3, "acceleration": 1e4, "jerk": 1e6, "torque": np.inf}
    return replace(LIMITS, joints=tuple(joints), **{name: np.full(len(joints), size) for name, size in sizes.items()})


WIDE = wide()


def test_samples_end_where_the_motion_does_or_after() -> None:
    t, _ = sample_trajectory(motion(period=2.0), 7.0)
    assert len(t) == 15
    assert t[-1] == pytest.approx(2.0)
    t, states = sample_trajectory(motion(period=1.99), 7.0)
    assert len(t) == 15
    np.testing.assert_allclose(states[-1, 0], motion(period=1.99).states(np.array([1.99]))[0, 0])


@pytest.mark.parametrize("rate", [0.0, -1.0, np.nan, np.inf, 1e9])
def test_a_rate_that_no_file_can_have(rate: float) -> None:
    with pytest.raises(InputError, match="rate"):
        sample_trajectory(motion(), rate)


def test_the_table_has_named_columns_in_si_units_and_the_archive_needs_no_pickle() -> None:
    files = trajectory_files(motion(), "motion", 250.0, WIDE)
    rows = np.loadtxt(StringIO(files["motion.csv"]), delimiter=",", skiprows=1)
    assert files["motion.csv"].splitlines()[0] == "t,q_lift,q_bend,dq_lift,dq_bend,ddq_lift,ddq_bend"
    np.testing.assert_allclose(rows[:, 0], np.arange(501) / 250, atol=1e-12)
    expected = motion().states(rows[:, 0])
    np.testing.assert_allclose(rows[:, 1:].reshape(-1, 3, 2).swapaxes(0, 1), expected[:3], rtol=1e-9, atol=1e-9)
    archive = np.load(BytesIO(files["motion.npz"]), allow_pickle=False)
    assert archive["joints"].tolist() == ["lift", "bend"]
    np.testing.assert_array_equal(archive["ddq"], motion().states(archive["t"])[2])


def test_points_are_denser_where_the_motion_needs_it_and_a_motion_that_no_rate_plays_is_refused() -> None:
    tight = replace(WIDE, jerk=1.0001 * np.abs(motion(period=0.2).states(np.linspace(0, 0.2, 9999))[3]).max(axis=0))
    points = yaml.safe_load(trajectory_files(motion(period=0.2), "motion", 1000.0, tight)["motion.trajectory.yaml"])
    assert len(points["points"]) == 201
    with pytest.raises(LimitError, match=r"jerk between the samples, as a controller plays them.*higher `file_rate`"):
        trajectory_files(motion(period=0.2), "motion", 100.0, tight)


def test_odd_names_of_joints_come_back() -> None:
    names = ["a,b", 'a "b"', "a: b", "ü", "q_a", "- a", "a\nb", "a b #c", "<b>", "1", "\u2028😀"]
    result = trajectory_files(motion(tuple(names)), "motion", 50.0, wide(names))
    header = next(csv.reader(StringIO(result["motion.csv"], newline="")))
    assert header[1 : len(names) + 1] == [f"q_{name}" for name in names]
    assert np.load(BytesIO(result["motion.npz"]))["joints"].tolist() == names
    assert yaml.safe_load(result["motion.trajectory.yaml"])["joint_names"] == names


@pytest.fixture
def robot(tmp_path: Path) -> Path:
    path = tmp_path / "cad" / "two.urdf"
    path.parent.mkdir()
    path.write_text(TWO)
    return path


def test_channels_and_settings_stay_those_of_the_configuration(robot: Path, tmp_path: Path) -> None:
    given = {"model": {"file": "cad/two.urdf"}, **CHANNELS, "smoother": {"kind": "spline", "rule": "fixed", "p": 0.5}}
    path = written(tmp_path / "arm.yaml", given)
    content = yaml.safe_load(recording_config(read_excitation(path), tmp_path / "out"))
    assert content["model"] == {"file": "../cad/two.urdf"}
    for key in ("time", "position", "torque", "smoother"):
        assert content[key] == given[key]
    assert set(content["min_speed"]) == {"lift", "bend"}
    kept = written(tmp_path / "kept.yaml", {**given, "min_speed": 0.3})
    assert yaml.safe_load(recording_config(read_excitation(kept), tmp_path / "out"))["min_speed"] == 0.3
    assert content["train"] == [{"file": "motion_recorded.csv"}]  # monday.csv is not there
    assert content["validation"] == [{"file": "validation_recorded.csv"}]
    assert robot.exists()


@pytest.mark.parametrize("model", ["cad/two.urdf", {"file": "cad/two.urdf"}])
def test_a_model_alone_gets_channels(robot: Path, tmp_path: Path, model: object) -> None:
    path = written(tmp_path / "arm.yaml", {"model": model, "excitation": {"period": 5}})
    content = yaml.safe_load(recording_config(read_excitation(path), tmp_path))
    assert content["model"] == {"file": "cad/two.urdf"}
    assert content["position"]["bend"] == {"column": "q_bend", "unit": "rad"}
    assert content["torque"]["bend"] == {"column": "tau_bend", "unit": "N m"}
    assert content["excitation"] == {"program": "motion", "period": 5}
    assert robot.exists()


def test_logs_that_count_stay_and_new_ones_are_like_them(robot: Path, tmp_path: Path) -> None:
    old = [{"file": {"i": "a/motion_recorded_i.dat", "q": "a/positions.txt"}, "width": {"q": 2}}]
    path = written(tmp_path / "arm.yaml", {"model": {"file": "cad/two.urdf"}, **CHANNELS, "train": old})
    project = read_excitation(path)
    p = len(project.prior.theta)
    reference = replace(project.prior, identification=object(), information=np.eye(p))
    content = yaml.safe_load(recording_config(replace(project, prior=reference), tmp_path))
    new = {"file": {"i": "motion_recorded_2_i.dat", "q": "motion_recorded_2_q.txt"}, "width": {"q": 2}}
    assert content["train"] == [*old, new]
    alone = replace(
        project.prior, identification=object()
    )  # their noise was taken, but what they tell is not announced
    content = yaml.safe_load(recording_config(replace(project, prior=alone), tmp_path))
    assert len(content["train"]) == 1
    assert content["validation"][0]["file"]["q"] == "validation_recorded_q.txt"
    assert robot.exists()


def test_a_model_made_in_python_has_no_configuration(robot: Path, tmp_path: Path) -> None:
    class Found:
        provenance = Sources()

    project = read_excitation(robot)
    assert not recording_config(replace(project, prior=replace(project.prior, identification=Found())), tmp_path)


LIMIT = '<limit effort="{}" velocity="1" lower="{}" upper="{}"/>'


def finger(name: str, kind: str = "prismatic", mass: float = 0.02, parent: str = "lower", mimic: str = "") -> str:
    """A light link that slides or turns, with a name that says nothing."""
    limits = LIMIT.format(20, 0.01, 0.04) + (f'<mimic joint="{mimic}"/>' if mimic else "")
    return link(f"{name}_link", mass, (0.02, 0, 0)) + joint(
        name, kind, parent, f"{name}_link", (0.1, 0, 0), axis=(0, 1, 0), inside=limits
    )


def held(folder: Path, *parts: str, **changes: object) -> dict[str, float]:
    (folder / "arm.urdf").write_text(TWO.replace("</robot>", "".join(parts) + "</robot>"))
    gripper = read_excitation(folder / "arm.urdf", None, {"duration": 9, **changes}).gripper
    return {} if gripper is None else dict(gripper.positions)


@pytest.mark.parametrize(
    ("parts", "positions"),
    [
        ((finger("x"), finger("y")), {"x": 0.01, "y": 0.01}),
        ((finger("x", "revolute"), finger("y", "revolute")), {"x": 0.01, "y": 0.01}),
        ((finger("x"), finger("y", mimic="x")), {"x": 0.01}),
        ((finger("x"), finger("y"), finger("z", "revolute", parent="x_link")), {"x": 0.01, "y": 0.01, "z": 0.01}),
        ((finger("x", mass=2.0), finger("y", mass=2.0)), {}),  # two heavy branches: not fingers
        ((finger("gripper_finger"),), {}),  # a lone joint, whatever its name
        ((), {}),
    ],
)
def test_fingers_are_told_by_structure(tmp_path: Path, parts: tuple[str, ...], positions: dict[str, float]) -> None:
    assert held(tmp_path, *parts) == positions
    assert held(tmp_path, *parts, grippers=True) == {}


def test_the_recordings_are_read_with_the_gripper_held_as_the_note_says(tmp_path: Path) -> None:
    held(tmp_path, finger("x"), finger("y", mimic="x"))
    project = read_excitation(tmp_path / "arm.urdf", None, {"duration": 9})
    assert project.limits.joints == ("lift", "bend")
    data = yaml.safe_load(recording_config(project, tmp_path))
    assert data["model"]["lock"] == {"x": 0.01}
    assert list(data["position"]) == ["lift", "bend"]
    assert str(project.gripper).startswith("x: left out as joints of a gripper")
