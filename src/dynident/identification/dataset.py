"""The logs of an identification by role, from the recordings to the motions that are fitted and validated."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from dynident.identification.outliers import mask_outliers
from dynident.identification.recipe import Recipe, Rests, without_rests
from dynident.models import Model
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import SUBSTITUTE, Smoother, smooth_log
from dynident.runtime import (
    ConfigError,
    InputError,
    Note,
    Noun,
    Severity,
    Step,
    check_type,
    join_names,
    percent,
    report_progress,
    short,
)
from dynident.validation import LogValidation

Logs = Log | Mapping[str, Log] | Sequence[Log]  # as they are given
LogsByRole = Mapping[str, Mapping[str, Log]]
Motions = dict[str, dict[str, Motion]]
MAX_EXCLUDED_SHARE = 0.05  # share of a held-out log that may be excluded without a warning


class NotFitted(Note):
    """The torque equations of these ``joints`` are not fitted, as the recipe asks; they are predicted and judged."""

    severity = Severity.INFO
    joints: tuple[str, ...]

    def __str__(self) -> str:
        return f"torques that are not fitted, only predicted and judged, by `unfitted`: {', '.join(self.joints)}"


class NotLogged(Note):
    """No log has these ``joints`` of the robot file: they are locked at ``positions``, in rad or m."""

    joints: tuple[str, ...]
    positions: tuple[float, ...]

    def __str__(self) -> str:
        places = (f"{name!r} at {short(value)}" for name, value in zip(self.joints, self.positions, strict=True))
        return (
            f"in none of the logs, so locked (rad, m): {join_names(places, 5)}; what they carry is part of the body "
            "before them. Where they stand elsewhere, say so by `lock`"
        )


class NotJudged(Note):
    """Of the held-out ``log`` the configuration excludes a ``share`` (%): its error is that of the rest."""

    log: str
    share: float

    def __str__(self) -> str:
        return (
            f"{percent(self.share)} of {self.log}, which is held out, are not judged, by `exclude`: its torque error "
            "is that of the rest. Exclude only what the robot is not to blame for, such as a collision"
        )


def exclusion_notes(validations: Sequence[LogValidation]) -> Iterator[NotJudged]:
    """Yield a note for each held-out log with signals of which more than 5 % is excluded."""
    for validation in validations:
        excluded = None if validation.recorded_log is None else validation.recorded_log.excluded
        if validation.role == "validation" and excluded is not None and excluded.mean() > MAX_EXCLUDED_SHARE:
            yield NotJudged(validation.name, 100.0 * float(excluded.mean()))


class SubstituteUsed(Note):
    """The ``log``, which is judged and not fitted, has not the motion that the smoother is made for, whose class is
    ``smoother``; it is smoothed by another ``method``."""

    severity = Severity.INFO
    log: str
    smoother: str
    method: str

    def __str__(self) -> str:
        return (
            f"{self.log} lacks the motion that {self.smoother} is made for; as it is only judged, another smooths "
            f"it: {self.method}. Its torque error also holds what that leaves of the noise or takes of the motion: "
            "compare it with that of other models on this recording, not with the error on training"
        )


def substitute_notes(validations: Sequence[LogValidation]) -> Iterator[SubstituteUsed]:
    """Yield a note for each log with signals that a substitute of the smoother has smoothed."""
    for validation in validations:
        smoothing = {} if validation.signals is None else validation.motion.smoothing
        if SUBSTITUTE in smoothing:
            yield SubstituteUsed(validation.name, smoothing[SUBSTITUTE], smoothing["method"])


class RoleMotions(Noun):
    """Motions ``by_role`` ("train", "validation") and name, as they are fitted and judged, and the ``rests`` of the
    training."""

    by_role: Motions
    rests: tuple[Rests, ...] = ()

    @property
    def train(self) -> tuple[Motion, ...]:
        """The motions that are fitted."""
        return tuple(self.by_role["train"].values())

    def remember(self, model: Model) -> RoleMotions:
        """Return the same with the memory states of another model in what is fitted."""
        train = {name: model.remembering(motion) for name, motion in self.by_role["train"].items()}
        return RoleMotions(self.by_role | {"train": train}, self.rests)


class Dataset(Noun):
    """Logs by role ("train", "validation") and name: as ``recorded``, without rests at their ends (``trimmed``), and
    without outliers in what is smoothed and fitted (``repaired``)."""

    recorded: LogsByRole
    trimmed: LogsByRole
    repaired: LogsByRole

    @classmethod
    def of(
        cls,
        train: Logs,
        validation: Logs,
        recipe: Recipe,
        joints: tuple[str, ...],
    ) -> Dataset:
        """Return the logs of these joints in this order.

        ConfigError where none is to be fitted or joints that are not are unknown, InputError where no torque is.
        """
        recipe.check_joints(joints)
        roles = {"train": logs_by_name(train, "logs"), "validation": logs_by_name(validation, "validation")}
        if not roles["train"]:
            raise ConfigError("no training log is given; name at least one.")
        if not any(log.tau.any() for log in roles["train"].values()):
            raise InputError(
                "all torques of the training are zero; check that the right columns are named and recorded."
            )
        recorded = {role: {name: log.select(joints) for name, log in logs.items()} for role, logs in roles.items()}
        trimmed = {role: {name: recipe.trim(log) for name, log in logs.items()} for role, logs in recorded.items()}
        repaired = {role: {name: recipe.repair(log, torque=role == "train") for name, log in logs.items()}
                    for role, logs in trimmed.items()}  # fmt: skip
        return cls(recorded, trimmed, repaired)

    @property
    def train_logs(self) -> tuple[Log, ...]:
        """The logs of the training as they are smoothed."""
        return tuple(self.repaired["train"].values())

    def motions(self, model: Model, smoother: Smoother, recipe: Recipe) -> RoleMotions:
        """Return the motions of all logs, with the memory states of the model.

        Of the motions of the training, what is not fitted is left out.
        """
        return self.prepare_motions(model, self.smooth(smoother), recipe)

    def smooth(self, smoother: Smoother) -> Motions:
        """Return the motions by role and name.

        Those that are only validated are smoothed by a substitute where the smoother does not apply. Raises the
        errors of the smoother.
        """
        motions: Motions = {role: {} for role in self.repaired}
        role_logs = [(role, *named_log) for role, logs in self.repaired.items() for named_log in logs.items()]
        for k, (role, name, log) in enumerate(role_logs):
            report_progress(Step("smoothing the logs", k, len(role_logs)))
            motions[role][name] = smooth_log(smoother, log, judge_only=role != "train")
        return motions

    def prepare_motions(self, model: Model, smoothed_motions: Motions, recipe: Recipe) -> RoleMotions:
        """Return smoothed motions with the memory states of the model, and the rests of the training.

        Of the motions of the training, what is not fitted is left out.
        """
        motions = {
            role: {name: model.remembering(smoothed_motion) for name, smoothed_motion in by_name.items()}
            for role, by_name in smoothed_motions.items()
        }
        selection = recipe.selection(model.joints)
        # Outliers before rests: whether rests are left out is decided on torques that are right.
        if recipe.outliers == "mask":
            motions = mask_outliers(model, motions, self.trimmed, selection)
        motions["train"], rests = without_rests(model, motions["train"], self.recorded, recipe.rests, selection)
        _check_speeds(recipe, selection.min_speed, tuple(motions["train"].values()))
        motions["train"] = {name: recipe.drop_unfitted(motion) for name, motion in motions["train"].items()}
        return RoleMotions(motions, rests)

    def fitted_logs(self, motions: RoleMotions) -> tuple[Log, ...]:
        """Return the logs of the training with the torques that are fitted."""
        pairs = zip(self.train_logs, motions.train, strict=True)
        return tuple(replace(log, tau=motion.tau) for log, motion in pairs)


def _check_speeds(recipe: Recipe, speeds: tuple[float, ...] | None, motions: Sequence[Motion]) -> None:
    """Raise ConfigError where ``min_speed`` leaves out every sample of a joint that it names, or of all joints."""
    if speeds is None:
        return
    joints = motions[0].joints
    fastest = [max(float(np.abs(motion.dq[motion.mask, j]).max(initial=0.0)) for motion in motions)
               for j in range(len(joints))]  # fmt: skip
    slow = [j for j, speed in enumerate(speeds) if speed > fastest[j] and joints[j] not in recipe.unfitted]
    # a single number for all joints may leave out one that is held
    if slow and (isinstance(recipe.min_speed, Mapping) or len(slow) + len(recipe.unfitted) >= len(joints)):
        j = slow[0]
        raise ConfigError(
            f"min_speed: is {speeds[j]:g} for {joints[j]!r}, whose speed reaches {short(fastest[j])} (rad/s or m/s), "
            "so that no sample of it is fitted; lower it, or name the joint by `unfitted`."
        )


def logs_by_name(logs: Any, argument: str) -> dict[str, Log]:
    """Return the logs by name; InputError where one is not a Log, ConfigError where two have one name."""
    if isinstance(logs, str | Path):
        raise InputError(f"{argument}: {str(logs)!r} is a file; read it with `read_log`, which asks for its columns.")
    several = (logs,) if isinstance(logs, Log) else logs
    check_type(argument, several, Iterable, "give a Log, logs by name, or a sequence of them")
    pairs = (
        list(several.items())
        if isinstance(several, Mapping)
        else [(getattr(entry, "source", ""), entry) for entry in several]
    )
    for name, log in pairs:
        if not isinstance(log, Log):
            hint = "; give its `log`" if isinstance(getattr(log, "log", None), Log) else ""
            hint = "; read the file with `read_log`" if isinstance(log, str | Path) else hint
            raise InputError(f"{argument}: {name!r} is a {type(log).__name__}, not a Log{hint}.")
    if len(dict(pairs)) < len(pairs):
        raise ConfigError(
            f"{argument}: two logs have the same source among {[name for name, _ in pairs]}; give them by name."
        )
    return dict(pairs)
