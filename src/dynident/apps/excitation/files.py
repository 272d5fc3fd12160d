"""The draft of a configuration that reads the recordings of a designed motion."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from io import BytesIO
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from dynident.apps.excitation.chirp import csv_text
from dynident.apps.excitation.limits import MotionLimits, min_fit_speeds
from dynident.apps.excitation.motion import point_spacing
from dynident.apps.excitation.players import ROS, ur_script
from dynident.apps.excitation.robot import ExcitationProject
from dynident.apps.excitation.trajectory import Trajectory
from dynident.apps.excitation.verify import QUANTITIES, LimitError
from dynident.apps.excitation.way import quintic_bounds
from dynident.files.opener import real_path, relative
from dynident.files.yaml_text import load_yaml
from dynident.identification import SourceFile
from dynident.models import Joint
from dynident.project.explicit_config import relocate_settings, settings_text
from dynident.project.settings import robot_settings
from dynident.runtime import InputError
from dynident.runtime.arrays import Array

STATE_NAMES = ("q", "dq", "ddq")
INTERPOLATION_TOLERANCE = 1e-3  # of a limit, for smooth motion between samples; jumps of the jerk take 1e-1 and more
BLOCK_SAMPLES = 500
NANO = 1_000_000_000
MAX_SAMPLES = 2_000_000  # samples of a file
RECORDED = {"train": "motion_recorded", "validation": "validation_recorded"}  # names of the recordings by role
COLUMN_PREFIXES = ("t", "q", "tau")  # columns, before the names of the joints
_HEAD = (
    "For `dynident check` and `dynident identify`, once the motions of this folder are recorded: save the recordings",
    "under the names below, or correct these.",
)
_FLOOR = "for the next design; without `floor` (m, along z of the root link) the arm may reach below its base: floor: 0"
_SLOW = "slower samples are left out of a joint's equation, where friction may hold it with any torque"
_COLUMNS = "? columns and units as your recorder has them; or draft this anew from the recordings, by `dynident init`"


def sample_trajectory(trajectory: Trajectory, rate: float) -> tuple[Array, Array]:
    """Return times (N) s at ``rate`` (Hz), from 0 to the first that is not before the end, where the arm rests, and the
    states q, dq and ddq there (N, 3, n), in rad or m.

    Raises InputError for a rate that is not positive, or gives millions of samples.
    """
    if not 0 < trajectory.duration * rate <= MAX_SAMPLES:
        raise InputError(
            f"{trajectory.duration:.4g} s at {rate:g} Hz are no samples, or more than {MAX_SAMPLES}; give another "
            "rate, or a shorter duration."
        )
    # the tolerance keeps a duration of whole samples from getting one more by rounding
    t = np.arange(math.ceil(trajectory.duration * rate - 1e-6) + 1) / rate
    # samples behind the end are at rest at the last point
    return t, trajectory.states(np.minimum(t, trajectory.duration))[:3].transpose(1, 0, 2)


def trajectory_files(
    trajectory: Trajectory, stem: str, rate: float, limits: MotionLimits, thinning: int = 1
) -> dict[str, str | bytes]:
    """Return the files of a trajectory by name, tables at ``rate`` (Hz).

    ``STEM.csv`` has columns t (s) and by joint q, dq, ddq; ``STEM.npz`` these arrays and the names of the joints;
    ``STEM.trajectory.yaml`` is a ``trajectory_msgs/JointTrajectory``, ``STEM.script`` a URScript, for arms of Universal
    Robots alone. As these interpolate between the points, they have every sample of ``thinning`` times as many as make
    at most 100 per s, or all samples where that is too coarse. Raises LimitError where what is played between the
    samples leaves the ``limits``.
    """
    joints, (t, states) = trajectory.joints, sample_trajectory(trajectory, rate)
    times, points = sample_trajectory(trajectory, rate / (thinning * point_spacing(rate)))
    try:
        check_interpolant(times, points, limits)
    except LimitError:
        times, points = t, states
        check_interpolant(times, points, limits)
    names = ["t", *(f"{key}_{joint}" for key in STATE_NAMES for joint in joints)]
    npz = BytesIO()
    signals = dict(zip(STATE_NAMES, states.transpose(1, 0, 2), strict=True))
    np.savez(npz, joints=np.array(joints), t=t, **signals)
    script = ur_script(joints, times, points, stem)
    return {
        f"{stem}.csv": csv_text(names, np.column_stack([t, states.reshape(len(t), -1)]), digits=12),
        f"{stem}.npz": npz.getvalue(),
        f"{stem}.trajectory.yaml": _to_ros(joints, times, points, stem),
        **({} if script is None else {f"{stem}.script": script}),
    }


def check_interpolant(t: Array, states: Array, limits: MotionLimits) -> None:
    """Raise LimitError where quintics between points at times t (N) s, of states q, dq and ddq (N, 3, n), leave the
    limits of a motion.

    It is these that a controller plays. They are the motion itself where no piece begins between two points.
    """
    middles, sizes = np.stack([limits.middle, *np.zeros((3, len(limits.joints)))]), limits.sizes
    for k in range(0, len(states) - 1, BLOCK_SAMPLES):
        block, steps = states[k : k + BLOCK_SAMPLES + 1], np.diff(t[k : k + BLOCK_SAMPLES + 1])
        low, high, derivatives = quintic_bounds(block[:-1], block[1:], steps)
        reached = np.maximum(high - limits.middle, limits.middle - low)[:, None]
        shares = np.concatenate([reached, derivatives], axis=1) / sizes
        if not shares.max(initial=0.0) <= 1 + INTERPOLATION_TOLERANCE:
            row, d, joint = np.unravel_index(int(shares.argmax()), shares.shape)
            words = (
                f"{QUANTITIES[d]} between the samples, as a controller plays them, deviates from "
                f"{middles[d, joint]:.4g} by {shares[row, d, joint] * sizes[d, joint]:.6g}, beyond its limit "
                f"{sizes[d, joint]:.6g}; give a higher `file_rate`"
            )
            raise LimitError.at(limits.joints[joint], float(t[k + row]), words)


def _to_ros(joints: tuple[str, ...], times: Array, points: Array, stem: str) -> str:
    """Return the message with one point per line."""
    # in quotes and escaped, as any name may stand in a robot file
    names = yaml.safe_dump(list(joints), default_style='"', default_flow_style=True, width=math.inf).strip()
    lines = [
        "# A trajectory_msgs/msg/JointTrajectory, in rad or m and s. The controller interpolates between the points,",
        "# at best by quintic splines. To send it as one goal, from the place where the motion starts (the name of the",
        "# controller is yours):",
        f"#   python3 {ROS} {stem}.trajectory.yaml --controller joint_trajectory_controller",
        'header: { stamp: { sec: 0, nanosec: 0 }, frame_id: "" }',
        f"joint_names: {names}",
        "points:",
    ]
    for t, point in zip(times.tolist(), points, strict=True):
        sec, nanosec = divmod(round(t * NANO), NANO)
        q, dq, ddq = map(_number_list, point)
        lines.append(
            f"- {{ positions: {q}, velocities: {dq}, accelerations: {ddq}, "
            f"effort: [], time_from_start: {{ sec: {sec}, nanosec: {nanosec} }} }}"
        )
    return "\n".join(lines) + "\n"


def _number_list(values: Array) -> str:
    """Return numbers that YAML, also in ROS, reads as floats: always with a point."""
    texts = (f"{value:.12f}".rstrip("0") for value in values.tolist())
    return f"[{', '.join(text + '0' if text.endswith('.') else text for text in texts)}]"


def recording_config(project: ExcitationProject, folder: Path) -> str:
    """Return the configuration, to lie in ``folder``, that reads the recordings of both motions.

    Columns, gains and all else are those of the configuration that the project came from, whose own training stays in
    the fit where the announced errors count it; without one they are to be confirmed. The settings of the motion are in
    it, too. "" where a model was made from Python, so that no configuration can name it.
    """
    data, old_folder = _config_data(project)
    if not data:
        return ""
    keeps_training = project.prior.information is not None
    data = relocate_settings(data, old_folder, real_path(folder))
    comments: dict[str, tuple[str, ...]] = {"": _HEAD}
    # without channels of a configuration, those of the files of the motion are proposed
    if "time" not in data:
        data = {"model": data["model"], **_default_channels(project.prior.model.joints)}
        comments |= {"time": (_COLUMNS,)}
    # earlier training logs stay in the fit where the announced errors count them
    old_logs = list(data.get("train") or ()) if keeps_training else []
    template = old_logs[0] if old_logs else next(iter(data.get("train") or ()), {})
    used_names = {_log_name(entry) for entry in (*old_logs, *(data.get("validation") or ()))}
    logs = {role: _free_log(template, name, used_names) for role, name in RECORDED.items()}
    data |= {"train": [*old_logs, logs["train"]], "validation": [logs["validation"]]}
    speeds = min_fit_speeds(project.prior.model, project.limits)
    slow = {name: round(float(x), 4) for name, x in zip(project.limits.joints, speeds, strict=True) if x}
    if slow and "min_speed" not in data:
        data, comments = {**data, "min_speed": slow}, comments | {"min_speed": (_SLOW,)}
    motion_settings = project.settings.model_dump(mode="json", exclude_unset=True)
    if "packages" in motion_settings:
        motion_settings["packages"] = [relative(Path(name), real_path(folder)) for name in motion_settings["packages"]]
    comments |= {"excitation": () if "floor" in motion_settings else (_FLOOR,)}
    return settings_text({**data, "excitation": {"program": project.settings.program, **motion_settings}}, comments)


def _config_data(project: ExcitationProject) -> tuple[Mapping[str, Any], Path]:
    """Return the settings of the configuration, at least of the model, and the folder that its names start at."""
    lock = {} if project.gripper is None else {"lock": dict(project.gripper.positions)}
    if project.config is not None:
        data = load_yaml(project.config.text, project.config.path)
        if isinstance(data["model"], str) and robot_settings(data["model"]) is not None:
            data["model"] = {"file": data["model"]}
        return {**data, "model": {**data["model"], **lock} if lock else data["model"]}, Path(project.config.path).parent
    identification = project.prior.identification
    source = SourceFile(str(project.path)) if identification is None else identification.provenance.model
    return ({} if source is None else {"model": {"file": source.path, **lock}}), Path()


def _default_channels(joints: tuple[Joint, ...]) -> dict[str, Any]:
    """Return the channels of a recording whose columns are named as those of the motion are."""
    t, q, tau = COLUMN_PREFIXES
    return {
        "time": {"column": t, "unit": "s"},
        "position": {joint.name: {"column": f"{q}_{joint.name}", "unit": joint.unit} for joint in joints},
        "torque": {joint.name: {"column": f"{tau}_{joint.name}", "unit": joint.effort} for joint in joints},
        "estimator": {"kind": "consistent"},
    }


def _log_name(log: Mapping[str, Any]) -> str:
    """Return the name of a log, as far as a new one may clash with it."""
    file = log["file"]
    return str(log.get("name") or Path(str(next(iter(file.values())) if isinstance(file, Mapping) else file)).stem)


def _free_log(template: Mapping[str, Any], name: str, used_names: Collection[str]) -> dict[str, Any]:
    """Return a log whose name is free, with a number where need be."""
    logs = (_log_entry(template, name if k == 1 else f"{name}_{k}") for k in count(1))
    return next(log for log in logs if _log_name(log) not in used_names)


def _log_entry(template: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return a recording as a configuration names it, of the kind and in as many files as another one."""
    file = template.get("file", ".csv")
    width = {"width": template["width"]} if "width" in template else {}
    if isinstance(file, Mapping):
        return {"file": {key: f"{name}_{key}{_suffix(path)}" for key, path in file.items()}, **width}
    return {"file": f"{name}{_suffix(file)}", **width}


def _suffix(file: Any) -> str:
    return Path(f"x{file}" if str(file).startswith(".") else str(file)).suffix or ".csv"
