"""Run all checks: of the robot file, of the logs, and of the motions with the model."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace

import numpy as np

from dynident.checks import channel_notes, file_notes, motion_notes
from dynident.checks.alternatives import MAX_JOINTS_ALL_PAIRS
from dynident.checks.channels import ChannelFacts, channel_facts, check_log_fully, torque_findings
from dynident.checks.explain import refuted_doubts, robot_findings
from dynident.checks.file_notes import ColumnReversed, JointsSwapped, MotorCoupled, OtherAxis, OtherGravity, OtherZero
from dynident.checks.log_notes import FrozenTorque, GravityCompensated, PerhapsRadians
from dynident.checks.missing import is_tried_effect
from dynident.checks.motion import (
    Excitation,
    ExcitedRank,
    compensation_findings,
    excitation,
    excited_rank,
    friction_findings,
    hardly_moving_findings,
    limit_findings,
    rank_findings,
    repeat_findings,
    slow_findings,
)
from dynident.checks.motion_notes import HardlyMoves, SearchKind, SearchLeftOut
from dynident.checks.robot import LinkFacts, RobotJointFacts, check_robot, gravity_findings, link_facts
from dynident.checks.robot_notes import ClockWrong, LeftAtReversals, MissingTerm, Unexplained
from dynident.checks.stamps import MINIMUM_SAMPLES, Timing, radian_findings, thin_regression, timing
from dynident.checks.torque import Agreement, agreement, agreement_findings, loop_findings
from dynident.estimators import LeastSquares
from dynident.identification import BaseTilt, Identification, Recipe, align_motion, find_base_tilt, tilt_base
from dynident.identification.calibration import preliminary_setup, with_load, with_plain_terms
from dynident.identification.outliers import torque_outliers, without_outliers
from dynident.models import Model
from dynident.motion.log import Log, Motion, thin_motions
from dynident.motion.smoothers import smooth_log
from dynident.motion.smoothers.smoother import suspects
from dynident.regression import Regression, Selection, one_thread
from dynident.runtime import DynidentError, Finding, Severity, Step, report_progress
from dynident.runtime.families import action

PLAIN_ESTIMATOR = LeastSquares()
# found by trying alternatives
LARGE_FAULTS = (JointsSwapped, ColumnReversed, OtherZero, MotorCoupled, OtherAxis, OtherGravity)
WRONG_TORQUES = (OtherGravity, PerhapsRadians)  # beside which torques are those of no other fault
MAX_CLOCK_ERROR = 0.4  # s of a second: beyond, accelerations are too wrong to tell anything of inertias
# explain by themselves what a fit leaves of a joint's torque
SILENT_TORQUES = (channel_notes.ConstantTorque, FrozenTorque)
STILL_JOINTS = (channel_notes.NeverMoves, HardlyMoves)
TILT_SAMPLES = 1000  # samples of all motions with which the tilt of the base is sought
# numbers in the triangular factors of all joints (0.8 GB), above which nothing is fitted before a fit
MAX_FACTOR_NUMBERS = 1e8
MAX_SEARCH_NUMBERS = 5e6  # the same, above which what explains the residual is not looked for: about 30 joints
MIN_TILT_SHARE = 0.03  # share of the error that a tilted base must explain to be reported


@dataclass(frozen=True)
class CheckResult:
    """All findings on a robot file or a configuration, the most severe first, and the figures behind them.

    ``timings`` and ``channels`` are by log, ``excitations`` and ``agreements`` by joint over the training motions,
    ``links`` by link of the robot file; ``joints`` are those of a robot file alone. Without usable logs ``rank`` is
    None and the others are empty.
    """

    findings: tuple[Finding, ...]
    timings: Mapping[str, Timing] = field(default_factory=dict)
    channels: Mapping[str, tuple[ChannelFacts, ...]] = field(default_factory=dict)
    excitations: tuple[Excitation, ...] = ()
    agreements: tuple[Agreement, ...] = ()
    rank: ExcitedRank | None = None
    links: tuple[LinkFacts, ...] = ()
    joints: tuple[RobotJointFacts, ...] = ()

    def __repr__(self) -> str:
        return str(action("check_lines")(self))

    def _repr_html_(self) -> str:
        return str(action("check_html")(self))

    @property
    def has_errors(self) -> bool:
        """Whether there is an error among the findings."""
        return any(finding.severity is Severity.ERROR for finding in self.findings)


def run_checks(
    model: Model,
    logs: Mapping[str, Mapping[str, Log]],
    recipe: Recipe | None = None,
    *,
    multi_turn: Set[str] = frozenset(),
    initial_findings: Sequence[Finding] = (),
    motions: Mapping[str, Mapping[str, Motion]] | None = None,
    described: bool = True,
    plain: Model | None = None,
) -> CheckResult:
    """Check the robot file of a model and its logs before a fit.

    ``logs`` are given by role ("train", "validation") and name; their joints are matched by name. ``recipe``
    smooths them (default: ``Recipe()``). ``multi_turn`` are joints that may make any number of turns.
    ``initial_findings`` are added to the result, such as those from reading the files. ``motions`` are the logs
    by role and name where they have been smoothed before. Without ``described`` the result has no statistics of
    the channels, which no finding needs. ``plain`` is the model without terms that were chosen on these logs, as
    for ``robot_findings``. Logs with an error are left out of the checks of the motion. A stage that fails becomes a
    finding, so that none of its errors is raised; raises InputError where a log lacks a joint of the model.

    >>> import numpy as np
    >>> from dynident.models.simulation import simulate
    >>> from dynident.models.lagrangian import pendulum
    >>> from dynident.models.simulation import record
    >>> model, t = pendulum(), np.linspace(0.0, 10.0, 2001)
    >>> motion = simulate(model, model.values, lambda t: [np.sin(3.0 * t)], t)
    >>> log = record(motion, sigma_q=1e-4, sigma_tau=0.01, rng=np.random.default_rng(0)).log
    >>> result = run_checks(model, {"train": {"swing": log}})
    >>> result.has_errors, result.rank.on_data
    (False, 2)
    """
    joints = tuple(joint.name for joint in model.joints)
    findings = [*initial_findings, *_file_findings(model, joints)]
    recipe = recipe or Recipe()
    run = _CheckRun(preliminary_setup(model, recipe)[0], recipe, plain, findings, model)
    with one_thread():
        result, valid_logs = run.check_logs(logs, multi_turn, described=described)
        findings += repeat_findings(logs)
        findings += loop_findings(valid_logs["train"])
        # a stage that fails is a finding, so that the others are still reported
        try:
            result = run.check_motion(result, valid_logs, motions) if valid_logs["train"] else result
        except DynidentError as error:
            findings.append(Finding(motion_notes.NotSmoothed(str(error))))
    # effects that the choice of terms will try by itself are no findings
    if recipe.terms is not None:
        findings = [finding for finding in findings if not is_tried_effect(finding)]
    order = list(Severity)
    return replace(result, findings=tuple(sorted(findings, key=lambda finding: order.index(finding.severity))))


def with_findings(
    identification: Identification,
    model: Model,
    logs: Mapping[str, Mapping[str, Log]],
    recipe: Recipe,
    *,
    multi_turn: Set[str] = frozenset(),
) -> Identification:
    """Return the identification with the errors and warnings of ``run_checks`` added.

    These include what else would lower its error. Effects that a choice of terms has tried are left out.
    ``model``, ``logs`` and ``recipe`` are those given to ``identify``; the motions are those of the fit.
    """
    motions: dict[str, dict[str, Motion]] = {"train": {}, "validation": {}}
    for validation in identification.validations:
        motions[validation.role][validation.name] = validation.motion
    chosen_recipe, choice = identification.recipe, identification.calibration.terms
    # the terms of the choice are in the model already
    recipe = replace(recipe, base_tilt=chosen_recipe.base_tilt, min_speed=chosen_recipe.min_speed, terms=None)
    # the plain set stands in for the terms that remember
    memoryless = replace(model, terms=tuple(term for term in model.terms if not term.memory))
    plain = None if choice is None else with_plain_terms(memoryless)
    model = model if choice is None else model.with_terms(*choice.terms)
    model = replace(model, load=identification.model.load)
    result = run_checks(model, logs, recipe, multi_turn=multi_turn, motions=motions, described=False, plain=plain)
    warnings = tuple(
        finding
        for finding in result.findings
        if (finding.severity is not Severity.INFO or finding.message.removed)
        and not (choice is not None and is_tried_effect(finding, choice))
    )
    return replace(identification, warnings=(*identification.warnings, *warnings))


@dataclass(frozen=True, eq=False)
class _CheckRun:
    """The checks of a model under a recipe: ``findings`` gathers what they find.

    ``plain`` is the model without terms that were chosen on the logs, None where none were; ``complete`` is the model
    with the terms that remember a load which is not known yet.
    """

    model: Model
    recipe: Recipe
    plain: Model | None
    findings: list[Finding]
    complete: Model

    @property
    def selection(self) -> Selection:
        """Which samples of the training a fit uses."""
        return self.recipe.selection(self.model.joints)

    def check_logs(
        self, logs: Mapping[str, Mapping[str, Log]], multi_turn: Set[str], *, described: bool
    ) -> tuple[CheckResult, dict[str, list[Log]]]:
        """Return the result of checking each log, and by role the logs without an error."""
        recipe, kinds = self.recipe, {joint.name: joint.kind for joint in self.model.joints}
        masked, rests_kept = recipe.outliers == "mask", recipe.rests == "keep" and recipe.min_speed is None
        timings, facts, n_logs = (
            dict[str, Timing](),
            dict[str, tuple[ChannelFacts, ...]](),
            sum(map(len, logs.values())),
        )
        valid_logs: dict[str, list[Log]] = {role: [] for role in ("train", "validation", *logs)}
        for role, named_logs in logs.items():
            for name, log in named_logs.items():
                report_progress(Step("checking the logs", len(timings), n_logs))
                log = log.select(tuple(kinds))
                log = log if log.source == name else replace(log, source=name)  # the same log has been searched before
                log_findings = check_log_fully(log, kinds, multi_turn, replaced=masked, rests_kept=rests_kept)
                self.findings.extend(log_findings)
                timings[name] = timing(log)
                if described and len(log) >= MINIMUM_SAMPLES:
                    facts[name] = channel_facts(log, suspects(log).positions if masked else None)
                if not any(finding.severity == "error" for finding in log_findings):
                    valid_logs[role].append(recipe.trim(log))
        links = tuple(fact for term in self.model.terms if term.file is not None for fact in link_facts(term.file))
        return CheckResult((), timings, facts, links=links), valid_logs

    def check_motion(
        self,
        result: CheckResult,
        valid_logs: Mapping[str, Sequence[Log]],
        smoothed: Mapping[str, Mapping[str, Motion]] | None,
    ) -> CheckResult:
        """Return the result with the checks of the smoothed training logs added."""
        # a model of this size would take too long: say which checks are skipped
        model, recipe, findings, selection = self.model, self.recipe, self.findings, self.selection
        if _factor_size(model) > MAX_FACTOR_NUMBERS:
            findings.append(_skipped_search_finding(SearchKind.FITS, model))
            return result
        logs, masked = valid_logs["train"], recipe.outliers == "mask"
        all_logs = (*logs, *valid_logs["validation"])
        if smoothed is None:
            smoothed = self.smooth_logs(valid_logs)
        report_progress("checking the motion")
        pairs = [(smoothed[role], log.source) for role in ("train", "validation") for log in valid_logs[role]]
        all_motions = [model.remembering(motions_of_role[source]) for motions_of_role, source in pairs]
        # find torque outliers first: they must not disturb the fits of the other checks
        outliers = torque_outliers(model, all_motions, all_logs, selection, len(logs))
        findings += torque_findings(all_logs, outliers, len(logs), masked=masked)
        if masked:
            # what the motion excites does not depend on the torques that were never recorded: see ``_audible``
            outliers = tuple(entry and replace(entry, dead=np.zeros_like(entry.dead)) for entry in outliers)
            clean = {
                log.source: channel_facts(log, suspects(log).positions, entry.excluded_torques)
                for log, entry in zip(all_logs, outliers, strict=True)
                if entry is not None and result.channels
            }
            result = replace(result, channels={**result.channels, **clean})
            all_motions = [without_outliers(*entry) for entry in zip(all_motions, outliers, all_logs, strict=True)]
        if recipe.terms is None:
            # what terms remember of the load is not missing
            model = with_load(self.complete, model, tuple(all_motions[: len(logs)]), PLAIN_ESTIMATOR, selection)
            all_motions = [model.remembering(motion) for motion in all_motions]
        motions = tuple(all_motions[: len(logs)])
        regression = Regression(model, motions, selection)
        rank = excited_rank(model, regression, recipe.unfitted)  # an error where few are usable
        excitations = tuple(excitation(motions, joint.name) for joint in model.joints)
        mounted_model = model if not isinstance(recipe.base_tilt, tuple) else tilt_base(model, *recipe.base_tilt)
        agreements = agreement(mounted_model, motions)
        findings += hardly_moving_findings(excitations, model)
        # a few samples are enough for checks that only compare fits
        sample_regression = thin_regression(model, motions, selection.min_speed)
        gravity = [*gravity_findings(mounted_model, motions), *compensation_findings(sample_regression)]
        findings += _motion_findings(model, excitations, agreements, gravity)
        for find in (radian_findings, slow_findings):
            findings += find(sample_regression)
        # where there is no friction, none was chosen
        findings += friction_findings(thin_regression(self.plain or model, motions, selection.min_speed))
        findings += rank_findings(rank)
        held_out = {motion.source: motion for motion in all_motions[len(logs) :]}
        replace(self, model=model).find_robot_faults(motions, held_out)
        return replace(result, excitations=excitations, agreements=agreements, rank=rank)

    def smooth_logs(self, valid_logs: Mapping[str, Sequence[Log]]) -> dict[str, dict[str, Motion]]:
        """Return the logs smoothed as for plain least squares; the time offset is a finding."""
        recipe = self.recipe
        clean = {
            role: [recipe.repair(log, torque=role == "train") for log in part] for role, part in valid_logs.items()
        }
        alignment = align_motion(self.model, clean["train"], recipe.smoothers, recipe.time_offset, self.selection)
        if alignment.time_offset is not None:
            self.findings.append(Finding(alignment.time_offset))
        return {
            role: {log.source: smooth_log(alignment.smoother, log, judge_only=role != "train") for log in part}
            for role, part in clean.items()
        }

    def find_robot_faults(self, motions: tuple[Motion, ...], held_out: Mapping[str, Motion]) -> None:
        """Add the findings on the robot and its model, which cannot be found where gravity or a unit is wrong."""
        model, plain, recipe, findings = self.model, self.plain, self.recipe, self.findings
        if any(isinstance(finding.message, WRONG_TORQUES) for finding in findings):
            return
        if _factor_size(model) > MAX_SEARCH_NUMBERS:
            findings.append(_skipped_search_finding(SearchKind.CAUSES, model))
            return
        pairs = [_skipped_search_finding(SearchKind.PAIRS, model)] if len(model.joints) > MAX_JOINTS_ALL_PAIRS else []
        motions = _without_silent_torques(motions)
        tilt = self.base_tilt(motions)
        # a tilt that is part of the recipe is applied, so that it is not found again as a fault
        if recipe.base_tilt is not None:
            x, y = recipe.base_tilt if isinstance(recipe.base_tilt, tuple) else (tilt.x, tilt.y) if tilt else (0.0, 0.0)
            model, tilt = tilt_base(model, x, y), None
            plain = None if plain is None else tilt_base(plain, x, y)
        faults = list(robot_findings(model, motions, held_out, recipe.filter, self.selection.min_speed, tilt, plain))
        if any(isinstance(finding.message, (file_notes.OddScale, file_notes.UnrelatedTorque)) for finding in findings):
            refuted = refuted_doubts(model, motions, recipe.filter, self.selection.min_speed)
            findings[:] = [x for x in findings if x.joint not in refuted.get(type(x.message), ())]
        # a fault explains others: the torque of the file's inertias was that of another motion or arm
        notes = [finding.message for finding in faults]
        clocks = [note.value for note in notes if isinstance(note, ClockWrong)]
        if any(isinstance(note, LARGE_FAULTS) for note in notes) or any(abs(x - 1.0) > MAX_CLOCK_ERROR for x in clocks):
            following = (file_notes.ReversedSign, file_notes.UnrelatedTorque, file_notes.OddScale, GravityCompensated)
            findings[:] = [finding for finding in findings if not isinstance(finding.message, following)]
        if any(isinstance(finding.message, GravityCompensated) for finding in findings):
            return
        # a silent torque explains by itself what is left of that joint; what a wobble shows is no term
        silent = {finding.joint for finding in findings if isinstance(finding.message, SILENT_TORQUES)}
        still = {finding.joint for finding in findings if isinstance(finding.message, STILL_JOINTS)}
        findings += [
            finding
            for finding in faults
            if not (isinstance(finding.message, (Unexplained, LeftAtReversals)) and finding.joint in silent)
            and not (isinstance(finding.message, MissingTerm) and finding.joint in still)
        ]
        findings += pairs

    def base_tilt(self, motions: tuple[Motion, ...]) -> BaseTilt | None:
        """Return the tilt of the base where it is not given and explains a large part of the error, else None."""
        model = self.model
        if isinstance(self.recipe.base_tilt, tuple) or not any(term.gravity is not None for term in model.terms):
            return None
        try:
            tilt = find_base_tilt(model, thin_motions(motions, TILT_SAMPLES), PLAIN_ESTIMATOR, self.selection)
        except DynidentError:  # not a small tilt: other findings name the fault
            return None
        return tilt if tilt.after < (1.0 - MIN_TILT_SHARE) * tilt.before else None


def _file_findings(model: Model, joints: tuple[str, ...]) -> list[Finding]:
    """Return the findings on the robot file of a model; none is an error, because its inertias are only nominal."""
    findings: list[Finding] = []
    for term in model.terms:
        if term.file is None:
            continue
        findings += check_robot(term.file, joints, inconsistent=Severity.WARNING)
        if term.gravity is not None and term.file.gravity not in (None, term.gravity):
            note = file_notes.GravityIgnored(term.file.gravity, term.gravity)
            findings.append(Finding(note, source=term.file.source))
    return findings


def _motion_findings(
    model: Model, excitations: Sequence[Excitation], agreements: Sequence[Agreement], gravity: Sequence[Finding]
) -> Iterator[Finding]:
    """Yield the findings on ``gravity``, and on each joint's limits and torque."""
    beyond = [
        finding
        for joint, entry in zip(model.joints, excitations, strict=True)
        for finding in limit_findings(entry, model.limits.get(joint.name), joint)
    ]
    yield from (*gravity, *beyond)
    # the nominal torques hold only for the right gravity and unit of positions
    if not gravity and not any(finding.forbids for finding in beyond):
        for joint, joint_agreement in zip(model.joints, agreements, strict=True):
            yield from agreement_findings(joint_agreement, joint.effort)


def _without_silent_torques(motions: tuple[Motion, ...]) -> tuple[Motion, ...]:
    """Return the motions without torques that never change, which would disturb the fit of the other joints."""
    varies = np.any([np.ptp(motion.tau, axis=0) > 0 for motion in motions], axis=0)
    if varies.all() or not varies.any():
        return motions
    return tuple(
        replace(motion, keep=varies & (np.ones(motion.q.shape, bool) if motion.keep is None else motion.keep))
        for motion in motions
    )


def _factor_size(model: Model) -> int:
    """Return the number of elements in the triangular factors of all joints."""
    return len(model.joints) * (len(model.parameters) + 1) ** 2


def _skipped_search_finding(search: SearchKind, model: Model) -> Finding:
    severity = Severity.INFO if search is SearchKind.PAIRS else Severity.WARNING
    note = SearchLeftOut(search, len(model.joints), len(model.parameters))
    return Finding(note, severity=severity)
