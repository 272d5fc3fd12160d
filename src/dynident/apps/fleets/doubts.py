"""Doubts about the logs of a fleet: the same recording twice, an arm at rest, a robot of which everything
changes at once, or all robots changing together.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import ceil
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dynident.apps.fleets.changes import DRAWS, MIN_SCATTER_DOF, Change, Changes, ChangeShape, find_changes
from dynident.apps.fleets.components import History, Scatter
from dynident.models import Joint
from dynident.regression import GroupKind, ParameterGroup
from dynident.runtime import join_names
from dynident.runtime.arrays import Array
from dynident.runtime.jobs import Status

if TYPE_CHECKING:
    import polars as pl

    from dynident.apps.fleets.result import FleetResult

MIN_DOUBTED_GROUPS = 3  # groups of a robot that change with one log, before the log is doubted
MIN_ROBOTS, MAX_LOGS, MAX_BINS = 3, 4000, 60  # at least, at most, and at most, to look for what robots have in common
PERMUTATIONS = 199
MAX_LISTED = 3
MAX_RELATIVE_ERROR = 3.0  # times the median error of a type, from which on logs are named
RANK_TOLERANCE = 1e-9
RESIDUAL_RATE_SHARE = 0.2  # of the rate of false alarms that residuals have
MIN_RESIDUAL_LOGS = 2  # logs that have the larger residual
MIN_EXPECTED_DRAWS = 10  # draws, at least, that are expected to show as much as a change at the rate


def doubts(fleet_result: FleetResult, rng: np.random.Generator) -> Iterator[str]:
    """Yield warnings about logs that may not be what they are taken for; ``rng`` draws permutations of them."""
    yield from _duplicate_warnings(fleet_result.histories)
    yield from _rest_warnings(fleet_result.histories)
    yield from _misfit_warnings(fleet_result.rows)
    robots = {history.robot for history in fleet_result.histories}
    # the types of robots that have results, in the order of the changes
    kinds = [kind for kind, names in fleet_result.types.items() if not robots.isdisjoint(names)]
    for kind, changes in zip(kinds, fleet_result.changes, strict=True):
        yield from _simultaneous_change_warnings(changes, len(fleet_result.groups))
        type_histories = [history for history in fleet_result.histories if history.robot in fleet_result.types[kind]]
        if common := common_groups(type_histories, fleet_result.groups, changes.scatter, rng):
            words = join_names([_group_name(group) for group in common], MAX_LISTED)
            yield (
                f"most of what differs from log to log is the same on all robots of type {kind} at a time: {words}. "
                "The temperature, the motion, a recalibration? What all robots have at once is not among the changes."
            )


def common_groups(
    histories: Sequence[History], groups: Sequence[ParameterGroup], scatter: Scatter, rng: np.random.Generator
) -> tuple[ParameterGroup, ...]:
    """Return the groups in which robots move together: more than half of the scatter is that of times, not of robots.

    Logs of all robots are put into bins of time; the share of a bin's mean in the sum of squares is compared with the
    largest of all directions after the logs of each robot were permuted, which robots that differ independently allow.
    """
    histories_of_many = [history for history in histories if len(history.logs) > 1]
    if len(histories_of_many) < MIN_ROBOTS or not groups or scatter.dof < MIN_SCATTER_DOF:
        return ()
    # random robots until there are enough logs; the first one counts in any case
    sample = [histories_of_many[k] for k in rng.permutation(len(histories_of_many))]
    is_kept = np.cumsum([len(history.logs) for history in sample]) <= max(MAX_LOGS, len(sample[0].logs))
    sample = [history for history, yes in zip(sample, is_kept, strict=True) if yes]
    errors = np.concatenate([_direction_errors(history, groups, scatter) for history in sample])
    days = np.concatenate([history.days for history in sample])
    robots = np.repeat(np.arange(len(sample)), [len(history.logs) for history in sample])
    # bins hold about as many logs as there are robots
    edges = np.unique(np.quantile(days, np.linspace(0, 1, min(len(days) // len(sample), MAX_BINS) + 1))[1:-1])
    bins = np.searchsorted(edges, days, side="right")
    share = _between_share(errors, bins)
    # permuting the logs within each robot leaves only what robots have in common by chance
    chance = [
        _between_share(errors[np.lexsort((rng.random(len(days)), robots))], bins).max() for _ in range(PERMUTATIONS)
    ]
    moves = (share > 0.5) & (share > max(chance))
    ends = np.cumsum([group.directions.shape[1] for group in groups])
    return tuple(group for group, moving in zip(groups, np.split(moves, ends[:-1]), strict=True) if moving.any())


def _direction_errors(history: History, groups: Sequence[ParameterGroup], scatter: Scatter) -> Array:
    """Return how far the logs are from the mean of their robot (K, d) along directions, in standard deviations.

    The directions of each group are fitted by themselves.
    """
    weights = np.array([scatter.with_scatter(entry) for entry in history.information])
    mean = np.linalg.lstsq(weights.sum(axis=0), np.einsum("kij,kj->i", weights, history.value), rcond=None)[0]
    scores = np.einsum("kij,kj->ki", weights, history.value - mean)
    directions = [group.directions for group in groups]
    return np.concatenate([_standardised_sizes(scores @ D, weights, D) for D in directions], axis=1)


def _standardised_sizes(scores: Array, weights: Array, directions: Array) -> Array:
    """Return the sizes (K, d) that fit the scores (K, d) of directions, in standard deviations; zero where hidden."""
    information = np.einsum("id,kij,je->kde", directions, weights, directions)
    # scaled to a unit diagonal, so that the rank does not depend on units
    size = np.sqrt(np.maximum(np.einsum("kdd->kd", information), 0.0))
    scale = np.divide(1.0, size, out=np.zeros_like(size), where=size > RANK_TOLERANCE * size.max(initial=0.0))
    inverse = np.linalg.pinv(information * scale[:, :, None] * scale[:, None, :], rcond=RANK_TOLERANCE, hermitian=True)
    std = np.sqrt(np.maximum(np.einsum("kdd->kd", inverse), 0.0))
    sizes = np.einsum("kde,ke->kd", inverse, scale * scores)
    standardised: Array = np.divide(sizes, std, out=np.zeros_like(sizes), where=std > RANK_TOLERANCE)
    return standardised


def _between_share(errors: Array, bins: NDArray[np.intp]) -> Array:
    """Return the share (d) of the variation between bins in the sum of squares of errors (N, d)."""
    order = np.argsort(bins, kind="stable")
    starts = np.flatnonzero(np.diff(bins[order], prepend=-1))
    sums = np.add.reduceat(errors[order], starts)
    counts = np.diff(starts, append=len(order))
    total = (errors**2).sum(axis=0)
    share: Array = np.divide((sums**2 / counts[:, None]).sum(axis=0), total, out=np.zeros_like(total), where=total > 0)
    return share


def _duplicate_warnings(histories: Sequence[History]) -> Iterator[str]:
    """Yield a warning where several logs have the same estimates to the bit, as only the same recording has."""
    logs_by_value: dict[bytes, list[str]] = {}
    for history in histories:
        for log, value in zip(history.logs, history.value, strict=True):
            logs_by_value.setdefault(value.tobytes(), []).append(f"{log} ({history.robot})")
    alike = [" = ".join(names) for names in logs_by_value.values() if len(names) > 1]
    if alike:
        yield f"the same recording stands under several names, and counts as often: {join_names(alike, MAX_LISTED)}."


def _rest_warnings(histories: Sequence[History]) -> Iterator[str]:
    """Yield a warning where logs show less than half of what others show."""
    ranks = [(f"{log} ({history.robot})", _shown_rank(J)) for history in histories
             for log, J in zip(history.logs, history.information, strict=True)]  # fmt: skip
    usual_rank = np.median([rank for _, rank in ranks]) if ranks else 0
    if weak_logs := [name for name, rank in ranks if rank < usual_rank / 2]:
        names = join_names(weak_logs, MAX_LISTED)
        yield f"logs that show less than half of the parameters that others show, as at rest: {names}."


def _misfit_warnings(rows: pl.DataFrame) -> Iterator[str]:
    """Yield a warning where logs fit far worse than the others of their type."""
    import polars as pl

    usual = pl.col("error").median().over("type")
    worse = (
        rows.filter(pl.col("status") == Status.OK)
        .filter(pl.col("error") > MAX_RELATIVE_ERROR * usual)
        .sort("robot", "date")
    )
    if names := [f"{log} ({robot}), {error:.3g} %" for log, robot, error in worse["log", "robot", "error"].iter_rows()]:
        yield (
            f"logs whose torque error is more than {MAX_RELATIVE_ERROR:.0f} times the median: "
            f"{join_names(names, MAX_LISTED)}. They may need terms that the recipe has not, because they were not "
            "among the logs that chose it."
        )


def _shown_rank(information: Array) -> int:
    """Return the number of directions that are shown, whatever the units."""
    size = np.sqrt(np.maximum(np.diag(information), 0.0))
    is_shown = size > RANK_TOLERANCE * size.max(initial=0.0)
    J = information[np.ix_(is_shown, is_shown)] / np.outer(size[is_shown], size[is_shown])
    return int((np.linalg.eigvalsh(J) > RANK_TOLERANCE).sum()) if is_shown.any() else 0


def _simultaneous_change_warnings(changes: Changes, groups: int) -> Iterator[str]:
    """Yield a warning of each robot of which many groups, of so many, change with one log."""
    min_groups = max(2, min(MIN_DOUBTED_GROUPS, groups - 1))
    changes_by_log: dict[tuple[str, str], list[Change]] = {}
    for change in changes.changes:
        # only a step comes with one log
        if change.shape is ChangeShape.STEP:
            changes_by_log.setdefault((change.robot, change.since), []).append(change)
    for (robot, log), log_changes in changes_by_log.items():
        if len(names := list(dict.fromkeys(_group_name(change.group) for change in log_changes))) >= min_groups:
            yield (
                f"{robot}: {join_names(names, MAX_LISTED)} change with {log}; look first whether units, signs and "
                "zeros are as they were, and whether the log is one of this robot."
            )


def _group_name(group: ParameterGroup) -> str:
    return f"{group.kind.value} of {group.joint}"


def residual_groups(joints: Sequence[Joint]) -> tuple[ParameterGroup, ...]:
    """Return the residual of each joint as a group, whose direction (n, 1) is the logarithm of its residual."""
    directions = np.eye(len(joints))
    return tuple(
        ParameterGroup(GroupKind.RESIDUAL, joint.name, directions[:, k : k + 1], ("residual",), (joint.effort,))
        for k, joint in enumerate(joints)
    )


def find_changes_and_residuals(
    histories: Sequence[History],
    groups: Sequence[ParameterGroup],
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
    parameter_rng, residual_rng = rng.spawn(2)
    if not residuals:
        return find_changes(histories, groups, parameter_rng, rate=rate, draws=_enough_draws(rate, draws))
    parameter_rate, residual_rate = rate * (1 - RESIDUAL_RATE_SHARE), rate * RESIDUAL_RATE_SHARE
    parameter_search, residual_search = (
        find_changes(logs, directions, search_rng, rate=share, draws=_enough_draws(share, draws))
        for logs, directions, search_rng, share in (
            (histories, groups, parameter_rng, parameter_rate),
            (residuals, residual_groups(joints), residual_rng, residual_rate),
        )
    )
    history_by_robot, joint_names = {history.robot: history for history in residuals}, {joint.name for joint in joints}
    # as by Bonferroni, each search has its share of the rate, and p-values are divided by it
    changes = [_scale_p_value(change, 1 - RESIDUAL_RATE_SHARE) for change in parameter_search.changes]
    for change in residual_search.changes:
        residual = history_by_robot[change.robot]
        # drop residual changes that one log shows, or that a change of parameters explains
        explanations = (
            _is_explanation(x, change, residual.logs, joint_names) for x in parameter_search.of(change.robot)
        )
        if _is_lasting(change, residual) and not any(explanations):
            changes.append(_scale_p_value(change, RESIDUAL_RATE_SHARE))
    chances = {}
    for robot, chance in parameter_search.p_values.items():
        residual_chance = residual_search.p_values.get(robot, 1.0) / RESIDUAL_RATE_SHARE
        chances[robot] = min(chance / (1 - RESIDUAL_RATE_SHARE), residual_chance, 1.0)
    return Changes(
        rate, tuple(changes), chances, parameter_search.silent, parameter_search.scatter, residual_search.scatter
    )


def _enough_draws(rate: float, draws: int) -> int:
    return max(draws, ceil(MIN_EXPECTED_DRAWS / rate)) if 0 < rate < 1 else draws


def _scale_p_value(change: Change, share: float) -> Change:
    return replace(change, p_value=min(change.p_value / share, 1.0))


def _is_lasting(change: Change, residual: History) -> bool:
    """Return whether at least two logs have the larger residual: more than halfway between the means of both sides."""
    value = residual.value @ change.group.directions[:, 0]
    first_log = change.index if change.shape is ChangeShape.STEP else change.index + 1
    before, after = value[:first_log], value[first_log:]
    halfway = 0.5 * (before.mean() + after.mean())
    return bool(((after if change.size[0] > 0 else before) > halfway).sum() >= MIN_RESIDUAL_LOGS)


def _is_explanation(change: Change, residual: Change, logs: Sequence[str], joints: set[str]) -> bool:
    """Return whether a change of the same joint, or of a payload or coupled motor, may have begun with a residual."""
    group = change.group
    # a payload or a coupled motor may raise the residual of any joint
    if group.kind is not GroupKind.PAYLOAD and group.joint in joints and group.joint != residual.group.joint:
        return False
    # the first and the last log that may be the first with some of a change; a drift is there a log later
    (change_start, change_end), (residual_start, residual_end) = (
        (logs.index(candidate.between[0]), logs.index(candidate.between[1]) + 1) for candidate in (change, residual)
    )
    return change_start <= residual_end and residual_start <= change_end
