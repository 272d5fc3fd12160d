"""The task that all combinations have in common: the model, the logs, and which torques of them are fitted."""

from __future__ import annotations

import time
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from hashlib import sha256
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from dynident.apps.ranking.config import Candidate
from dynident.apps.ranking.differences import TimeBlocks, TrueParameters, time_blocks
from dynident.apps.ranking.ranking import CombinationOutcome
from dynident.checks import loop_findings, with_findings
from dynident.estimators import Estimator, LeastSquares
from dynident.files.yaml_text import load_yaml
from dynident.identification import Alignment, Identification, Recipe, TimeOffset, align_motion, identify
from dynident.identification.dataset import Dataset
from dynident.models import Model
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import Smoother, TimeShifted, strip_time_offset
from dynident.project.explicit_config import settings_digest
from dynident.project.logs import turning_joints
from dynident.project.project import Project
from dynident.regression import fitted_rows, one_thread
from dynident.runtime import DynidentError, Finding, InputError, MissingInputError, Noun, Use
from dynident.runtime.cache import Cache
from dynident.runtime.jobs.cluster import code_version

KEY = ("smoother", "estimator", "digest")
Mask = NDArray[np.bool_]
Masks = Mapping[str, Mapping[str, Mask]]
ROLES = ("train", "validation")
IGNORED_SECTIONS = ("compare", "excitation", "train", "validation")  # sections that change nothing, or are logs

Motions = Mapping[str, Mapping[str, Motion]]
MIN_SAMPLE_SHARE = 0.5  # share of the samples that most smoothers keep in a log, which one must keep to be compared
MAX_CACHED_VALUES = 4e6  # samples times joints of motions that a process keeps: about half a gigabyte
_MOTION_CACHE: Cache[Motions] = Cache(4)  # motions that this process has made last, by task and smoother


def row_schema() -> dict[str, Any]:
    """Return the columns of the table, and their types.

    ``smoother`` and ``estimator`` by name, the latter empty in the row of a smoother alone; ``digest`` of all
    that the row depends on; ``status`` (a ``CombinationOutcome``) and ``reason`` why there is no result;
    ``notes``: types of the notes. ``seconds`` of the smoothing of all logs or of the estimate, ``cv_seconds`` of
    the cross-validation, None without.

    Of a smoother: ``masks``, which samples it keeps, packed, the number in ``parts`` of the ``chosen`` one, and the
    time offset that was estimated, ``shift``: seconds, errors without and with it (%), its standard error, if known.

    Of a combination: sums of squares (N m, N)^2 of the residual torque on the ``held`` out logs (K n), on all of
    these by the motions of the configured smoother, ``alike`` (n), on the ``train``ing logs (n) and in the
    ``cross``-validation (K' n); ``condition``, smallest ``eigenvalue``; ``base`` (r) parameters and their
    standard errors ``std`` (r), where the true values are known.
    """
    import polars as pl

    floats = pl.List(pl.Float64)
    return {
        "smoother": pl.String, "estimator": pl.String, "digest": pl.String, "status": pl.String, "reason": pl.String,
        "notes": pl.List(pl.String), "seconds": pl.Float64, "cv_seconds": pl.Float64, "chosen": pl.Int64,
        "masks": pl.Binary, "shift": floats, "held": floats, "alike": floats, "train": floats, "cross": floats,
        "condition": pl.Float64, "eigenvalue": pl.Float64, "base": floats, "std": floats,
    }  # fmt: skip


def empty_row(
    key: tuple[str, str, str], status: CombinationOutcome, reason: str = "", seconds: float = 0.0
) -> dict[str, Any]:
    """Return a row without a result."""
    names = ("notes", "shift", "held", "alike", "train", "cross", "base", "std")
    row: dict[str, Any] = {**dict(zip(KEY, key, strict=True)), "status": status.value, "reason": reason}
    row |= {"seconds": seconds} | {name: [] for name in names}
    return row | dict.fromkeys(("cv_seconds", "chosen", "masks", "condition", "eigenvalue"))


def pack_masks(masks: Mapping[str, Mapping[str, Mask]]) -> bytes:
    """Return masks by role and log as compressed bytes."""
    all_masks = [mask for log_masks in masks.values() for mask in log_masks.values()]
    return zlib.compress(np.packbits(np.concatenate(all_masks)).tobytes())


