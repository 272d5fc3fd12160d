"""What all combinations have in common: the model, the logs, and which torques of them are fitted."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from hashlib import sha256
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dynident.checks import loop_findings, with_findings
from dynident.errors import Finding, InputError, Use, brief
from dynident.estimators import Estimator, LeastSquares, quick
from dynident.estimators.estimator import HasQuick
from dynident.identification import Identification, Pairing, Recipe, TimeOffset, identify, pair
from dynident.identification.role_logs import RoleLogs
from dynident.io.digests import settings_digest
from dynident.io.logs import turning_joints
from dynident.io.project import Project
from dynident.io.yaml_text import load_yaml
from dynident.jobs.software import code_version
from dynident.log import Log, Motion
from dynident.models import Model
from dynident.ranking.blocks import Blocks, blocks_of
from dynident.ranking.truth import Truth
from dynident.regression import fitted_rows
from dynident.smoothers import Smoother

__all__ = ["ROLES", "Task", "task_of"]

Mask = NDArray[np.bool_]
Masks = Mapping[str, Mapping[str, Mask]]
Progress = Callable[[str], None]
ROLES = ("train", "validation")
OTHER = ("compare", "excitation", "train", "validation")  # sections that change nothing, or are logs


@dataclass(frozen=True, eq=False)
class Task:
    """A model and logs that every combination fits and predicts: the same samples, the same equations.

    ``model`` and ``recipe`` are as the configuration's own recipe has made them: terms, tilt of the base, time
    ``offset``. ``logs`` are by role and name; ``motions`` those of the configured smoother, of which the torque and
    what is ``kept`` for the fit hold for all. ``folds`` are those of the cross-validation. ``digest`` tells a task from
    others. ``truth``, where it is known. ``findings`` of the checks forbid the use of any model of these logs, or are
    about the controllers with which some estimators simulate.
    """

    model: Model
    recipe: Recipe
    logs: RoleLogs
    motions: Mapping[str, Mapping[str, Motion]]
    offset: TimeOffset | None
    folds: int
    digest: str
    truth: Truth | None = None
    findings: tuple[Finding, ...] = ()

    __repr__ = brief

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the n joints."""
        return tuple(joint.name for joint in self.model.joints)

    @property
    def held_out(self) -> bool:
        """Whether any log is held out."""
        return bool(self.logs.repaired["validation"])

    @property
    def late(self) -> float:
        """The time offset (s) between positions and torque, by the configured smoother."""
        late = self.recipe.time_offset
        return float(late) if late != "estimate" else 0.0

    def paired(self, parts: Sequence[Smoother], *, own: bool) -> Pairing:
        """Return the smoother that is taken of ``parts``, with its time offset.

        Where the recipe estimates that, each smoother has one of its own, as if it were the configured one: smoothers
        differ in what looks like an offset, and that of one would be unfair to all others.
        """
        if own:
            return Pairing(self.recipe.smoothers[0], None, self.offset)
        late: float | Literal["estimate"] = self.late if self.offset is None else "estimate"
        logs, speeds = list(self.logs.repaired["train"].values()), self.recipe.min_speeds(self.joints)
        return pair(self.model, logs, parts, late, self.recipe.estimator, speeds)

    @cached_property
    def kept(self) -> Mapping[str, Mapping[str, Mask]]:
        """Which torque equations (N, n) of each log may be fitted or judged, whatever the smoother."""
        speeds = self.recipe.min_speeds(self.joints)
        found: dict[str, dict[str, Mask]] = {"train": {}, "validation": {}}
        for role, named in self.motions.items():
            for name, motion in named.items():
                rows = fitted_rows(motion, speeds) if role == "train" else motion.keep
                found[role][name] = np.ones(motion.q.shape, dtype=bool) if rows is None else rows
        return found

    @cached_property
    def blocks(self) -> Mapping[str, Blocks]:
        """The blocks of time of the logs of each role."""
        return {role: blocks_of(self.logs.repaired[role]) for role in ROLES}

    def torque_squares(self, masks: Masks, role: str, *, fitted: bool) -> NDArray[np.float64]:
        """Return the sums of squares (K, n) of the measured torque in the blocks of a role, on samples in ``masks``;
        where ``fitted`` of the equations that may be fitted."""
        return self.squares({name: one.tau for name, one in self.motions[role].items()}, masks, role, fitted=fitted)

    def squares(
        self, torques: Mapping[str, NDArray[np.float64]], masks: Masks, role: str, *, fitted: bool
    ) -> NDArray[np.float64]:
        """Return the same of any torques (N, n) by log."""
        used = {}
        for name, tau in torques.items():
            rows = masks[role][name][:, None] & (self.kept[role][name] if fitted else True)
            used[name] = np.where(rows, np.square(tau), 0.0)
        return self.blocks[role].sums(used)


def task_of(project: Project, folds: int, truth: Truth | None, progress: Progress) -> tuple[Task, Identification]:
    """Return what the recipe of a project makes of its logs, and the identification that has made it.

    The estimator of this first fit is the fast substitute of the configured one, or least squares. Raises the errors of
    reading and of ``identify``, and InputError for logs that are too long for the memory.
    """
    if project.long:
        raise InputError(
            f"{project.path}: the training is too long for the memory, and such logs are fitted in pieces, which only "
            "`dynident identify` does; compare on a `window` of them."
        )
    read, _ = project.logs(progress)
    plain = {role: {name: replace(log, controller=None) for name, log in some.items()} for role, some in read.items()}
    first = replace(project.recipe, estimator=_fast(project.recipe.estimator), restart=None)
    found = identify(project.model, plain["train"], plain["validation"], first, progress=progress)
    turning = turning_joints(project.config)
    checked = with_findings(found, project.model, plain, project.recipe, multi_turn=turning, progress=progress)
    forbidding = (one for one in checked.findings if one.forbids is Use.CONTROL)
    findings = (*forbidding, *loop_findings(list(read["train"].values())))
    joints = tuple(joint.name for joint in found.model.joints)
    logs = RoleLogs.of(read["train"], read["validation"], found.recipe, joints)
    motions: dict[str, dict[str, Motion]] = {role: {} for role in ROLES}
    for one in found.validations:
        motions[one.role][one.name] = one.motion
    digest = _digest(project, read, folds)
    offset = found.calibration.time_offset
    return Task(found.model, found.recipe, logs, motions, offset, folds, digest, truth, findings), found


def _fast(estimator: Estimator) -> Estimator:
    return quick(estimator) if isinstance(estimator, HasQuick) else LeastSquares(weights="per_joint")


def _digest(project: Project, logs: Mapping[str, Mapping[str, Log]], folds: int) -> str:
    """Return what tells this task from others: the code, the settings with their files, the recordings."""
    source = project.sources.configuration
    settings = load_yaml(source.text if source else "", str(project.path))
    own = {key: value for key, value in settings.items() if key not in OTHER} if isinstance(settings, dict) else {}
    every = sha256(f"{code_version()} {folds} {settings_digest(project.path.parent, own)}".encode())
    for role, named in logs.items():
        for name, log in named.items():
            every.update(f"{role} {name} {log.q.shape}".encode())
            for values in (log.t, log.q, log.tau, log.keep, log.excluded):
                every.update(b"" if values is None else np.ascontiguousarray(values).tobytes())
    return every.hexdigest()[:16]
