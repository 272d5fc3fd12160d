"""Torque that the model leaves, as something that changes by itself: a fault that no term of the recipe describes.

Each log is fitted by itself, so that what the recipe describes does not reach its residual. What it does not, such as
play, a ripple without a ripple term or a sensor that fails, raises the residual of its joint.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import ceil

import numpy as np

from dynident.fleets.changes import DRAWS, Change, Changes, Shape, find_changes
from dynident.fleets.history import History
from dynident.models import Joint
from dynident.regression import Group, GroupKind

__all__ = ["changes_and_residuals", "residual_groups"]

SHARE = 0.2  # of the rate of false alarms that residuals have
LASTING = 2  # logs that have the larger residual
LEAST = 10  # draws, at least, that are expected to show as much as a change at the rate


def residual_groups(joints: Sequence[Joint]) -> tuple[Group, ...]:
    """Return the residual of each joint as a group, whose direction (n, 1) is the logarithm of its residual."""
    directions = np.eye(len(joints))
    return tuple(
        Group(GroupKind.RESIDUAL, joint.name, directions[:, k : k + 1], ("residual",), (joint.effort,))
        for k, joint in enumerate(joints)
    )


def changes_and_residuals(
    histories: Sequence[History],
    groups: Sequence[Group],
    residuals: Sequence[History],
    joints: Sequence[Joint],
    rng: np.random.Generator,
    *,
    rate: float = 0.01,
    draws: int = DRAWS,
) -> Changes:
    """Return what has changed of the base parameters of robots of one type, and of the residuals of their joints.

    ``residuals`` are histories of the same robots and logs. A fifth of the ``rate`` is theirs, so that it holds for all
    together: a p-value is that of the search divided by its share. A residual that changes with parameters that explain
    it is left out, and one that only one log shows: single logs have residuals of their own. There are at least
    ``draws``. Raises what ``find_changes`` raises.
    """
    first, second = rng.spawn(2)
    if not residuals:
        return find_changes(histories, groups, first, rate=rate, draws=_draws(rate, draws))
    one, other = rate * (1 - SHARE), rate * SHARE
    found = find_changes(histories, groups, first, rate=one, draws=_draws(one, draws))
    left = find_changes(residuals, residual_groups(joints), second, rate=other, draws=_draws(other, draws))
    of, names = {history.robot: history for history in residuals}, {joint.name for joint in joints}
    kept = [
        x
        for x in left.found
        if _lasts(x, of[x.robot]) and not any(_explains(y, x, of[x.robot].logs, names) for y in found.of(x.robot))
    ]
    changes = [_shared(x, 1 - SHARE) for x in found.found] + [_shared(x, SHARE) for x in kept]
    chances = {
        robot: min(chance / (1 - SHARE), left.p_values.get(robot, 1.0) / SHARE, 1.0)
        for robot, chance in found.p_values.items()
    }
    return Changes(rate, tuple(changes), chances, found.silent, found.scatter, left.scatter)


def _draws(rate: float, draws: int) -> int:
    return max(draws, ceil(LEAST / rate)) if 0 < rate < 1 else draws


def _shared(change: Change, share: float) -> Change:
    return replace(change, p_value=min(change.p_value / share, 1.0))


def _lasts(change: Change, residual: History) -> bool:
    """Return whether at least two logs have the larger residual: more than halfway between the means of both sides."""
    value = residual.value @ change.group.directions[:, 0]
    first = change.index if change.shape is Shape.STEP else change.index + 1
    before, after = value[:first], value[first:]
    halfway = 0.5 * (before.mean() + after.mean())
    return bool(((after if change.size[0] > 0 else before) > halfway).sum() >= LASTING)


def _explains(change: Change, residual: Change, logs: Sequence[str], joints: set[str]) -> bool:
    """Return whether a change of the same joint, or of a payload or coupled motor, may have begun with a residual."""
    group = change.group
    if group.kind is not GroupKind.PAYLOAD and group.joint in joints and group.joint != residual.group.joint:
        return False
    (first, last), (start, end) = (_beginning(one, logs) for one in (change, residual))
    return first <= end and start <= last


def _beginning(change: Change, logs: Sequence[str]) -> tuple[int, int]:
    """Return the first and the last log that may be the first with some of a change; a drift is there a log later."""
    return logs.index(change.between[0]), logs.index(change.between[1]) + 1
