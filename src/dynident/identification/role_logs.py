"""The logs of an identification by role, from as they are given to the motions that are fitted and judged."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

from dynident.errors import ConfigError, InputError, Note, Severity, Step, brief
from dynident.identification.outliers import masked
from dynident.identification.recipe import Recipe
from dynident.identification.rests import Rests, without_rests
from dynident.log import Log, Motion
from dynident.models import Model
from dynident.smoothers import SUBSTITUTE, Smoother, motion_of
from dynident.validation import LogValidation

__all__ = ["NotFitted", "NotJudged", "RoleLogs", "SubstituteUsed", "not_judged", "substituted"]

Logs = Mapping[str, Mapping[str, Log]]
Motions = dict[str, dict[str, Motion]]
MUCH = 0.05  # share of a held-out log that may be excluded without a warning


@dataclass(frozen=True)
class NotFitted(Note):
    """The torque equations of these ``joints`` are not fitted, as the recipe asks; they are predicted and judged."""

    severity: ClassVar[Severity] = Severity.INFO
    joints: tuple[str, ...]


@dataclass(frozen=True)
class NotJudged(Note):
    """Of the held-out ``log`` the configuration excludes a ``share`` (%): its error is that of the rest."""

    log: str
    share: float


def not_judged(validations: Sequence[LogValidation]) -> Iterator[NotJudged]:
    """Yield of which held-out logs, with signals, more than 5 % are excluded."""
    for one in validations:
        gone = None if one.recorded is None else one.recorded.excluded
        if one.role == "validation" and gone is not None and gone.mean() > MUCH:
            yield NotJudged(one.name, 100.0 * float(gone.mean()))


@dataclass(frozen=True)
class SubstituteUsed(Note):
    """The ``log``, which is judged and not fitted, has not the motion that the smoother is made for, whose class is
    ``smoother``; it is smoothed by another ``method``."""

    severity: ClassVar[Severity] = Severity.INFO
    log: str
    smoother: str
    method: str


def substituted(validations: Sequence[LogValidation]) -> Iterator[SubstituteUsed]:
    """Yield which logs, with signals, a substitute of the smoother has smoothed."""
    for one in validations:
        how = {} if one.signals is None else one.motion.smoothing
        if SUBSTITUTE in how:
            yield SubstituteUsed(one.name, how[SUBSTITUTE], how["method"])


@dataclass(frozen=True, eq=False)
class RoleLogs:
    """Logs by role ("train", "validation") and name: as ``recorded``, without rests at their ends (``trimmed``), and
    without outliers in what is smoothed and fitted (``repaired``)."""

    recorded: Logs
    trimmed: Logs
    repaired: Logs

    __repr__ = brief

    @classmethod
    def of(
        cls,
        train: Mapping[str, Log] | Sequence[Log],
        validation: Mapping[str, Log] | Sequence[Log],
        recipe: Recipe,
        joints: tuple[str, ...],
    ) -> RoleLogs:
        """Return the logs of these joints in this order.

        ConfigError where none is to be fitted or joints that are not are unknown, InputError where no torque is.
        """
        recipe.check_joints(joints)
        roles = {"train": _named(train), "validation": _named(validation)}
        if not roles["train"]:
            raise ConfigError("no training log is given; name at least one.")
        if not any(log.tau.any() for log in roles["train"].values()):
            raise InputError(
                "all torques of the training are zero; check that the right columns are named and recorded."
            )
        recorded = {role: {name: log.select(joints) for name, log in logs.items()} for role, logs in roles.items()}
        trimmed = {role: {name: recipe.trimmed(log) for name, log in logs.items()} for role, logs in recorded.items()}
        repaired = {role: {name: recipe.repaired(log, torque=role == "train") for name, log in logs.items()}
                    for role, logs in trimmed.items()}  # fmt: skip
        return cls(recorded, trimmed, repaired)

    def motions(
        self, model: Model, smoother: Smoother, recipe: Recipe, progress: Callable[[str], None]
    ) -> tuple[Motions, tuple[Rests, ...]]:
        """Return the motions by role and name, with what the model remembers of them, those of the training without
        what is not fitted; and the rests of the training."""
        return self.kept(model, self.smoothed(smoother, progress), recipe)

    def smoothed(self, smoother: Smoother, progress: Callable[[str], None] = lambda _: None) -> Motions:
        """Return the motions by role and name, those that are only judged by a substitute where the smoother does not
        apply. Raises the errors of the smoother."""
        motions: Motions = {role: {} for role in self.repaired}
        every = [(role, *one) for role, logs in self.repaired.items() for one in logs.items()]
        for k, (role, name, log) in enumerate(every):
            progress(Step("smoothing the logs", k, len(every)))
            motions[role][name] = motion_of(smoother, log, judged=role != "train")
        return motions

    def kept(self, model: Model, smoothed: Motions, recipe: Recipe) -> tuple[Motions, tuple[Rests, ...]]:
        """Return smoothed motions with what the model remembers of them, those of the training without what is not
        fitted; and the rests of the training."""
        motions = {
            role: {name: model.remembering(one) for name, one in some.items()} for role, some in smoothed.items()
        }
        speeds = recipe.min_speeds([joint.name for joint in model.joints])
        if recipe.outliers == "mask":
            motions = masked(model, motions, self.trimmed, speeds)
        motions["train"], rests = without_rests(model, motions["train"], self.recorded, recipe.rests, speeds)
        motions["train"] = {name: recipe.fitting(motion) for name, motion in motions["train"].items()}
        return motions, rests

    def fitted(self, motions: Mapping[str, Mapping[str, Motion]]) -> tuple[Log, ...]:
        """Return the logs of the training with the torques that are fitted."""
        pairs = zip(self.repaired["train"].values(), motions["train"].values(), strict=True)
        return tuple(replace(log, tau=motion.tau) for log, motion in pairs)


def _named(logs: Mapping[str, Log] | Sequence[Log]) -> dict[str, Log]:
    if isinstance(logs, Mapping):
        return dict(logs)
    named = {log.source: log for log in logs}
    if len(named) != len(logs):
        raise ConfigError(f"two logs have the same source among {[log.source for log in logs]}; give them by name.")
    return named
