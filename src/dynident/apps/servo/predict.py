"""A saved result of servos, and rollouts of other recordings with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING

from dynident.apps.servo.judge import ServoRollout, roll_out
from dynident.apps.servo.run import interpolate_commands, load_servos, read_servo_logs
from dynident.apps.servo.start import smooth_servo_log
from dynident.apps.servo.values import Entry, Quantity
from dynident.models import Joint
from dynident.project.logs import log_spec
from dynident.project.project import parse_project
from dynident.project.result_format import SERVO_FORMAT, SERVO_VERSION
from dynident.project.saved import result_values
from dynident.runtime import InputError, report_progress

if TYPE_CHECKING:
    import polars as pl


@dataclass(frozen=True)
class ServoPrediction:
    """Rollouts of recordings with a saved result, of its ``joints``, and ``warnings``."""

    joints: tuple[Joint, ...]
    rollouts: tuple[ServoRollout, ...]
    warnings: tuple[str, ...]


def predict_servos(path: Path, names: Sequence[str], *, allow_code: bool = False) -> ServoPrediction:
    """Return the rollouts of recordings, named as on a command line, with the result in ``path`` (servo.json).

    Raises InputError where the file is no such result or a recording cannot be used, and the errors of reading the
    configuration and the robot file.
    """
    data = result_values(path)
    try:
        joints = list(map(str, data["joints"]))
        values_by_entry = {
            Entry(Quantity(row["quantity"]), joints.index(row["joint"]) if row["joint"] else 0): float(row["value"])
            for row in data["parameters"]
        }
        text, place = str(data["configuration"]["text"]), Path(data["configuration"]["path"])
        if not all(map(isfinite, values_by_entry.values())):
            raise ValueError("a value is not finite")
        digests, held = dict(data["files"]), bool(data["commands_held"])
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(f"{path}: is no result of servos ({SERVO_FORMAT}): {error!r}.") from error
    if data.get("version") != SERVO_VERSION:
        raise InputError(f"{path}: is of version {data.get('version')}; {SERVO_VERSION} is read. Identify again.")
    project = parse_project(text, place, allow_code=allow_code)
    specs = tuple(log_spec(name, project.config) for name in names)
    project = replace(project, config=project.config.model_copy(update={"train": specs, "validation": ()}))
    arm = load_servos(project)
    if joints != [joint.name for joint in project.model.joints]:
        raise InputError(f"{path}: {', '.join(joints)} are not the joints of the robot file; identify again.")
    values = arm.nominal.changed(list(values_by_entry), list(values_by_entry.values()))
    logs, warnings = read_servo_logs(project)
    file = project.sources.model
    if file is not None and digests.get(file.path) != file.sha256:
        warnings = (*warnings, f"{file.path} is not as it was when the values were found.")
    rollouts = []
    for log in logs["train"]:
        report_progress(f"simulating {log.name}")
        motion = smooth_servo_log(log) if held else interpolate_commands(smooth_servo_log(log))
        rollouts.append(roll_out(arm.plant, motion, "predict", values, arm.beside(values)))
    return ServoPrediction(project.model.joints, tuple(rollouts), tuple(warnings))


def rollout_frame(prediction: ServoPrediction) -> pl.DataFrame:
    """Return all rollouts as one table: log, t (s), and per joint measured_NAME and simulated_NAME, in rad or m."""
    import polars as pl

    parts = []
    for rollout in prediction.rollouts:
        log = rollout.log
        columns: dict[str, object] = {"log": [log.name] * len(log.t), "t": log.t}
        for k, joint in enumerate(prediction.joints):
            columns |= {f"measured_{joint.name}": log.q[:, k], f"simulated_{joint.name}": rollout.simulated[:, k]}
        parts.append(pl.DataFrame(columns))
    return pl.concat(parts)
