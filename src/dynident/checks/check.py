"""All checks together: of the robot file, of the logs, and of the motions with the model."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace

import numpy as np

from dynident.checks import notes
from dynident.checks.alternatives import NEIGHBOURS
from dynident.checks.channels import ChannelFacts, channels, check_log_fully
from dynident.checks.explain import robot_findings
from dynident.checks.finding import Finding, Topic
from dynident.checks.fit import compensation_findings, friction_findings, repeat_findings, slow_findings
from dynident.checks.gravity import gravity_findings
from dynident.checks.loop import loop_findings
from dynident.checks.missing import tried_by
from dynident.checks.motion import (
    Excitation,
    ExcitedRank,
    excitation,
    excited_rank,
    held_findings,
    limit_findings,
    rank_findings,
)
from dynident.checks.motion_notes import Search, SearchLeftOut
from dynident.checks.outliers import torque_findings
from dynident.checks.robot import JointFacts, LinkFacts, check_robot, link_facts
from dynident.checks.robot_notes import MissingTerm
from dynident.checks.time import MINIMUM_SAMPLES, Timing, timing
from dynident.checks.torque import Agreement, agreement, agreement_findings
from dynident.checks.units import radian_findings, thin
from dynident.errors import DynidentError, Severity, Step
from dynident.estimators import LeastSquares
from dynident.identification import BaseTilt, Recipe, find_base_tilt, mounted, pair
from dynident.identification.outliers import torque_outliers, without
from dynident.identification.terms.added import first
from dynident.log import Log, Motion, thinned
from dynident.models import HasGravity, HasRobotFile, Model
from dynident.regression import Regression, one_thread
from dynident.smoothers import motion_of
from dynident.smoothers.outliers import suspects

__all__ = ["CheckResult", "run_checks"]

PLAIN = LeastSquares()
LARGE = (Topic.SWAPPED, Topic.SIGN)  # found by trying other columns
SILENT = (Topic.DEAD, Topic.FROZEN_TORQUE)  # explain by themselves what a fit leaves of a joint's torque
TILT_SAMPLES = 1000  # samples of all motions with which the tilt of the base is sought
FITTED = 1e8  # numbers in the triangular factors of all joints (0.8 GB), above which nothing is fitted before a fit
SEARCHED = 5e6  # the same, above which what explains the residual is not looked for: about 30 joints
TILT_SHARE = 0.03  # share of the error that a tilted base must explain to be reported


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
    joints: tuple[JointFacts, ...] = ()

    def __repr__(self) -> str:
        from dynident.report.display import check_lines

        return check_lines(self)

    def _repr_html_(self) -> str:
        from dynident.report.display import check_html

        return check_html(self)

    @property
    def failed(self) -> bool:
        """Whether there is an error among the findings."""
        return any(finding.severity is Severity.ERROR for finding in self.findings)


def run_checks(
    model: Model,
    logs: Mapping[str, Mapping[str, Log]],
    recipe: Recipe | None = None,
    *,
    multi_turn: Set[str] = frozenset(),
    found: Sequence[Finding] = (),
    motions: Mapping[str, Mapping[str, Motion]] | None = None,
    described: bool = True,
    progress: Callable[[str], None] | None = None,
    plain: Model | None = None,
) -> CheckResult:
    """Check the robot file of a model and its logs before a fit.

    ``logs`` are given by role ("train", "validation") and name; their joints are matched by name. ``recipe`` smooths
    them (default: ``Recipe()``). ``multi_turn`` are joints that may make any number of turns; ``found`` are findings to
    add, from reading the files; ``motions`` are the logs by role and name where they have been smoothed before; without
    ``described`` the result has no statistics of the channels, which no finding needs; ``progress`` is called with a
    few words before each step. ``plain`` is the model without terms that were chosen on these logs, as for
    ``robot_findings``. Logs with an error are left out of the checks of the motion. A stage that
    fails is a finding, so that none of its errors is raised; raises InputError where a log lacks a joint of the model.

    >>> import numpy as np
    >>> from dynident.models import simulate
    >>> from dynident.models.gallery import pendulum
    >>> from dynident.models.simulation import record
    >>> model, t = pendulum(), np.linspace(0.0, 10.0, 2001)
    >>> motion = simulate(model, model.values, lambda t: [np.sin(3.0 * t)], t)
    >>> log = record(motion, sigma_q=1e-4, sigma_tau=0.01, rng=np.random.default_rng(0)).log
    >>> result = run_checks(model, {"train": {"swing": log}})
    >>> result.failed, result.rank.on_data
    (False, 2)
    """
    joints, say = tuple(joint.name for joint in model.joints), progress or (lambda _: None)
    findings = [*found, *_of_file(model, joints)]
    recipe = recipe or Recipe()
    model, _ = first(model, recipe)
    with one_thread():
        whole, sound = _recorded(model, logs, multi_turn, recipe, findings, say, described=described)
        findings += repeat_findings(logs)
        findings += loop_findings(sound["train"])
        try:
            whole = _moving(whole, model, plain, sound, recipe, findings, motions, say) if sound["train"] else whole
        except DynidentError as error:
            findings.append(Finding(Severity.ERROR, None, str(error), Topic.MOTION))
    if recipe.terms is not None:
        findings = [one for one in findings if not tried_by(one)]
    order = list(Severity)
    return replace(whole, findings=tuple(sorted(findings, key=lambda one: order.index(one.severity))))


def _recorded(
    model: Model,
    logs: Mapping[str, Mapping[str, Log]],
    multi_turn: Set[str],
    recipe: Recipe,
    findings: list[Finding],
    progress: Callable[[str], None],
    *,
    described: bool,
) -> tuple[CheckResult, dict[str, list[Log]]]:
    """Return the result of checking each log, and by role the logs without an error; adds to the findings."""
    kinds = {joint.name: joint.kind for joint in model.joints}
    timings: dict[str, Timing] = {}
    facts = {}
    every = sum(map(len, logs.values()))
    sound: dict[str, list[Log]] = {role: [] for role in ("train", "validation", *logs)}
    for role, named in logs.items():
        for name, log in named.items():
            progress(Step("checking the logs", len(timings), every))
            log = log.select(tuple(kinds))
            log = log if log.source == name else replace(log, source=name)  # the same log has been searched before
            found = check_log_fully(
                log, kinds, multi_turn, replaced=recipe.outliers == "mask", kept=_rests_kept(recipe)
            )
            findings += found
            timings[name] = timing(log)
            if described and len(log) >= MINIMUM_SAMPLES:
                facts[name] = channels(log, suspects(log).positions if recipe.outliers == "mask" else None)
            if not any(one.severity == "error" for one in found):
                sound[role].append(recipe.trimmed(log))
    return CheckResult((), timings, facts, links=_links(model)), sound


def _rests_kept(recipe: Recipe) -> bool:
    return recipe.rests == "keep" and recipe.min_speed is None


def _of_file(model: Model, joints: tuple[str, ...]) -> list[Finding]:
    """Return the findings on the robot file of a model; none is an error, because its inertias are only nominal."""
    found: list[Finding] = []
    for term in (term for term in model.terms if isinstance(term, HasRobotFile)):
        found += check_robot(term.file, joints, inconsistent=Severity.WARNING)
        if term.file.gravity not in (None, term.gravity):
            note = notes.GravityIgnored(term.file.gravity, term.gravity)
            found.append(Finding(Severity.WARNING, None, note, Topic.GRAVITY, source=term.source))
    return found


def _links(model: Model) -> tuple[LinkFacts, ...]:
    return tuple(fact for term in model.terms if isinstance(term, HasRobotFile) for fact in link_facts(term.file))


def _moving(
    whole: CheckResult,
    model: Model,
    plain: Model | None,
    sound: Mapping[str, Sequence[Log]],
    recipe: Recipe,
    findings: list[Finding],
    smoothed: Mapping[str, Mapping[str, Motion]] | None,
    progress: Callable[[str], None],
) -> CheckResult:
    """Return the result with the checks of the smoothed training logs; adds to the findings."""
    if _size(model) > FITTED:
        findings.append(_left_out(Search.FITS, model))
        return whole
    min_speed = recipe.min_speeds(tuple(joint.name for joint in model.joints))
    logs, masked = sound["train"], recipe.outliers == "mask"
    every = (*logs, *sound["validation"])
    if smoothed is None:
        smoothed = _smoothed(model, sound, recipe, findings, progress)
    progress("checking the motion")
    recorded = [
        model.remembering(smoothed[role][log.source]) for role in ("train", "validation") for log in sound[role]
    ]
    outliers = torque_outliers(model, recorded, every, min_speed, len(logs))
    findings += torque_findings(every, outliers, len(logs), masked=masked)
    if masked:
        # what the motion excites does not depend on the torques that were never recorded: see ``_audible``
        outliers = tuple(None if one is None else replace(one, dead=np.zeros_like(one.dead)) for one in outliers)
        pairs = zip(every, outliers, strict=True)
        clean = {
            log.source: channels(log, suspects(log).positions, one.masked)
            for log, one in pairs
            if one is not None and whole.channels
        }
        whole = replace(whole, channels={**whole.channels, **clean})
        recorded = [without(*one) for one in zip(recorded, outliers, every, strict=True)]
    motions = tuple(recorded[: len(logs)])
    fitted = Regression(model, motions, recipe.filter, min_speed)
    seen = excited_rank(model, fitted, recipe.unfitted)  # an error where few are usable
    excitations = tuple(excitation(motions, joint.name) for joint in model.joints)
    agreements = agreement(model, motions)
    findings += held_findings(excitations, model)
    findings += _of_motion(model, motions, excitations, agreements)
    few = thin(model, motions, min_speed)
    for look in (radian_findings, compensation_findings, friction_findings, slow_findings):
        findings += look(few)
    findings += rank_findings(seen)
    held_out = {motion.source: motion for motion in recorded[len(logs) :]}
    findings[:] = _faults(model, plain, motions, held_out, recipe, min_speed, findings, progress)
    return replace(whole, excitations=excitations, agreements=agreements, rank=seen)


def _smoothed(
    model: Model,
    sound: Mapping[str, Sequence[Log]],
    recipe: Recipe,
    findings: list[Finding],
    progress: Callable[[str], None],
) -> dict[str, dict[str, Motion]]:
    """Return the logs smoothed as plain least squares would be given them; adds the time offset to the findings."""
    min_speed = recipe.min_speeds(tuple(joint.name for joint in model.joints))
    clean = {role: [recipe.repaired(log, torque=role == "train") for log in part] for role, part in sound.items()}
    pairing = pair(model, clean["train"], recipe.smoothers, recipe.time_offset, PLAIN, min_speed, progress=progress)
    if pairing.time_offset is not None:
        findings.append(Finding(Severity.INFO, None, pairing.time_offset, Topic.TIME_OFFSET))
    return {
        role: {log.source: motion_of(pairing.smoother, log, judged=role != "train") for log in part}
        for role, part in clean.items()
    }


def _of_motion(
    model: Model, motions: Sequence[Motion], excitations: Sequence[Excitation], agreements: Sequence[Agreement]
) -> Iterator[Finding]:
    """Yield the findings on gravity, and on each joint's limits and torque."""
    downward = list(gravity_findings(model, motions))
    yield from downward
    for joint, moved, torque in zip(model.joints, excitations, agreements, strict=True):
        yield from limit_findings(moved, model.limits.get(joint.name), joint.effort)
        if not downward:  # the nominal torques hold only for the right gravity
            yield from agreement_findings(torque, joint.effort)


