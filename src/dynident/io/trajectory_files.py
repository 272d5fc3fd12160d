"""A trajectory as files for robots and programs: CSV, NumPy archive, ROS 2; each is read again before it is written."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from io import BytesIO, StringIO
from typing import Any
from zipfile import BadZipFile

import numpy as np
import yaml
from numpy.typing import NDArray

from dynident.errors import InputError, brief
from dynident.excitation import Trajectory

__all__ = ["ROS_RATE", "Sampled", "sampled", "trajectory_files"]

Array = NDArray[np.float64]
NAMES = ("q", "dq", "ddq")
CLOSE = 1e-9  # largest difference of a file that was read again, in rad, m and per s and s^2
ROS_RATE = 100.0  # Hz
NANO = 1_000_000_000
MOST = 2_000_000  # samples of a file
LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # the former is 10 times as fast


@dataclass(frozen=True, eq=False)
class Sampled:
    """A trajectory at times t (N) s: ``q``, ``dq``, ``ddq`` (N, n), in rad or m, of the named joints."""

    joints: tuple[str, ...]
    t: Array
    q: Array
    dq: Array
    ddq: Array

    __repr__ = brief


def sampled(trajectory: Trajectory, rate: float) -> Sampled:
    """Return a trajectory at ``rate`` (Hz) from 0 to the first sample that is not before its end, where it rests.

    Raises InputError for a rate that is not positive, or gives millions of samples.
    """
    if not (math.isfinite(rate) and rate > 0):
        raise InputError(f"a trajectory cannot be sampled at {rate:g} Hz; give a positive rate.")
    if not trajectory.duration * rate <= MOST:
        raise InputError(
            f"{trajectory.duration:.4g} s at {rate:g} Hz are more than {MOST} samples; give a lower rate, or a shorter "
            "duration."
        )
    t = np.arange(math.ceil(trajectory.duration * rate - 1e-6) + 1) / rate
    q, dq, ddq, _ = trajectory.states(np.minimum(t, trajectory.duration))
    return Sampled(trajectory.joints, t, q, dq, ddq)


def trajectory_files(
    trajectory: Trajectory, stem: str, rate: float, ros_rate: float = ROS_RATE
) -> dict[str, str | bytes]:
    """Return the files of a trajectory by name, all at ``rate`` (Hz) but that for ROS 2, which has at most
    ``ros_rate``: its controllers interpolate between the points.

    ``STEM.csv`` has columns t (s) and by joint q, dq, ddq; ``STEM.npz`` these arrays and the names of the joints;
    ``STEM.trajectory.yaml`` is a ``trajectory_msgs/JointTrajectory``. Raises InputError where a file that is read
    again is not the trajectory, as with names that its format cannot hold.
    """
    found: dict[str, str | bytes] = {}
    for ending, (write, read) in _FORMATS.items():
        wanted = sampled(trajectory, min(rate, ros_rate) if write is _ros else rate)
        found[f"{stem}.{ending}"] = content = write(wanted)
        _prove(f"{stem}.{ending}", wanted, partial(read, content))
    return found


def _prove(name: str, wanted: Sampled, read: Callable[[], Sampled]) -> None:
    """Raise InputError unless a file, read again, holds what was to be written."""
    try:
        found = read()
    except (ValueError, KeyError, TypeError, IndexError, StopIteration, csv.Error, yaml.YAMLError, BadZipFile) as error:
        raise InputError(f"{name}: cannot be read again ({error}); rename joints with odd characters.") from error
    if found.joints != wanted.joints:
        raise InputError(f"{name}: cannot hold the names of the joints {wanted.joints}; rename them in the robot file.")
    for key in ("t", *NAMES):
        one, other = getattr(wanted, key), getattr(found, key)
        if one.shape != other.shape or not np.abs(one - other).max(initial=0.0) <= CLOSE:
            raise InputError(f"{name}: read again, {key} is not that of the trajectory.")


def _csv(one: Sampled) -> str:
    """Return lines of numbers below the names of the columns; in twelve digits."""
    text = StringIO()
    csv.writer(text, lineterminator="\n").writerow(["t", *(f"{key}_{joint}" for key in NAMES for joint in one.joints)])
    np.savetxt(text, np.column_stack([one.t, one.q, one.dq, one.ddq]), fmt="%.12g", delimiter=",")
    return text.getvalue()


def _from_csv(text: str) -> Sampled:
    lines = StringIO(text)
    head = next(csv.reader(lines))
    rows = np.loadtxt(lines, delimiter=",", ndmin=2)
    n = (len(head) - 1) // 3
    joints = tuple(name.removeprefix("q_") for name in head[1 : 1 + n])
    if head != ["t", *(f"{key}_{joint}" for key in NAMES for joint in joints)]:
        raise ValueError("its columns are others")
    return Sampled(joints, rows[:, 0], *np.split(rows[:, 1:], 3, axis=1))


def _npz(one: Sampled) -> bytes:
    file = BytesIO()
    arrays = {key: getattr(one, key) for key in ("t", *NAMES)}
    np.savez(file, joints=np.array(one.joints), **arrays)
    return file.getvalue()


def _from_npz(content: bytes) -> Sampled:
    with np.load(BytesIO(content), allow_pickle=False) as found:
        return Sampled(tuple(found["joints"].tolist()), *(found[key] for key in ("t", *NAMES)))


def _ros(one: Sampled) -> str:
    """Return the message with a point a line; JSON is YAML, and its strings are escaped."""
    lines = [
        "# A trajectory_msgs/msg/JointTrajectory, in rad or m and s. The controller interpolates between the points,",
        "# at best by quintic splines. To send it (the name of the controller is yours):",
        "#   ros2 topic pub --once /joint_trajectory_controller/joint_trajectory \\",
        '#     trajectory_msgs/msg/JointTrajectory "$(cat THIS_FILE)"',
        'header: { stamp: { sec: 0, nanosec: 0 }, frame_id: "" }',
        f"joint_names: {json.dumps(one.joints)}",
        "points:",
    ]
    return "\n".join([*lines, *_points(one)]) + "\n"


def _points(one: Sampled) -> Iterator[str]:
    for t, q, dq, ddq in zip(one.t.tolist(), one.q, one.dq, one.ddq, strict=True):
        sec, nanosec = divmod(round(t * NANO), NANO)
        yield (
            f"- {{ positions: {_row(q)}, velocities: {_row(dq)}, accelerations: {_row(ddq)}, effort: [], "
            f"time_from_start: {{ sec: {sec}, nanosec: {nanosec} }} }}"
        )


def _row(values: Array) -> str:
    """Return numbers that YAML reads as such, also in ROS: always with a point."""
    texts = (f"{value:.12f}".rstrip("0") for value in values.tolist())
    return f"[{', '.join(text + '0' if text.endswith('.') else text for text in texts)}]"


def _from_ros(text: str) -> Sampled:
    message: Mapping[str, Any] = yaml.load(text, LOADER)  # noqa: S506 -- both loaders are safe
    points = message["points"]
    t = np.array([one["time_from_start"]["sec"] + one["time_from_start"]["nanosec"] / NANO for one in points])
    arrays = (np.array([one[key] for one in points]) for key in ("positions", "velocities", "accelerations"))
    return Sampled(tuple(message["joint_names"]), t, *arrays)


_FORMATS: Mapping[str, tuple[Callable[[Sampled], Any], Callable[[Any], Sampled]]] = {
    "csv": (_csv, _from_csv),
    "npz": (_npz, _from_npz),
    "trajectory.yaml": (_ros, _from_ros),
}
