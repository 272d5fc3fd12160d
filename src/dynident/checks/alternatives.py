"""Large faults, by trying: columns of two joints exchanged, signs reversed, another axis, another direction of gravity.

Each is a case of its own, fitted by plain least squares, and named where it fits far better than what was given.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import combinations, pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.checks import notes, robot_notes
from dynident.checks.case import Case
from dynident.checks.finding import Finding, Topic
from dynident.checks.geometry import displaced
from dynident.checks.misfit import misfit
from dynident.checks.robot_notes import Channel
from dynident.errors import Note, Severity, brief
from dynident.models import HasGeometry, HasGravity, Model, Term

__all__ = ["NEIGHBOURS", "better_alternative"]

Array = NDArray[np.float64]
POOR = 0.03  # relative error of the torque from which something else is tried
MUCH = 0.5  # times the error as given: a better alternative is below
ALIKE = 1.1  # times the least error: alternatives up to here fit as well
SLACK = 1.05  # times an error: the normal equations have only half of the digits
RIDGE = 1e-13  # of their diagonal, so that they can be solved
NEIGHBOURS = 24  # joints: of more, only neighbours are exchanged, as all pairs would take minutes
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

    Of several that fit about as well the first is named: columns before signs, axes and gravity. None is where simple
    terms that the model lacks would fit better.
    """
    before = _error(case)
    if before < POOR:
        return
    tried = [(_error(one.case), one) for one in _possible(case, _alternatives(case), MUCH * ALIKE * before)]
    least = min((error for error, _ in tried), default=before)
    if least < MUCH * before and least < _error(_with_terms(case)):
        after, best = next(pair for pair in tried if pair[0] < ALIKE * least)
        note = best.note(100.0 * before, 100.0 * after)
        yield Finding(Severity.WARNING, best.joint, note, best.topic)


def _error(case: Case) -> float:
    """Return the root mean square over the joints of the relative error of the torque, all joints of equal weight."""
    size = np.asarray(np.linalg.norm(case.tau, axis=0), dtype=float)
    weight = np.where(size > 0, 1.0 / np.where(size > 0, size, 1.0), 0.0)
    return float(np.sqrt(misfit(case, weight).size / max(int(np.count_nonzero(size)), 1)))


def _with_terms(case: Case) -> Case:
    """Return the case with viscous and Coulomb friction, rotor inertia, offset and a spring of each joint besides."""
    columns = case.q, case.dq, case.ddq, np.sign(case.dq), np.ones_like(case.q)
    joints = np.eye(case.q.shape[1])
    return replace(case, extra=(*case.extra, *(column * joint for column in columns for joint in joints)))


def _possible(case: Case, alternatives: Iterable[Alternative], most: float) -> Iterator[Alternative]:
    """Yield the alternatives that may have an error of at most ``most``, by the normal equations: these are quickly
    solved, and are the same for all orders and signs of the torques."""
    given = moved = _NormalEquations(case)
    for one in alternatives:
        equations = next((x for x in (moved, given) if one.case.q is x.case.q and one.case.model is x.case.model), None)
        if equations is None:
            equations = moved = _NormalEquations(one.case)
        if equations.error(one.case.tau) < SLACK * most:
            yield one


@dataclass(frozen=True, eq=False)
class _NormalEquations:
    """The normal equations of each joint of a case, for any torques."""

    case: Case

    __repr__ = brief

    def error(self, tau: Array) -> float:
        """Return the least error with which any parameters explain the torques (M, n); ``_error`` is never below it."""
        size = np.linalg.norm(tau, axis=0)
        squared = np.square(np.divide(1.0, size, out=np.zeros(len(size)), where=size > 0))
        counted = tau * self.case.keep
        A = np.tensordot(squared, self._squares, 1)
        b = np.einsum("n,nmp,mn->p", squared, self._rows, counted, optimize=True)
        scale = np.sqrt(np.diag(A))
        scale[scale == 0] = 1.0
        A, b = A / np.outer(scale, scale) + RIDGE * np.eye(len(b)), b / scale
        left = float(np.square(counted).sum(axis=0) @ squared - b @ np.linalg.solve(A, b))
        return float(np.sqrt(max(left, 0.0) / max(int(np.count_nonzero(size)), 1)))

    @cached_property
    def _rows(self) -> Array:
        """The regressor (n, M, p) of each joint in the samples that count."""
        case = self.case
        Y = case.model.regressor(**case.states) * case.keep[:, :, None]
        return np.ascontiguousarray(Y.swapaxes(0, 1))

    @cached_property
    def _squares(self) -> Array:
        return np.asarray(self._rows.swapaxes(1, 2) @ self._rows)


def _alternatives(case: Case) -> Iterator[Alternative]:
    yield from _swapped(case)
    yield from _reversed(case)
    yield from _axes(case)
    yield from _gravities(case)


def _swapped(case: Case) -> Iterator[Alternative]:
    names = [joint.name for joint in case.model.joints]
    pairs = combinations(range(len(names)), 2) if len(names) <= NEIGHBOURS else pairwise(range(len(names)))
    for i, j in pairs:
        order = np.arange(len(names))
        order[[i, j]] = j, i
        for channel, other in _with(case, order=order):
            note = partial(robot_notes.JointsSwapped, (names[i], names[j]), channel)
            yield Alternative(other, None, Topic.SWAPPED, note)


def _reversed(case: Case) -> Iterator[Alternative]:
    for j, joint in enumerate(case.model.joints):
        sign = np.where(np.arange(len(case.model.joints)) == j, -1.0, 1.0)
        for channel, other in _with(case, sign=sign):
            yield Alternative(other, joint.name, Topic.SIGN, partial(robot_notes.ColumnReversed, channel))


def _with(case: Case, order: Any = slice(None), sign: Array | float = 1.0) -> Iterator[tuple[Channel, Case]]:
    """Yield the case with the columns of positions, of torques, and of both in another order, and times a sign."""
    q, dq, ddq, dddq = (sign * x[:, order] for x in (case.q, case.dq, case.ddq, case.dddq))
    moved = replace(case, q=q, dq=dq, ddq=ddq, dddq=dddq, keep=case.keep[:, order])
    tau, noise = sign * case.tau[:, order], case.noise[order]
    yield Channel.POSITION, moved
    yield Channel.TORQUE, replace(case, tau=tau, noise=noise)
    yield Channel.BOTH, replace(moved, tau=tau, noise=noise)


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
            note = partial(_gravity, tuple((np.round(size * down, 1) + 0.0).tolist()), tuple(assumed.tolist()))
            model = replace(case.model, terms=_under(case.model, size * down))
            yield Alternative(replace(case, model=model), None, Topic.GRAVITY, note)


def _under(model: Model, gravity: Array) -> tuple[Term, ...]:
    x, y, z = gravity.tolist()
    return tuple(term.with_gravity((x, y, z)) if isinstance(term, HasGravity) else term for term in model.terms)


def _gravity(fitted: tuple[float, ...], assumed: tuple[float, ...], _before: float, _after: float) -> Note:
    return notes.OtherGravity(fitted, assumed)
