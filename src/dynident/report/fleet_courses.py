"""What a fleet's figures draw: the parameters of a group from log to log, beside the changes found in them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from dynident.fleets import Shape
from dynident.regression import GroupKind
from dynident.report.figures import Array, Course, Mark
from dynident.report.fleet_words import shape_words, worst_first

if TYPE_CHECKING:
    from dynident.fleets import Change, History, Scatter
    from dynident.regression import Group

__all__ = ["RobotCourses"]

SHOWN = 1e-6  # what a log may lack of a direction that it shows
SINGULAR = 1e-10  # relative eigenvalues of an information matrix that are zero


class RobotCourses:
    """The parameters of one robot over time, by group, with all else as in the mean of its logs.

    ``changes`` are those found in its history; ``scatter`` is that of its type, which intervals and means count;
    ``left`` are the courses of what the model leaves of the torque.
    """

    def __init__(
        self, history: History, changes: Sequence[Change], scatter: Scatter | None, left: RobotCourses | None = None
    ) -> None:
        self.history, self.changes, self.scatter, self.left = history, changes, scatter, left

    @property
    def changed(self) -> list[Change]:
        """All changes of this robot, the worst first."""
        return worst_first([*self.changes, *(self.left.changes if self.left else ())])

    @cached_property
    def information(self) -> Array:
        """What each log says of the robot (K, b, b), not of its day."""
        own = self.history.information
        return own if self.scatter is None else np.array([self.scatter.with_scatter(one) for one in own])

    def of(self, group: Group) -> list[Course]:
        """Return one course for each direction of the group.

        A log says a = (D' I D)^-1 D' I (beta - mean - the other changes) of it. Friction, offset and ripple have their
        values, where a direction is one base parameter; all others the difference from the mean before the changes. A
        residual is drawn as a torque, which its history has the logarithm of.
        """
        if group.kind is GroupKind.RESIDUAL and self.left is not None:
            return [_as_torque(one) for one in self.left.courses(group)]
        return self.courses(group)

    def courses(self, group: Group) -> list[Course]:
        """Return the same in the parameters of the history."""
        own = [one for one in self.changes if _same(one.group, group)]
        others = [one for one in self.changes if not _same(one.group, group)]
        rest = self.history.value - self.mean - _effect(others, self.history.days, self.history)
        value, std = _along(group.directions, self.information, rest)
        zero = self.before(group)
        line = self._line(own, zero) if own else None
        marks = [Mark(one.day, shape_words(one), self.between(one)) for one in own]
        return [
            Course(
                self.history.robot,
                f"{name}{'' if np.isfinite(zero[k]) else ', difference from the mean'}",
                group.units[k],
                self.history.logs,
                self.history.days,
                np.nan_to_num(zero[k]) + value[:, k],
                std[:, k],
                (line[0], line[1][:, k]) if line else None,
                marks,
            )
            for k, name in enumerate(group.names)
        ]

    def between(self, change: Change) -> tuple[float, float]:
        """Return the first and the last day that a change may have begun."""
        first, last = (self.history.days[self.history.logs.index(log)] for log in change.between)
        return float(first), float(last)

    @cached_property
    def mean(self) -> Array:
        """The mean (b) of the logs by their information, without the changes found."""
        quiet = self.history.value - _effect(self.changes, self.history.days, self.history)
        right = np.einsum("kij,kj->i", self.information, quiet)
        mean: Array = _solved(self.information.sum(axis=0)[None], right[None])[0][0]
        return mean

    def before(self, group: Group) -> Array:
        """Return the value (k) of each direction in the mean, nan where it has none of its own."""
        if group.kind is GroupKind.RESIDUAL and self.left is not None:
            return self.left.before(group)
        D = group.directions
        row = np.abs(D).argmax(axis=0)
        own = ((D != 0).sum(axis=0) == 1) & (group.kind is not GroupKind.PAYLOAD)
        size = D[row, np.arange(D.shape[1])]
        zero: Array = np.divide(self.mean[row], size, out=np.full(len(size), np.nan), where=own)
        return zero

    def _line(self, own: Sequence[Change], zero: Array) -> tuple[Array, Array]:
        """Return the days (L) and values (L, k) of the changes of one group, with both ends of each step."""
        corners = np.unique([self.history.days[0], self.history.days[-1], *(one.day for one in own)])
        ends = [sum(_course(one, corners, self.history, after) * one.size for one in own) for after in (False, True)]
        return np.repeat(corners, 2), np.nan_to_num(zero) + np.stack(ends, axis=1).reshape(-1, len(zero))


def _as_torque(one: Course) -> Course:
    """Return a course of logarithms as one of their exponentials."""
    value = np.exp(one.value)
    line = one.fitted and (one.fitted[0], np.exp(one.fitted[1]))
    return replace(one, value=value, std=value * one.std, fitted=line)


def _same(one: Group, other: Group) -> bool:
    return (one.kind, one.joint) == (other.kind, other.joint)


def _course(change: Change, days: Array, history: History, after: bool = True) -> Array:
    """Return how much of a change there is on days (L, 1), just ``after`` a step or just before it."""
    if change.shape is Shape.STEP:
        return np.where(days >= change.day if after else days > change.day, 1.0, 0.0)[:, None]
    return np.asarray(np.clip((days - change.day) / (history.days[-1] - change.day), 0.0, 1.0))[:, None]


def _effect(changes: Sequence[Change], days: Array, history: History) -> Array:
    """Return what the changes do to the base parameters (K, b), as far as the logs tell."""
    effect = np.zeros((len(days), history.value.shape[1]))
    for one in changes:
        size = np.where(np.isfinite(one.std), one.size, 0.0)
        effect += _course(one, days, history) * (one.group.directions @ size)
    return effect


def _along(directions: Array, information: Array, rest: Array) -> tuple[Array, Array]:
    """Return the amounts (K, k) of the directions in each log's ``rest`` (K, b), with their standard errors."""
    left = directions.T @ information
    return _solved(left @ directions, (left @ rest[..., None])[..., 0])


def _solved(matrix: Array, right: Array) -> tuple[Array, Array]:
    """Return x (K, k) of A x = right for information matrices A (K, k, k), with standard errors, infinite if free."""
    scale = np.sqrt(np.diagonal(matrix, axis1=1, axis2=2).max(axis=0))
    scale = np.where(scale > 0, scale, 1.0)
    scaled: Array = matrix / np.outer(scale, scale)
    inverse = np.linalg.pinv(scaled, SINGULAR, hermitian=True)
    shown = np.diagonal(inverse @ scaled, axis1=1, axis2=2) > 1 - SHOWN
    std = np.sqrt(np.maximum(np.diagonal(inverse, axis1=1, axis2=2), 0.0)) / scale
    return (inverse @ (right / scale)[..., None])[..., 0] / scale, np.where(shown, std, np.inf)