def _tilt(
    model: Model, motions: tuple[Motion, ...], recipe: Recipe, min_speed: tuple[float, ...] | None
) -> BaseTilt | None:
    """Return the tilt of the base where it is not given and explains much of the error."""
    if isinstance(recipe.base_tilt, tuple) or not any(isinstance(term, HasGravity) for term in model.terms):
        return None
    try:
        found = find_base_tilt(model, thinned(motions, TILT_SAMPLES), PLAIN, min_speed)
    except DynidentError:  # not a small tilt: other findings name the fault
        return None
    return found if found.after < (1.0 - TILT_SHARE) * found.before else None


def _faults(
    model: Model,
    plain: Model | None,
    motions: tuple[Motion, ...],
    held_out: Mapping[str, Motion],
    recipe: Recipe,
    min_speed: tuple[float, ...] | None,
    findings: Sequence[Finding],
    progress: Callable[[str], None],
) -> list[Finding]:
    """Return the findings with those on the robot and its model; where gravity is wrong, these could not be told."""
    if any(one.topic is Topic.GRAVITY and isinstance(one.message, notes.OtherGravity) for one in findings):
        return list(findings)
    if _size(model) > SEARCHED:
        return [*findings, _left_out(Search.CAUSES, model)]
    pairs = [_left_out(Search.PAIRS, model)] if len(model.joints) > NEIGHBOURS else []
    motions = _audible(motions)
    tilt = _tilt(model, motions, recipe, min_speed)
    if recipe.base_tilt is not None:
        x, y = recipe.base_tilt if isinstance(recipe.base_tilt, tuple) else (tilt.x, tilt.y) if tilt else (0.0, 0.0)
        model, tilt = mounted(model, x, y), None
        plain = None if plain is None else mounted(plain, x, y)
    found = list(robot_findings(model, motions, held_out, recipe.filter, min_speed, tilt, progress, plain))
    if any(one.topic in LARGE for one in found):  # the torque of the file's inertias was that of other columns
        findings = [one for one in findings if one.topic not in (Topic.SIGN, Topic.FOREIGN, Topic.SCALE)]
    silent = {one.joint for one in findings if one.topic in SILENT}
    found = [one for one in found if one.topic is not Topic.UNEXPLAINED or one.joint not in silent]
    held = {one.joint for one in findings if one.topic is Topic.STILL}  # what a wobble shows is no term
    found = [one for one in found if one.joint not in held or not isinstance(one.message, MissingTerm)]
    return [*findings, *found, *pairs]


def _audible(motions: tuple[Motion, ...]) -> tuple[Motion, ...]:
    """Return the motions without the torques that never change, which would spoil what others show."""
    alive = np.any([np.ptp(one.tau, axis=0) > 0 for one in motions], axis=0)
    if alive.all() or not alive.any():
        return motions
    return tuple(
        replace(one, keep=alive & (np.ones(one.q.shape, bool) if one.keep is None else one.keep)) for one in motions
    )


def _size(model: Model) -> int:
    """Return how many numbers the triangular factors of all joints have."""
    return len(model.joints) * (len(model.parameters) + 1) ** 2


def _left_out(search: Search, model: Model) -> Finding:
    severity = Severity.INFO if search is Search.PAIRS else Severity.WARNING
    note = SearchLeftOut(search, len(model.joints), len(model.parameters))
    return Finding(severity, None, note, Topic.LEFT_OUT)
