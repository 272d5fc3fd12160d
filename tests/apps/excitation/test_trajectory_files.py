"""Trajectories as files: what is read again is what was designed, by whatever reader."""

from io import BytesIO, StringIO

import numpy as np
import pytest
import yaml

from dynident.apps.excitation import Piece, Purpose, Trajectory, files
from dynident.apps.excitation.family import Fourier
from dynident.apps.excitation.files import sample_trajectory, trajectory_files
from dynident.runtime import InputError


def motion(joints: tuple[str, ...] = ("lift", "bend"), period: float = 2.0) -> Trajectory:
    series = Fourier(period, 3)
    x = np.random.default_rng(0).standard_normal((len(joints), series.size))
    return Trajectory(joints, (Piece(series.course(x), Purpose.MOTION),))


def test_samples_end_where_the_motion_does_or_after() -> None:
    one = sample_trajectory(motion(period=2.0), 7.0)
    assert len(one.t) == 15
    assert one.t[-1] == pytest.approx(2.0)
    late = sample_trajectory(motion(period=1.99), 7.0)
    assert len(late.t) == 15
    np.testing.assert_allclose(late.q[-1], motion(period=1.99).states(np.array([1.99]))[0, 0])


@pytest.mark.parametrize("rate", [0.0, -1.0, np.nan, np.inf, 1e9])
def test_a_rate_that_no_file_can_have(rate: float) -> None:
    with pytest.raises(InputError, match="rate"):
        sample_trajectory(motion(), rate)


def test_the_table_has_named_columns_in_si_units() -> None:
    one = motion()
    text = trajectory_files(one, "motion", 250.0)["motion.csv"]
    rows = np.loadtxt(StringIO(text), delimiter=",", skiprows=1)
    assert text.splitlines()[0] == "t,q_lift,q_bend,dq_lift,dq_bend,ddq_lift,ddq_bend"
    np.testing.assert_allclose(rows[:, 0], np.arange(501) / 250, atol=1e-12)
    expected = one.states(rows[:, 0])
    np.testing.assert_allclose(rows[:, 1:].reshape(-1, 3, 2).swapaxes(0, 1), expected[:3], rtol=1e-9, atol=1e-9)


def test_the_archive_needs_no_pickle() -> None:
    found = np.load(BytesIO(trajectory_files(motion(), "motion", 100.0)["motion.npz"]), allow_pickle=False)
    assert found["joints"].tolist() == ["lift", "bend"]
    np.testing.assert_array_equal(found["ddq"], motion().states(found["t"])[2])


def test_ros_gets_at_most_100_points_a_second_with_times_as_it_counts_them() -> None:
    message = yaml.safe_load(trajectory_files(motion(), "motion", 1000.0)["motion.trajectory.yaml"])
    assert message.keys() == {"header", "joint_names", "points"}
    assert len(message["points"]) == 201
    point = message["points"][137]
    assert point.keys() == {"positions", "velocities", "accelerations", "effort", "time_from_start"}
    assert point["time_from_start"] == {"sec": 1, "nanosec": 370_000_000}
    expected = motion().states(np.array([1.37]))[:3, 0]
    found = [point[key] for key in ("positions", "velocities", "accelerations")]
    np.testing.assert_allclose(found, expected, atol=1e-9)
    assert all(isinstance(value, float) for value in point["positions"])


@pytest.mark.parametrize("name", ["a,b", 'a "b"', "a: b", "ü", "q_a", "- a", "a\nb", "a b #c", "<b>"])
def test_odd_names_of_joints_come_back(name: str) -> None:
    assert len(trajectory_files(motion((name, "bend")), "motion", 50.0)) == 3


def test_a_file_that_reads_otherwise_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    write, read = files._FORMATS["csv"]
    monkeypatch.setitem(files._FORMATS, "csv", (lambda one: write(one).replace("1", "2"), read))
    with pytest.raises(InputError, match="is not that of the trajectory"):
        trajectory_files(motion(), "motion", 50.0)
    monkeypatch.setitem(files._FORMATS, "csv", (lambda one: write(one).replace("lift", "x"), read))
    with pytest.raises(InputError, match="names of the joints"):
        trajectory_files(motion(), "motion", 50.0)
    monkeypatch.setitem(files._FORMATS, "csv", (lambda one: write(one).replace(",", ";"), read))
    with pytest.raises(InputError, match="cannot be read again"):
        trajectory_files(motion(), "motion", 50.0)
