"""Puts together what is said of a robot file, of the logs, and of the motions in view of the model."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace

from dynident.checks.channels import ChannelFacts, channels, inspect_log
from dynident.checks.finding import Finding, Topic
from dynident.checks.gravity import gravity_findings
from dynident.checks.motion import Excitation, ExcitedRank, excitation, excited_rank, limit_findings, rank_findings
from dynident.checks.robot import LinkFacts, check_robot, link_facts
from dynident.checks.time import MINIMUM_SAMPLES, Timing, timing
from dynident.checks.torque import Agreement, agreement, agreement_findings
from dynident.errors import DynidentError, Severity
from dynident.estimators import LeastSquares
from dynident.identification import Recipe, find_base_tilt, pair
from dynident.log import Log, Motion
from dynident.models import HasGravity, HasRobotFile, Model
from dynident.regression import Regression, one_thread

__all__ = ["CheckResult", "run_checks"]

PLAIN = LeastSquares()
WORTH = 0.03  # share of the error that a tilted base must explain to be worth a word


@dataclass(frozen=True)
class CheckResult:
    """All findings on a robot file or a configuration, the gravest first, and the facts behind them.

    ``timings`` and ``channels`` are by log, ``excitations`` and ``agreements`` by joint over the training motions,
    ``rank`` is None and all of them are empty where there are no logs that can be used.
    """

    findings: tuple[Finding, ...]
    timings: Mapping[str, Timing] = field(default_factory=dict)
    channels: Mapping[str, tuple[ChannelFacts, ...]] = field(default_factory=dict)
    excitations: tuple[Excitation, ...] = ()
    agreements: tuple[Agreement, ...] = ()
    rank: ExcitedRank | None = None
    links: tuple[LinkFacts, ...] = ()

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
    progress: Callable[[str], None] = lambda _: None,
) -> CheckResult:
    """Examine a model's robot file and its logs, by role ("train", "validation") and name, matched by joint names.

    ``found`` is what reading has found already. The motions are smoothed as the recipe says. A log with an error is
    left out of what is said of the motion; a stage that fails is a finding. ``multi_turn`` as in ``check_log``.
    """
    joints = tuple(joint.name for joint in model.joints)
    findings = [*found, *_of_file(model, joints)]
    whole, sound = _recorded(model, logs, multi_turn, findings, progress)
    if sound:
        try:
            with one_thread():
                whole = _moving(whole, model, sound, recipe or Recipe(), findings, progress)
        except DynidentError as error:
            findings.append(Finding(Severity.ERROR, None, str(error), Topic.MOTION))
    order = list(Severity)
    return replace(whole, findings=tuple(sorted(findings, key=lambda one: order.index(one.severity))))


def _recorded(
    model: Model,
    logs: Mapping[str, Mapping[str, Log]],
    multi_turn: Set[str],
    findings: list[Finding],
    progress: Callable[[str], None],
) -> tuple[CheckResult, list[Log]]:
    """Return the examination with what each log says, and the training logs without an error; adds to the findings."""
    kinds = {joint.name: joint.kind for joint in model.joints}
    timings, facts, sound = {}, {}, []
    for role, named in logs.items():
        for name, log in named.items():
            progress(f"examining {name}")
            log = replace(log.select(tuple(kinds)), source=name)
            said = inspect_log(log, kinds, multi_turn)
            findings += said
            timings[name] = timing(log)
            if len(log) >= MINIMUM_SAMPLES:
                facts[name] = channels(log)
            if role == "train" and not any(one.severity == "error" for one in said):
                sound.append(log)
    return CheckResult((), timings, facts, links=_links(model)), sound


def _of_file(model: Model, joints: tuple[str, ...]) -> list[Finding]:
    """Return the findings on the robot file of a model; its inertias are only nominal, so none of them is an error."""
    found: list[Finding] = []
    for term in (term for term in model.terms if isinstance(term, HasRobotFile)):
        found += check_robot(term.file, joints, grave=Severity.WARNING)
        if term.file.gravity not in (None, term.gravity):
            words = f"the file's gravity {term.file.gravity} is not read; {term.gravity} m/s^2 is used."
            found.append(
                Finding(
                    Severity.WARNING,
                    None,
                    f"{words} Set `gravity` if the arm is mounted so.",
                    Topic.GRAVITY,
                    source=term.source,
                )
            )
    return found


def _links(model: Model) -> tuple[LinkFacts, ...]:
    return tuple(fact for term in model.terms if isinstance(term, HasRobotFile) for fact in link_facts(term.file))


def _moving(
    whole: CheckResult,
    model: Model,
    logs: Sequence[Log],
    recipe: Recipe,
    findings: list[Finding],
    progress: Callable[[str], None],
) -> CheckResult:
    """Return the examination with what the smoothed training logs say; adds to the findings."""
    min_speed = recipe.min_speeds(tuple(joint.name for joint in model.joints))
    candidates = recipe.smoother if isinstance(recipe.smoother, tuple) else (recipe.smoother,)
    pairing = pair(model, logs, candidates, recipe.time_offset, PLAIN, min_speed, progress=progress)
    progress("examining the motion")
    motions = tuple(pairing.smoother(log) for log in logs)
    if pairing.time_offset is not None:
        findings.append(Finding(Severity.INFO, None, pairing.time_offset, Topic.DELAY))
    findings += _tilt(model, motions, recipe, min_speed)
    excitations = tuple(excitation(motions, joint.name) for joint in model.joints)
    agreements = agreement(model, motions)
    findings += _of_motion(model, motions, excitations, agreements)
    seen = excited_rank(model, Regression(model, motions, recipe.filter, min_speed))
    findings += rank_findings(seen)
    return replace(whole, excitations=excitations, agreements=agreements, rank=seen)


def _of_motion(
    model: Model, motions: Sequence[Motion], excitations: Sequence[Excitation], agreements: Sequence[Agreement]
) -> Iterator[Finding]:
    """Yield what is said of gravity, and of each joint by its limits and its torque."""
    downward = list(gravity_findings(model, motions))
    yield from downward
    for joint, moved, torque in zip(model.joints, excitations, agreements, strict=True):
        yield from limit_findings(moved, model.limits.get(joint.name), joint.effort)
        if not downward:  # the file's torques are meant under its own gravity
            yield from agreement_findings(torque, joint.effort)


def _tilt(
    model: Model, motions: tuple[Motion, ...], recipe: Recipe, min_speed: tuple[float, ...] | None
) -> Iterator[Finding]:
    """Say where a base that does not stand level would explain much of the error."""
    if recipe.base_tilt or not any(isinstance(term, HasGravity) for term in model.terms):
        return
    try:
        found = find_base_tilt(model, motions, PLAIN, min_speed)
    except DynidentError:  # more than a base_tilt: what is wrong there is said by other findings
        return
    if found.after < (1.0 - WORTH) * found.before:
        yield Finding(Severity.INFO, None, found, Topic.LEAN)
