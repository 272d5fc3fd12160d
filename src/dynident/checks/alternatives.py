"""Search for large faults by trial: exchanged or coupled columns, reversed signs, another zero, axis or gravity.

Each alternative is a case of its own, fitted by plain least squares, and reported where it fits far better
than the data as given.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import cached_property, partial
from itertools import chain, combinations, pairwise
from typing import Any

import numpy as np

from dynident.checks import file_notes
from dynident.checks.file_notes import AffectedColumns
from dynident.checks.misfit import FitCase, misfit
from dynident.checks.suspects import displace_joint
from dynident.runtime import Finding, Note, Noun
from dynident.runtime.arrays import Array

MIN_ERROR_TO_TRY = 0.02  # relative error of the torque from which something else is tried
MAX_ERROR_RATIO = 0.5  # times the error as given: a better alternative is below
MIN_CHANGE = 1e-3  # share of the torque: smaller changes leave nothing to explain
MAX_TIE_RATIO = 1.02  # times the least error: alternatives up to here fit as well
NORMAL_EQUATIONS_SLACK = 1.05  # times an error: the normal equations have only half of the digits
RIDGE_SHARE = 1e-13  # of their diagonal, so that they can be solved
MAX_JOINTS_ALL_PAIRS = 24  # joints: of more, only neighbours are exchanged, as all pairs would take minutes
MIN_COUPLED_MOTION = 1e-3  # rad: a joint that stands tells nothing of a motor that turns with it
MIN_AXIS_SINE = 0.1  # sine of the angle between axes that count as different


class Alternative(Noun):
    """A case in which one thing is changed.

    ``joint`` is the one that the finding is about; ``note`` makes its message from the errors (%) before and after.
    """

    case: FitCase
    joint: str | None
    note: Callable[[float, float], Note]


def better_alternative(case: FitCase) -> Iterator[Finding]:
    """Yield the alternative that fits the torque far better than the case as given, if there is one.

    Of several that fit about equally well the first is reported: columns before signs, zeros, couplings, axes and
    gravity. None is reported where simple terms that the model lacks would fit better.
    """
    before = _relative_error(case)
    if before < MIN_ERROR_TO_TRY:
        return
    # screen by the normal equations first: a full fit of every alternative would take minutes
    plausible = _plausible_alternatives(case, _alternatives(case), MAX_ERROR_RATIO * MAX_TIE_RATIO * before)
    unexplained_share = _unexplained_share(case)
    trials = [
        (_relative_error(alternative.case), alternative)
        for alternative in plausible
        if _unexplained_share(alternative.case) < unexplained_share
    ]
    min_error = min((error for error, _ in trials), default=before)
    # an alternative must be much better than the case as given, and better than simple terms that the model may lack
    if min_error < MAX_ERROR_RATIO * before and min_error < _relative_error(_with_plain_terms(case)):
        after, best = next(pair for pair in trials if pair[0] < MAX_TIE_RATIO * min_error)
        yield Finding(best.note(100.0 * before, 100.0 * after), best.joint)


def _relative_error(case: FitCase) -> float:
    """Return the root mean square of the relative errors of the joints' torques, with equal weights."""
    size, weight = _size_and_weight(case)
    return float(np.sqrt(misfit(case, weight).size / max(int(np.count_nonzero(size)), 1)))


def _unexplained_share(case: FitCase) -> float:
    """Return the share of the squared changes of the torques that is not explained, the mean of all joints.

    Where joints move one after another, the torque of one that rests is hardly more than an offset, which any joint
    explains: this is no small error, as there are hardly any changes.
    """
    size, weight = _size_and_weight(case)
    mean = np.sum(case.tau, axis=0, where=case.keep) / np.maximum(case.keep.sum(axis=0), 1)
    changes = np.where(case.keep, case.tau - mean, 0.0)
    floor = np.square(MIN_CHANGE * np.where(size > 0, size, 1.0))
    squares = [np.square(x).sum(axis=0) + floor for x in (misfit(case, weight).unweighted, changes)]
    return float(np.mean(squares[0] / squares[1]))


def _size_and_weight(case: FitCase) -> tuple[Array, Array]:
    """Return the norm (n) of each joint's torque, and one over it, 0 for a torque of zero."""
    size = np.asarray(np.linalg.norm(case.tau, axis=0), dtype=float)
    return size, np.divide(1.0, size, out=np.zeros(len(size)), where=size > 0)


def _with_plain_terms(case: FitCase) -> FitCase:
    """Return the case with columns for friction, rotor inertia, offset and a spring of each joint."""
    columns = case.q, case.dq, case.ddq, np.sign(case.dq), np.ones_like(case.q)
    own_columns = (column * joint for column in columns for joint in np.eye(case.q.shape[1]))
    return replace(case, extra=(*case.extra, *own_columns))


