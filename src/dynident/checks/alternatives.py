"""Large faults, by trying: columns of two joints exchanged, signs reversed, another axis, another direction of gravity.

Each is a case of its own, fitted by plain least squares, and named where it fits far better than what was given.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.checks import notes, robot_notes
from dynident.checks.finding import Finding, Topic
from dynident.checks.geometry import displaced
from dynident.checks.misfit import Case, misfit
from dynident.checks.robot_notes import Channel
from dynident.errors import Note, Severity, brief
from dynident.models import HasGeometry, HasGravity, Model, Term

__all__ = ["better_alternative"]

Array = NDArray[np.float64]
POOR = 0.03  # relative error of the torque from which something else is tried
MUCH = 0.5  # times the error as given: a better alternative is below
ALIKE = 1.1  # times the least error: alternatives up to here fit as well
ACROSS = 0.1  # sine of the angle between axes that count as different


@dataclass(frozen=True, eq=False)
class Alternative:
    """A case with one thing otherwise; the joint and topic; and its note, from the errors (%) before and after."""

    case: Case
    joint: str | None
    topic: Topic
    note: Callable[[float, float], Note]

    __repr__ = brief


def better_alternative(case: Case) -> Iterator[Finding]:
    """Yield the alternative that fits the torque far better than the case as given, if there is one.

    Of several that fit about as well the first is named: columns before signs, axes and gravity.
    """
    before = _error(case)
    if before < POOR:
        return
    tried = [(_error(one.case), one) for one in _alternatives(case)]
    least = min((error for error, _ in tried), default=before)
    if least < MUCH * before:
        after, best = next(pair for pair in tried if pair[0] < ALIKE * least)
        note = best.note(100.0 * before, 100.0 * after)
        yield Finding(Severity.WARNING, best.joint, note, best.topic)


def _error(case: Case) -> float:
    """Return the root mean square over the joints of the relative error of the torque, all joints of equal weight."""
    size = np.asarray(np.linalg.norm(case.tau, axis=0), dtype=float)
    weight = np.where(size > 0, 1.0 / np.where(size > 0, size, 1.0), 0.0)
    return float(np.sqrt(misfit(case, weight).size / max(int(np.count_nonzero(size)), 1)))


def _alternatives(case: Case) -> Iterator[Alternative]:
    yield from _swapped(case)
    yield from _reversed(case)
    yield from _axes(case)
    yield from _gravities(case)


def _swapped(case: Case) -> Iterator[Alternative]:
    names = [joint.name for joint in case.model.joints]
    for i, j in combinations(range(len(names)), 2):
        order = np.arange(len(names))
        order[[i, j]] = j, i
        for channel in Channel:
            note = partial(robot_notes.JointsSwapped, (names[i], names[j]), channel)
            yield Alternative(_with(case, channel, order=order), None, Topic.SWAPPED, note)


def _reversed(case: Case) -> Iterator[Alternative]:
    for j, joint in enumerate(case.model.joints):
        sign = np.where(np.arange(len(case.model.joints)) == j, -1.0, 1.0)
        for channel in Channel:
            note = partial(robot_notes.ColumnReversed, channel)
            yield Alternative(_with(case, channel, sign=sign), joint.name, Topic.SIGN, note)


def _with(case: Case, channel: Channel, order: Any = slice(None), sign: Array | float = 1.0) -> Case:
    """Return the case with the columns of a channel in another order, and times a sign."""
    if channel is not Channel.POSITION:
        case = replace(case, tau=sign * case.tau[:, order], noise=case.noise[order])
    if channel is not Channel.TORQUE:
        q, dq, ddq, dddq = (sign * x[:, order] for x in (case.q, case.dq, case.ddq, case.dddq))
        case = replace(case, q=q, dq=dq, ddq=ddq, dddq=dddq, keep=case.keep[:, order])
    return case


def _axes(case: Case) -> Iterator[Alternative]:
    frames = {one.name: one for term in case.model.terms if isinstance(term, HasGeometry) for one in term.file.joints}
    for joint in case.model.joints:
        given = frames[joint.name].axis if joint.name in frames else np.zeros(3)
        for axis in np.eye(3):
            turn = np.cross(given, axis)
            if np.linalg.norm(turn) > ACROSS:
                angle = np.arctan2(np.linalg.norm(turn), given @ axis)
                by = np.concatenate([np.zeros(6), angle * turn / np.linalg.norm(turn)])
                other = replace(case, model=displaced(case.model, joint.name, by))
                note = partial(robot_notes.OtherAxis, tuple(given.tolist()), tuple(axis.tolist()))
                yield Alternative(other, joint.name, Topic.AXIS, note)


def _gravities(case: Case) -> Iterator[Alternative]:
    terms = [term for term in case.model.terms if isinstance(term, HasGravity)]
    assumed = np.array(terms[0].gravity) if len(terms) == 1 else np.zeros(3)
    size = float(np.linalg.norm(assumed))
    for down in (-assumed / (size or 1.0), *np.eye(3), *-np.eye(3)):
        if size and down @ assumed < (1.0 - ACROSS) * size:
            note = partial(_gravity, tuple(np.round(size * down, 1).tolist()), tuple(assumed.tolist()))
            model = replace(case.model, terms=_under(case.model, size * down))
            yield Alternative(replace(case, model=model), None, Topic.GRAVITY, note)


def _under(model: Model, gravity: Array) -> tuple[Term, ...]:
    x, y, z = gravity.tolist()
    return tuple(term.with_gravity((x, y, z)) if isinstance(term, HasGravity) else term for term in model.terms)


def _gravity(fitted: tuple[float, ...], assumed: tuple[float, ...], _before: float, _after: float) -> Note:
    return notes.OtherGravity(fitted, assumed)
