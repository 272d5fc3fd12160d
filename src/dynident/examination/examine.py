"""Puts together what is said of a robot file, of the logs, and of the motions in view of the model."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace

from dynident.calibration import find_lean, pair
from dynident.diagnostics import MINIMUM_SAMPLES, Channel, Finding, Timing, channels, inspect, timing
from dynident.errors import DynidentError
from dynident.estimators import LeastSquares
from dynident.examination.gravity import gravity_findings
from dynident.examination.motion import Excitation, Rank, excitation, limit_findings, rank, rank_findings
from dynident.examination.robot import LinkFacts, examine_robot, link_facts
from dynident.examination.torque import Agreement, agreement, agreement_findings
from dynident.identify import Recipe
from dynident.log import Log, Motion
from dynident.model import Model
from dynident.regression import Regression, one_thread
from dynident.terms import Bodies

__all__ = ["Examination", "examine"]

PLAIN = LeastSquares()
WORTH = 0.03  # share of the error that a leaning base must explain to be worth a word


@dataclass(frozen=True)
class Examination:
    """All findings on a robot file or a configuration, the gravest first, and the facts behind them.

    ``timings`` and ``channels`` are by log, ``excitations`` and ``agreements`` by joint over the training motions,
    ``rank`` is None and all of them are empty where there are no logs that can be used.
    """

    findings: tuple[Finding, ...]
    timings: Mapping[str, Timing] = field(default_factory=dict)
    channels: Mapping[str, tuple[Channel, ...]] = field(default_factory=dict)
    excitations: tuple[Excitation, ...] = ()
    agreements: tuple[Agreement, ...] = ()
    rank: Rank | None = None
    links: tuple[LinkFacts, ...] = ()

    @property
    def failed(self) -> bool:
        """Whether there is an error among the findings."""
        return any(finding.severity == "error" for finding in self.findings)


def examine(
    model: Model,
    logs: Mapping[str, Mapping[str, Log]],
    recipe: Recipe | None = None,
    *,
    multi_turn: Set[str] = frozenset(),
    found: Sequence[Finding] = (),
    progress: Callable[[str], None] = lambda _: None,
) -> Examination:
    """Examine a model's robot file and its logs, by role ("train", "validation") and name, matched by joint names.

    ``found`` is what reading has found already. The motions are smoothed as the recipe says. A log with an error is
    left out of what is said of the motion; a stage that fails is a finding. ``multi_turn`` as in ``check``.
    """
    joints = tuple(joint.name for joint in model.joints)
    kinds = {joint.name: joint.kind for joint in model.joints}
    findings = [*found, *_of_file(model, joints)]
    timings, facts, sound = {}, {}, []
    for role, named in logs.items():
        for name, log in named.items():
            progress(f"examining {name}")
            log = replace(log.select(joints), source=name)
            said = inspect(log, kinds, multi_turn)
            findings += said
            timings[name] = timing(log)
            if len(log) >= MINIMUM_SAMPLES:
                facts[name] = channels(log)
            if role == "train" and not any(one.severity == "error" for one in said):
                sound.append(log)
    whole = Examination((), timings, facts, links=_links(model))
    if sound:
        try:
            with one_thread():
                whole = _moving(whole, model, sound, recipe or Recipe(), findings, progress)
        except DynidentError as error:
            findings.append(Finding("error", None, str(error), "motion"))
    order = ("error", "warning", "info")
    return replace(whole, findings=tuple(sorted(findings, key=lambda one: order.index(one.severity))))


def _of_file(model: Model, joints: tuple[str, ...]) -> list[Finding]:
    """Return the findings on the robot file of a model; its inertias are only nominal, so none of them is an error."""
    found: list[Finding] = []
    for term in (term for term in model.terms if isinstance(term, Bodies)):
        found += examine_robot(term.file, joints, grave="warning")
        if term.file.gravity not in (None, term.gravity):
            words = f"the file's gravity {term.file.gravity} is not read; {term.gravity} m/s^2 is used."
            found.append(
                Finding(
                    "warning", None, f"{words} Set `gravity` if the arm is mounted so.", "gravity", source=term.source
                )
            )
    return found


def _links(model: Model) -> tuple[LinkFacts, ...]:
    return tuple(fact for term in model.terms if isinstance(term, Bodies) for fact in link_facts(term.file))


def _moving(
    whole: Examination,
    model: Model,
    logs: Sequence[Log],
    recipe: Recipe,
    findings: list[Finding],
    progress: Callable[[str], None],
) -> Examination:
    """Return the examination with what the smoothed training logs say; adds to the findings."""
    slow = recipe.slowest(tuple(joint.name for joint in model.joints))
    candidates = recipe.smoother if isinstance(recipe.smoother, tuple) else (recipe.smoother,)
    smoother, told = pair(model, logs, candidates, recipe.delay, PLAIN, slow, progress=progress)
    progress("examining the motion")
    motions = tuple(smoother(log) for log in logs)
    if "delay" in told:
        findings.append(Finding("info", None, f"delay: {told['delay']}.", "delay"))
    findings += _leaning(model, motions, recipe, slow)
    limits = {name: limit for term in model.terms if isinstance(term, Bodies) for name, limit in term.limits.items()}
    excitations = tuple(excitation(motions, joint.name) for joint in model.joints)
    agreements = agreement(model, motions)
    findings += (downward := list(gravity_findings(model, motions)))
    for joint, moved, torque in zip(model.joints, excitations, agreements, strict=True):
        findings += [
            *limit_findings(moved, limits.get(joint.name), joint.effort),
            *(() if downward else agreement_findings(torque, joint.effort)),  # of the file under the wrong gravity
        ]
    seen = rank(model, Regression(model, motions, recipe.parallel, slow))
    findings += rank_findings(seen)
    return replace(whole, excitations=excitations, agreements=agreements, rank=seen)


def _leaning(
    model: Model, motions: tuple[Motion, ...], recipe: Recipe, slow: tuple[float, ...] | None
) -> Iterator[Finding]:
    """Say where a base that does not stand level would explain much of the error."""
    if recipe.lean or not any(isinstance(term, Bodies) for term in model.terms):
        return
    try:
        found = find_lean(model, motions, PLAIN, slow)
    except DynidentError:  # more than a lean: what is wrong there is said by other findings
        return
    if found.after < (1.0 - WORTH) * found.before:
        words = f"{found.words[0].upper()}{found.words[1:]}. If it may stand so, set `lean: estimate` in the model."
        yield Finding("info", None, words, "lean")