def _plausible_alternatives(
    case: FitCase, alternatives: Iterable[Alternative], max_error: float
) -> Iterator[Alternative]:
    """Yield the alternatives whose error may be at most ``max_error``, judged by the normal equations.

    These are solved quickly and are the same for all orders and signs of the torques.
    """
    given_equations = last_equations = _NormalEquations(case)
    for alternative in alternatives:
        # a change of the torques alone needs no new regressor: reuse the equations of the same motion and model
        changed = alternative.case
        alike = (
            x
            for x in (last_equations, given_equations)
            if changed.q is x.case.q and changed.model is x.case.model and changed.extra is x.case.extra
        )
        if (equations := next(alike, None)) is None:
            equations = last_equations = _NormalEquations(changed)
        if equations.error(changed.tau) < NORMAL_EQUATIONS_SLACK * max_error:
            yield alternative


class _NormalEquations(Noun):
    """The normal equations of each joint of a case, for any torques."""

    case: FitCase

    def error(self, tau: Array) -> float:
        """Return the least relative error of any parameters for the torques (M, n).

        It is a lower bound of ``_relative_error``.
        """
        size = np.linalg.norm(tau, axis=0)
        squared = np.square(np.divide(1.0, size, out=np.zeros(len(size)), where=size > 0))
        kept_torque = tau * self.case.keep
        A = np.tensordot(squared, self._squares, 1)
        b = np.einsum("n,nmp,mn->p", squared, self._rows, kept_torque, optimize=True)
        # scale to a unit diagonal, and add a small ridge as the parameters may be dependent
        scale = np.sqrt(np.diag(A))
        scale[scale == 0] = 1.0
        A, b = A / np.outer(scale, scale) + RIDGE_SHARE * np.eye(len(b)), b / scale
        residual = float(np.square(kept_torque).sum(axis=0) @ squared - b @ np.linalg.solve(A, b))
        return float(np.sqrt(max(residual, 0.0) / max(int(np.count_nonzero(size)), 1)))

    @cached_property
    def _rows(self) -> Array:
        """The regressor (n, M, p) of each joint in the samples that count."""
        case = self.case
        Y = np.dstack([case.model.regressor(**case.states), *case.extra]) * case.keep[:, :, None]
        return np.ascontiguousarray(Y.swapaxes(0, 1))

    @cached_property
    def _squares(self) -> Array:
        return np.asarray(self._rows.swapaxes(1, 2) @ self._rows)


def _alternatives(case: FitCase) -> Iterator[Alternative]:
    return chain(
        *(_swap_columns(case), _reverse_signs(case), _reverse_drives(case), _turn_zeros(case), _couple_motors(case)),
        *(_turn_axes(case), _turn_gravity(case)),
    )


def _swap_columns(case: FitCase) -> Iterator[Alternative]:
    names = [joint.name for joint in case.model.joints]
    n = len(names)
    pairs = combinations(range(n), 2) if n <= MAX_JOINTS_ALL_PAIRS else pairwise(range(n))
    # columns are also counted from another number, by which those of all joints move on
    shifts = (range(n), range(n - 1, -1, -1)) if n > 2 else ()
    for cycle in (*pairs, *shifts):
        order = np.arange(n)
        order[list(cycle)] = np.roll(cycle, -1)
        for channel, swapped_case in _transform_columns(case, order=order):
            note = partial(file_notes.JointsSwapped, tuple(names[j] for j in cycle), channel)
            yield Alternative(swapped_case, None, note)


def _reverse_signs(case: FitCase) -> Iterator[Alternative]:
    for j, joint in enumerate(case.model.joints):
        sign = np.where(np.arange(len(case.model.joints)) == j, -1.0, 1.0)
        for channel, reversed_case in _transform_columns(case, sign=sign):
            yield Alternative(reversed_case, joint.name, partial(file_notes.ColumnReversed, channel, ()))


def _reverse_drives(case: FitCase) -> Iterator[Alternative]:
    """Yield the case with several motors reversed, if that of one after the other lowers the error."""
    # position and torque are reversed, as by gear ratios without their signs
    sign, best, error = np.ones(case.q.shape[1]), case, _NormalEquations(case).error(case.tau)
    for _ in sign:
        trials = []
        for flip in 1.0 - 2.0 * np.eye(len(sign)):
            *_, (_, reversed_case) = _transform_columns(case, sign=sign * flip)
            trials.append((_NormalEquations(reversed_case).error(reversed_case.tau), flip, reversed_case))
        lowest, flip, changed = min(trials, key=lambda trial: trial[0])
        if MAX_TIE_RATIO * lowest > error:
            break
        sign, best, error = sign * flip, changed, lowest
    names = [joint.name for joint, x in zip(case.model.joints, sign, strict=True) if x < 0]
    if len(names) > 1:
        note = partial(file_notes.ColumnReversed, AffectedColumns.BOTH, tuple(names[1:]))
        yield Alternative(best, names[0], note)


