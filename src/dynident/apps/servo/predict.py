"""Rollouts of other recordings with a saved result of servos."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from dynident.apps.servo.judge import ServoRollout, roll_out
from dynident.apps.servo.run import interpolate_commands, read_servo_logs
from dynident.apps.servo.saved import load_servo_result
from dynident.apps.servo.start import smooth_servo_log
from dynident.models import Joint
from dynident.project.logs import log_spec
from dynident.runtime import report_progress

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
    saved = load_servo_result(path, allow_code=allow_code)
    specs = tuple(log_spec(name, saved.project.config) for name in names)
    config = saved.project.config.model_copy(update={"train": specs, "validation": ()})
    logs, warnings = read_servo_logs(replace(saved.project, config=config))
    rollouts, before = [], saved.arm.beside(saved.values)
    for log in logs["train"]:
        report_progress(f"simulating {log.name}")
        motion = smooth_servo_log(log) if saved.held else interpolate_commands(smooth_servo_log(log))
        rollouts.append(roll_out(saved.arm.plant, motion, "predict", saved.values, before))
    return ServoPrediction(saved.project.model.joints, tuple(rollouts), (*warnings, *saved.warnings))


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
