"""What of the robot or its model would explain the residual: the likeliest suspect, then the next with it set right."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import reduce

from dynident.checks.alternatives import better_alternative
from dynident.checks.case import SAMPLES, Case, cases_of
from dynident.checks.clock import clock_suspect
from dynident.checks.cost import Cost, cost
from dynident.checks.delays import delay_findings
from dynident.checks.finding import Finding, Topic
from dynident.checks.gains import gain_suspects
from dynident.checks.geometry import geometry_suspects
from dynident.checks.misfit import Misfit, misfit
from dynident.checks.missing import Missing, missing, with_missing
from dynident.checks.odd_log import odd_log_findings
from dynident.checks.payload import payload_findings
from dynident.checks.robot_notes import MissingTerm, TermKind, TiltedBase, Unexplained
from dynident.checks.suspect import Found, Suspect, promising, refined
from dynident.checks.unexplained import reversal_findings, unexplained
from dynident.errors import Severity, Step
from dynident.identification import BaseTilt, mounted
from dynident.log import Motion
from dynident.models import Model
from dynident.regression import ParallelFilter

__all__ = ["explained", "robot_findings"]

TRIAL = 150  # samples with which other columns, signs and axes are tried
LOOKING = "looking for what explains the residual"
MOST = 6  # causes that are looked for one after the other
TRIED = 4  # suspects whose value is sought, of those that one step explains best
NEAR = 0.6  # times the largest share by one step: suspects below are not tried
AT_REVERSALS = (TermKind.COULOMB, TermKind.SMOOTH, TermKind.STRIBECK, TermKind.DELAY)  # explain what is left there
ALIKE = 0.9  # times the largest share: suspects from here on cannot be told apart


def robot_findings(
    model: Model,
    motions: Sequence[Motion],
    held_out: Mapping[str, Motion],
    parallel_filter: ParallelFilter | None = None,
    min_speed: tuple[float, ...] | None = None,
    tilt: BaseTilt | None = None,
    progress: Callable[[str], None] = lambda _: None,
    plain: Model | None = None,
) -> Iterator[Finding]:
    """Yield what is likely wrong with the robot file, the columns of the logs, or the terms of the model.

    A large fault is named alone: with it, small ones cannot be told. ``tilt`` is that of the base that fits best;
    ``progress`` is called before each cause is sought. Large faults are sought with ``plain``, the model without the
    terms that were chosen with them, where it is given.
    """
    progress(Step(LOOKING))
    few, case = cases_of(model, motions, parallel_filter, min_speed, (TRIAL, SAMPLES))
    few = few if plain is None else replace(few, model=plain, memory=None)
    large = list(better_alternative(few))
    yield from large
    if large:
        return
    found = list(explained(case, tilt, progress))
    left = [one for one in found if isinstance(one.message, Unexplained)]
    yield from (one for one in found if one not in left)
    late = _joints_with(found, TermKind.DELAY)
    delays = [one for one in delay_findings(misfit(case), motions, min_speed) if one.joint not in late]
    yield from delays
    known = _joints_with([*found, *delays], *AT_REVERSALS)
    yield from (one for one in reversal_findings(model, motions, min_speed) if one.joint not in known)
    loaded = list(payload_findings(model, motions, held_out, parallel_filter, min_speed))
    yield from loaded
    odd = odd_log_findings(model, motions, held_out, parallel_filter, min_speed)
    others = [one for one in odd if one.source not in {other.source for other in loaded}]
    yield from others or left  # a log that does not fit with the others explains what is left


def _joints_with(found: Sequence[Finding], *effects: TermKind) -> set[str | None]:
    return {one.joint for one in found if isinstance(one.message, MissingTerm) and one.message.effect in effects}


def explained(
    case: Case, tilt: BaseTilt | None = None, progress: Callable[[str], None] = lambda _: None
) -> Iterator[Finding]:
    """Yield what would explain much of the training residual, one cause after the other.

    A cause is a gain, a zero, a length or an axis that is wrong, or an effect that the model lacks. Each is tested with
    those found before set right, so that none is named for what another one causes. Last comes what none explains.
    """
    names = tuple(joint.name for joint in case.model.joints)
    suspects = [*geometry_suspects(case.model), *gain_suspects(case.model), clock_suspect()]
    said: set[tuple[TermKind, int]] = set()
    for k in range(MOST + 1):
        progress(Step(LOOKING, k, MOST + 1))
        fit = misfit(case)
        if not fit.size:  # nothing is left, or counts
            return
        if k == MOST:
            yield from unexplained(fit)
            return
        weight = fit.weight.max(axis=0)
        absent = [one for one in missing(fit) if (one.kind, one.j) not in said]
        share = max((one.evidence.share for one in absent), default=0.0)
        level = replace(case, model=mounted(case.model, tilt.x, tilt.y)) if tilt else case
        tilted = 1.0 - misfit(level, weight).size / fit.size if tilt else 0.0
        share = max(share, tilted)
        found, others = _likeliest(fit, suspects, share)
        if found is not None and ALIKE * found.share > share:
            yield _finding(fit, found, others)
            case = found.case
        elif tilt and share == tilted > fit.worth:
            yield _tilted(tilt, cost(fit, misfit(level, weight)))
            case, tilt = level, None
        elif absent:
            alike = _of_one_kind(absent)
            case = reduce(with_missing, alike, case)
            price = cost(fit, misfit(case, weight))
            said |= {(one.kind, one.j) for one in alike}
            yield from (one.finding(names, price) for one in alike)
        else:
            yield from unexplained(fit)
            return


def _of_one_kind(absent: Sequence[Missing]) -> list[Missing]:
    """Return the effect that explains the most, the simplest of those that explain as much, and it at other joints."""
    kinds = list(TermKind)
    alike = [one for one in absent if one.evidence.share > ALIKE * absent[0].evidence.share]
    first = min(alike, key=lambda one: kinds.index(one.kind))
    return [one for one in absent if one.kind is first.kind and (one is first or one.partner is None)]


def _likeliest(fit: Misfit, suspects: Sequence[Suspect], least: float) -> tuple[Found | None, list[Found]]:
    """Return the suspect that explains the most, the simplest of those that explain as much, and these.

    Only suspects that may explain more than ``least`` are looked at: several steps explain at most about twice as much
    as the first.
    """
    seen = sorted(promising(fit, suspects), key=lambda pair: -round(pair[1].share, 6))  # equal ones in their order
    most = max(NEAR * seen[0][1].share, least / 2) if seen else 0.0
    tried = [one for one, evidence in seen[:TRIED] if evidence.share > most]
    if any(one.topic is Topic.GAIN for one in tried):  # a small gain looks like large ones of the others at first
        tried += [one for one in suspects if one.topic is Topic.GAIN and one not in tried]
    found = [one for suspect in tried if (one := refined(fit, suspect)) is not None]
    most = max((one.share for one in found), default=0.0)
    alike = sorted((one for one in found if one.share > ALIKE * most), key=lambda one: one.suspect.order)
    return (alike[0], alike[1:]) if alike else (None, [])


def _tilted(tilt: BaseTilt, price: Cost) -> Finding:
    figures = tilt.x, tilt.y, tilt.std, float(tilt.before), float(tilt.after)
    note = TiltedBase(*figures, cost=price.all, joint_cost=price.joint, removed=price.removed)
    return Finding(Severity.WARNING, None, note, Topic.BASE_TILT)


def _finding(fit: Misfit, found: Found, others: Sequence[Found]) -> Finding:
    one, prices = found.suspect, [_price(fit, other) for other in (found, *others)]
    note = one.note(found.value, found.std, found.share, tuple(other.rival for other in others))
    worst = max(x.all for x in prices), max(x.joint for x in prices)
    note = replace(note, cost=worst[0], joint_cost=worst[1], removed=prices[0].removed)
    return Finding(Severity.WARNING, one.joint, note, one.topic)


def _price(fit: Misfit, found: Found) -> Cost:
    met = replace(fit, case=found.suspect.in_use(fit.case, found.value))
    return cost(met, misfit(found.case, fit.weight.max(axis=0)))