def _transform_columns(
    case: FitCase, order: Any = slice(None), sign: Array | float = 1.0
) -> Iterator[tuple[AffectedColumns, FitCase]]:
    """Yield the case with its columns reordered and multiplied by a sign: of positions, of torques, and of both."""
    q, dq, ddq, dddq = (sign * x[:, order] for x in (case.q, case.dq, case.ddq, case.dddq))
    moved_case = replace(case, q=q, dq=dq, ddq=ddq, dddq=dddq, keep=case.keep[:, order])
    tau, noise = sign * case.tau[:, order], case.noise[order]
    yield AffectedColumns.POSITION, moved_case
    yield AffectedColumns.TORQUE, replace(case, tau=tau, noise=noise)
    yield AffectedColumns.BOTH, replace(moved_case, tau=tau, noise=noise)


def _turn_zeros(case: FitCase) -> Iterator[Alternative]:
    # quarter turns, by which the conventions of robot files and controllers differ
    for j, joint in enumerate(case.model.joints):
        for quarters in (1, -1, 2) if joint.kind == "revolute" else ():
            q = case.q.copy()
            q[:, j] += quarters * np.pi / 2
            yield Alternative(replace(case, q=q), joint.name, partial(file_notes.OtherZero, 90 * quarters))


def _couple_motors(case: FitCase) -> Iterator[Alternative]:
    # a motor that turns with the joint before its own, as of a parallel linkage or a wrist with a differential
    names = [joint.name for joint in case.model.joints]
    is_moving = np.ptp(case.q, axis=0) > MIN_COUPLED_MOTION
    turns = [joint.kind == "revolute" and moves for joint, moves in zip(case.model.joints, is_moving, strict=True)]
    for j in (j for j in range(1, len(names)) if turns[j - 1] and turns[j]):
        for coefficient in (1, -1):
            gears = np.eye(len(names))
            gears[j, j - 1] = coefficient
            inverse = np.asarray(np.linalg.inv(gears), dtype=float)
            q, dq, ddq, dddq = (x @ inverse.T for x in (case.q, case.dq, case.ddq, case.dddq))
            coupled_case = replace(case, q=q, dq=dq, ddq=ddq, dddq=dddq)
            note = partial(file_notes.MotorCoupled, names[j], names[j - 1], coefficient)
            yield Alternative(coupled_case, names[j], partial(note, AffectedColumns.POSITION))
            # it has its inertia and friction, too, which act on both joints
            of_motor = (case.ddq, case.dq, np.sign(case.dq))
            columns = tuple(np.outer(x[:, j], gears[j]) for x in of_motor)
            both_case = replace(coupled_case, tau=case.tau @ gears, extra=(*case.extra, *columns))
            yield Alternative(both_case, names[j], partial(note, AffectedColumns.BOTH))


def _turn_axes(case: FitCase) -> Iterator[Alternative]:
    frames = {
        file_joint.name: file_joint
        for term in case.model.terms
        if term.file is not None and term.has_own("with_displacement")
        for file_joint in term.file.joints
    }
    # try the three coordinate axes of the joint's frame
    for joint in case.model.joints:
        given_axis = frames[joint.name].axis if joint.name in frames else np.zeros(3)
        for axis in np.eye(3):
            turn = np.cross(given_axis, axis)
            if np.linalg.norm(turn) > MIN_AXIS_SINE:
                # turn the axis alone, about the common normal of the old and the new one
                angle = np.arctan2(np.linalg.norm(turn), given_axis @ axis)
                displacement = np.concatenate([np.zeros(6), angle * turn / np.linalg.norm(turn)])
                turned_case = replace(case, model=displace_joint(case.model, joint.name, displacement))
                note = partial(file_notes.OtherAxis, tuple(given_axis.tolist()), tuple(axis.tolist()))
                yield Alternative(turned_case, joint.name, note)


def _turn_gravity(case: FitCase) -> Iterator[Alternative]:
    terms = [term for term in case.model.terms if term.gravity is not None]
    assumed = np.array(terms[0].gravity) if len(terms) == 1 else np.zeros(3)
    size = float(np.linalg.norm(assumed))
    for down in (-assumed / (size or 1.0), *np.eye(3), *-np.eye(3)):
        # directions near the assumed one are a tilt of the base, which is tested elsewhere
        if size and down @ assumed < (1.0 - MIN_AXIS_SINE) * size:
            fitted = tuple((np.round(size * down, 1) + 0.0).tolist())
            gravity_note = file_notes.OtherGravity(fitted, tuple(assumed.tolist()))
            x, y, z = (size * down).tolist()
            model = replace(case.model, terms=tuple(term.with_gravity((x, y, z)) for term in case.model.terms))
            yield Alternative(replace(case, model=model), None, lambda *_errors, note=gravity_note: note)
