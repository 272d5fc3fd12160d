"""All checks together: of the robot file, of the logs, and of the motions with the model."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace

from dynident.checks import notes
from dynident.checks.channels import ChannelFacts, channels, check_log_fully
from dynident.checks.finding import Finding, Topic
from dynident.checks.gravity import gravity_findings
from dynident.checks.motion import Excitation, ExcitedRank, excitation, excited_rank, limit_findings, rank_findings
from dynident.checks.robot import LinkFacts, check_robot, link_facts
from dynident.checks.time import MINIMUM_SAMPLES, Timing, timing
from dynident.checks.torque import Agreement, agreement, agreement_findings
from dynident.errors import DynidentError, Severity, called
from dynident.estimators import LeastSquares
from dynident.identification import Recipe, find_base_tilt, pair
from dynident.log import Log, Motion
from dynident.models import HasGravity, HasRobotFile, Model
from dynident.regression import Regression, one_thread

__all__ = ["CheckResult", "run_checks"]

PLAIN = LeastSquares()
WORTH = 0.03  # share of the error that a tilted base must explain to be reported


@dataclass(frozen=True)
class CheckResult:
    """All findings on a robot file or a configuration, the most severe first, and the figures behind them.

    ``timings`` and ``channels`` are by log, ``excitations`` and ``agreements`` by joint over the training motions,
    ``links`` by link of the robot file. Without usable logs ``rank`` is None and the others are empty.
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
    progress: Callable[[str], None] | None = None,
) -> CheckResult:
    """Check the robot file of a model and its logs before a fit.

    ``logs`` are given by role ("train", "validation") and name; their joints are matched by name. ``recipe`` smooths
    them (default: ``Recipe()``). ``multi_turn`` are joints that may make any number of turns; ``found`` are findings to
    add, from reading the files; ``progress`` is called with a few words before each step. Logs with an error are left
    out of the checks of the motion. A stage that fails is a finding, so that none of its errors is raised; raises
    InputError where a log lacks a joint of the model.

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
    whole, sound = _recorded(model, logs, multi_turn, findings, say)
    if sound:
        try:
            with one_thread():
                whole = _moving(whole, model, sound, recipe or Recipe(), findings, say)
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
    """Return the result of checking each log, and the training logs without an error; adds to the findings."""
    kinds = {joint.name: joint.kind for joint in model.joints}
    timings, facts, sound = {}, {}, []
    for role, named in logs.items():
        for name, log in named.items():
            progress(f"checking {name}")
            log = replace(log.select(tuple(kinds)), source=name)
            found = check_log_fully(log, kinds, multi_turn)
            findings += found
            timings[name] = timing(log)
            if len(log) >= MINIMUM_SAMPLES:
                facts[name] = channels(log)
            if role == "train" and not any(one.severity == "error" for one in found):
                sound.append(log)
    return CheckResult((), timings, facts, links=_links(model)), sound


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
    logs: Sequence[Log],
    recipe: Recipe,
    findings: list[Finding],
    progress: Callable[[str], None],
) -> CheckResult:
    """Return the result with the checks of the smoothed training logs; adds to the findings."""
    min_speed = recipe.min_speeds(tuple(joint.name for joint in model.joints))
    candidates = recipe.smoother if isinstance(recipe.smoother, tuple) else (recipe.smoother,)
    pairing = pair(model, logs, candidates, recipe.time_offset, PLAIN, min_speed, progress=progress)
    progress("checking the motion")
    motions = tuple(called(pairing.smoother, log, Motion) for log in logs)
    if pairing.time_offset is not None:
        findings.append(Finding(Severity.INFO, None, pairing.time_offset, Topic.TIME_OFFSET))
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
    """Yield the findings on gravity, and on each joint's limits and torque."""
    downward = list(gravity_findings(model, motions))
    yield from downward
    for joint, moved, torque in zip(model.joints, excitations, agreements, strict=True):
        yield from limit_findings(moved, model.limits.get(joint.name), joint.effort)
        if not downward:  # the nominal torques hold only for the right gravity
            yield from agreement_findings(torque, joint.effort)


def _tilt(
    model: Model, motions: tuple[Motion, ...], recipe: Recipe, min_speed: tuple[float, ...] | None
) -> Iterator[Finding]:
    """Yield a note where a tilt of the base would explain much of the error."""
    if recipe.base_tilt or not any(isinstance(term, HasGravity) for term in model.terms):
        return
    try:
        found = find_base_tilt(model, motions, PLAIN, min_speed)
    except DynidentError:  # not a small tilt: other findings name the fault
        return
    if found.after < (1.0 - WORTH) * found.before:
        yield Finding(Severity.INFO, None, found, Topic.BASE_TILT)