def unpack_masks(data: bytes, logs_by_role: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Mask]]:
    """Return the masks in ``data``, by role and name of the logs.

    ``logs_by_role`` are the logs, or motions, that they belong to.
    """
    # one bit per sample, in the order of roles and logs
    bits = np.unpackbits(np.frombuffer(zlib.decompress(data), dtype=np.uint8)).astype(bool)
    lengths = [len(log) for logs in logs_by_role.values() for log in logs.values()]
    parts = iter(np.split(bits, np.cumsum(lengths)))
    return {role: {name: next(parts) for name in logs} for role, logs in logs_by_role.items()}


class Task(Noun):
    """A model and logs that every combination fits and predicts: the same samples, the same equations.

    ``model`` and ``recipe`` are as the configuration's own recipe has made them: terms, tilt of the base, time
    ``offset``. ``logs`` are by role and name; ``motions`` those of the configured smoother, of which the torque
    and the ``fitted_masks`` hold for all. ``folds`` are those of the cross-validation. ``digest`` identifies the
    task. ``truth`` are the true parameters, where they are known. ``findings`` of the checks forbid the use of
    any model of these logs, or are about the controllers with which some estimators simulate.
    """

    model: Model
    recipe: Recipe
    logs: Dataset
    motions: Mapping[str, Mapping[str, Motion]]
    offset: TimeOffset | None
    folds: int
    digest: str
    truth: TrueParameters | None = None
    findings: tuple[Finding, ...] = ()

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the n joints."""
        return tuple(joint.name for joint in self.model.joints)

    @property
    def held_out(self) -> bool:
        """Whether any log is held out."""
        return bool(self.logs.repaired["validation"])

    @property
    def is_long(self) -> bool:
        """Whether the logs are too long for a process to keep several smoothed copies of them."""
        values = sum(log.q.size for role_logs in self.logs.repaired.values() for log in role_logs.values())
        return values > MAX_CACHED_VALUES

    @property
    def time_offset(self) -> float:
        """The time offset (s) between positions and torque, by the configured smoother."""
        time_offset = self.recipe.time_offset
        return float(time_offset) if time_offset != "estimate" else 0.0

    def align_smoother(self, parts: Sequence[Smoother], *, is_configured: bool) -> Alignment:
        """Return the alignment of the smoother that is chosen of ``parts``, with its time offset.

        Where the recipe estimates that, each smoother gets its own offset, as if it were the configured one:
        smoothers differ in what looks like an offset, and that of one would be unfair to all others.
        """
        if is_configured:
            return Alignment(self.recipe.smoothers[0], None, self.offset)
        time_offset: float | Literal["estimate"] = self.time_offset if self.offset is None else "estimate"
        logs, selection = self.logs.train_logs, self.recipe.selection(self.model.joints)
        return align_motion(self.model, logs, parts, time_offset, selection)

    @cached_property
    def fitted_masks(self) -> Mapping[str, Mapping[str, Mask]]:
        """The torque equations (N, n) of each log that may be fitted or judged, whatever the smoother."""
        speeds = self.recipe.min_speeds(self.joints)
        masks: dict[str, dict[str, Mask]] = {"train": {}, "validation": {}}
        for role, role_motions in self.motions.items():
            for name, motion in role_motions.items():
                rows = fitted_rows(motion, speeds) if role == "train" else motion.keep
                masks[role][name] = np.ones(motion.q.shape, dtype=bool) if rows is None else rows
        return masks

    @cached_property
    def blocks(self) -> Mapping[str, TimeBlocks]:
        """The blocks of time of the logs of each role."""
        return {role: time_blocks(self.logs.repaired[role]) for role in ROLES}

    def torque_squares(self, masks: Masks, role: str, *, fitted_only: bool) -> NDArray[np.float64]:
        """Return the sums of squares (K, n) of the measured torque in the blocks of a role, on samples in ``masks``.

        With ``fitted_only`` only equations that may be fitted count.
        """
        torques = {name: motion.tau for name, motion in self.motions[role].items()}
        return self.squares(torques, masks, role, fitted_only=fitted_only)

    def squares(
        self, torques: Mapping[str, NDArray[np.float64]], masks: Masks, role: str, *, fitted_only: bool
    ) -> NDArray[np.float64]:
        """Return the sums of ``torque_squares`` for any torques (N, n) by log."""
        squares_by_log = {}
        for name, tau in torques.items():
            rows = masks[role][name][:, None] & (self.fitted_masks[role][name] if fitted_only else True)
            squares_by_log[name] = np.where(rows, np.square(tau), 0.0)
        return self.blocks[role].sums(squares_by_log)


def create_task(project: Project, folds: int) -> tuple[Task, Identification]:
    """Return the task that the recipe of a project makes of its logs, and the identification behind it.

    The estimator of this first fit is the fast substitute of the configured one, or least squares. Raises the
    errors of reading and of ``identify``, and InputError for logs that are too long for the memory.
    """
    if project.long:
        raise InputError(
            f"{project.path}: the training is too long for the memory, and such logs are fitted in pieces, which only "
            "`dynident identify` does; compare on a `window` of them."
        )
    recorded, _ = project.logs()
    # the first fit simulates nothing, so that it needs no controller
    uncontrolled = {
        role: {name: replace(log, controller=None) for name, log in role_logs.items()}
        for role, role_logs in recorded.items()
    }
    estimator = project.recipe.estimator
    has_substitute = type(estimator).quick is not Estimator.quick
    fast_estimator = estimator.quick() if has_substitute else LeastSquares(weights="per_joint")
    first_recipe = replace(project.recipe, estimator=fast_estimator, restart=None)
    identification = identify(project.model, uncontrolled["train"], uncontrolled["validation"], first_recipe)
    turning = turning_joints(project.config)
    checked = with_findings(identification, project.model, uncontrolled, project.recipe, multi_turn=turning)
    forbidding = (finding for finding in checked.findings if finding.forbids is Use.CONTROL)
    findings = (*forbidding, *loop_findings(list(recorded["train"].values())))
    joints = tuple(joint.name for joint in identification.model.joints)
    logs = Dataset.of(recorded["train"], recorded["validation"], identification.recipe, joints)
    motions: dict[str, dict[str, Motion]] = {role: {} for role in ROLES}
    for validation in identification.validations:
        motions[validation.role][validation.name] = validation.motion
    digest = _task_digest(project, recorded, folds)
    offset = identification.calibration.time_offset
    model, recipe = identification.model, identification.recipe
    return Task(model, recipe, logs, motions, offset, folds, digest, findings=findings), identification


def _task_digest(project: Project, logs: Mapping[str, Mapping[str, Log]], folds: int) -> str:
    """Return a digest that identifies this task: of the code, the settings with their files, the recordings."""
    source = project.sources.configuration
    settings = load_yaml(source.text if source else "", str(project.path))
    settings = settings if isinstance(settings, dict) else {}
    relevant_settings = {key: value for key, value in settings.items() if key not in IGNORED_SECTIONS}
    digest = sha256(f"{code_version()} {folds} {settings_digest(project.path.parent, relevant_settings)}".encode())
    # digest the samples themselves, as files may change under the same name
    for role, role_logs in logs.items():
        for name, log in role_logs.items():
            digest.update(f"{role} {name} {log.q.shape}".encode())
            for values in (log.t, log.q, log.tau, log.keep, log.excluded):
                digest.update(b"" if values is None else np.ascontiguousarray(values).tobytes())
    return digest.hexdigest()[:16]


class Smoothing(Noun):
    """Smooth all logs of a task by a candidate.

    Called with its number it returns its row, with the samples that it keeps.
    """

    task: Task
    candidates: tuple[Candidate, ...]
    digests: tuple[str, ...]

    def __call__(self, k: int) -> dict[str, Any]:
        """Return the row of a candidate."""
        candidate = self.candidates[k]
        key = candidate.name, "", self.digests[k]
        began = time.perf_counter()
        try:
            with one_thread():
                alignment = self.task.align_smoother(candidate.parts, is_configured=candidate.is_configured)
                plain, offset = strip_time_offset(alignment.smoother), alignment.time_offset
                part_number = candidate.parts.index(plain) if plain in candidate.parts else 0
                shift = [offset.seconds, offset.before, offset.after, *filter(None, [offset.std])] if offset else []
                began = time.perf_counter()
                motions = smoothed_motions(self.task, candidate, alignment.smoother)
            seconds = time.perf_counter() - began
            masks = {role: {name: motions[role][name].mask for name in motions[role]} for role in motions}
        except Exception as error:  # a smoother that fails is a row
            return empty_row(key, *describe_failure(error), time.perf_counter() - began)
        columns = {"masks": pack_masks(masks), "chosen": part_number, "shift": shift}
        return empty_row(key, CombinationOutcome.OK, "", seconds) | columns


def restore_alignment(part: Smoother, shift: Sequence[float], time_offset: float) -> Alignment:
    """Return a smoother with the time offset of its row, or else with ``time_offset`` (s)."""
    offset = TimeOffset(shift[0], shift[1], shift[2], shift[3] if len(shift) > 3 else None) if len(shift) else None
    seconds = offset.seconds if offset else time_offset
    return Alignment(TimeShifted(strip_time_offset(part), seconds) if seconds else part, None, offset)


def describe_failure(error: Exception) -> tuple[CombinationOutcome, str]:
    """Return the outcome and the reason of a row for an exception."""
    if isinstance(error, MemoryError):
        raise error  # the job as a whole has too little
    outcome = CombinationOutcome.NOT_APPLICABLE if isinstance(error, MissingInputError) else CombinationOutcome.FAILED
    return outcome, str(error) if isinstance(error, DynidentError) else f"{type(error).__name__}: {error}"


def smoothed_motions(task: Task, candidate: Candidate, smoother: Smoother) -> Motions:
    """Return the motions of a candidate by role and log, as its ``smoother`` makes them; raises the errors of that."""
    if task.is_long:  # smoothed anew each time, as a cache of long logs would fill the memory
        return task.logs.smooth(smoother)
    return _MOTION_CACHE((task.digest, candidate.settings, repr(smoother)), lambda: task.logs.smooth(smoother))


class CommonSamples(Noun):
    """The samples that all compared smoothers keep: ``masks`` (N) by role and log.

    ``excluded`` are smoothers that keep too few samples to be compared, with the reason; ``shares`` the part (%)
    of the samples of each log that is left, ``kept_shares`` that of all logs that each smoother keeps.
    """

    masks: Mapping[str, Mapping[str, Mask]]
    excluded: Mapping[str, str]
    shares: Mapping[str, float]
    kept_shares: Mapping[str, float]


def find_common_samples(task: Task, masks: Mapping[str, Mapping[str, Mapping[str, Mask]]]) -> CommonSamples:
    """Return the samples that smoothers have in common, whose masks are given by smoother, role and log.

    A smoother that keeps less than half of what the median of them keeps of a log is left out: it would take from
    all others the samples they are compared on. Raises InputError where a log has no sample in common.
    """
    excluded = dict[str, str]()
    # compare with the median, so that one smoother that keeps little does not set the measure
    for role, role_motions in task.motions.items():
        for log in role_motions:
            sizes = {name: int(smoother_masks[role][log].sum()) for name, smoother_masks in masks.items()}
            median_count = float(np.median(list(sizes.values())))
            for name, count in sizes.items():
                if count < MIN_SAMPLE_SHARE * median_count:
                    words = f"{log}: keeps {count} samples, where most smoothers keep {median_count:.0f}"
                    excluded.setdefault(name, words)
    included = {name: smoother_masks for name, smoother_masks in masks.items() if name not in excluded}
    common = {
        role: {
            log: np.logical_and.reduce([motion.mask, *(kept[role][log] for kept in included.values())])
            for log, motion in role_motions.items()
        }
        for role, role_motions in task.motions.items()
    }
    common_masks = {log: mask for role_masks in common.values() for log, mask in role_masks.items()}
    for log, mask in common_masks.items():
        if not mask.any():
            raise InputError(f"{log}: no sample is kept by all smoothers; compare fewer of them.")
    shares = {log: 100.0 * float(mask.mean()) for log, mask in common_masks.items()}
    kept_shares = {}
    for name, kept in included.items():
        all_masks = [mask for role_masks in kept.values() for mask in role_masks.values()]
        kept_shares[name] = 100.0 * float(np.concatenate(all_masks).mean())
    return CommonSamples(common, excluded, shares, kept_shares)


def with_common_samples(task: Task, motions: Motions, common: CommonSamples) -> dict[str, dict[str, Motion]]:
    """Return motions with the common samples and, in the training, the torques and equations that are fitted."""
    selected: dict[str, dict[str, Motion]] = {"train": {}, "validation": {}}
    for role, role_motions in motions.items():
        for name, motion in role_motions.items():
            mask, reference = common.masks[role][name], task.motions[role][name]
            fitted_mask = task.fitted_masks[role][name]
            # the torque and the equations are those of the configured smoother, the same for all candidates
            keep = None if fitted_mask.all() else fitted_mask
            masked = replace(motion, mask=mask, tau=reference.tau, keep=keep, memory=None)
            selected[role][name] = task.model.remembering(masked)
    return selected
