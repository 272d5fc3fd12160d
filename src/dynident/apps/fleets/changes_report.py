"""What robots of one type share, in the report of their fleet: their mean, spread, and who differs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import datetime, timedelta
from functools import cached_property

import numpy as np

from dynident.apps.fleets.changes import Change, ChangeShape
from dynident.apps.fleets.components import History, Scatter
from dynident.apps.fleets.figures import Mark, ParameterTrend, pooled_figure
from dynident.apps.fleets.result import FleetBase, FleetResult, Population
from dynident.motion.splines import NORMAL_95
from dynident.regression import GroupKind, ParameterGroup
from dynident.report import Array
from dynident.report.page import UNIT, Column, Figure, Fold, Head, PageBlock, PageSection, PageTable
from dynident.report.words import signed_text
from dynident.runtime import count, join_names, number

VERBS = {
    (ChangeShape.STEP, 1): "rose",
    (ChangeShape.STEP, -1): "fell",
    (ChangeShape.STEP, 0): "changed",
    (ChangeShape.DRIFT, 1): "has been rising",
    (ChangeShape.DRIFT, -1): "has been falling",
    (ChangeShape.DRIFT, 0): "has been drifting",
}
RESIDUAL = (
    " No term of the recipe describes this: look at the residual in the report of that log; if it follows the "
    "position, add a `ripple` to `recipe.yaml`; else look at the sensor and for play."
)
MIN_SURE_RATIO, MAX_LISTED = 2.0, 3  # standard errors from which on a part of a change is named, and how many are
RATE_DAYS = 100.0  # days
MIN_CLEAR_ODDS = 3.0  # odds from which on one shape is clear
MAX_MISSING_SHARE = 1e-6  # what a log may lack of a direction that it shows
MAX_ZERO_EIGENVALUE = 1e-10  # relative eigenvalues of an information matrix that are zero

MAX_DRAWN_ROBOTS, MAX_DRAWN_PARAMETERS = 60, 80  # drawn
MAX_UNFOLDED_ROWS = 24  # of a table that is not folded
MAX_UNLIKE_WEIGHT = 0.9  # weight below which a robot is named as unlike the others
_LEAD = (
    "{robots} of one type: the mean, by how much single robots differ from it (spread, a standard deviation), and each "
    "robot's deviation. Changes do not count, each robot is as it was before them. A robot with few logs is near the "
    "mean: what its logs do not show, it has from the others."
)
_FIGURE = (
    "Deviation of each robot from the mean in spreads of the robots, red above and blue below; colours end at 3. Point "
    "at a field for its value with its 95 % interval."
)


def group_words(group: ParameterGroup) -> str:
    """Return what can change in words, such as "friction of elbow"."""
    return group.kind.words.format(group.joint)


def day_words(day: float, start: datetime | None) -> str:
    """Format a day as its date, where ``start`` is the date of day 0."""
    return f"day {number(day)}" if start is None else (start + timedelta(days=float(day))).strftime("%Y-%m-%d")


def shape_words(change: Change) -> str:
    """Return the shape of a change in words, as far as the logs determine it."""
    return change.shape.value if change.odds >= MIN_CLEAR_ODDS else " or ".join(ChangeShape)


def sort_by_severity(changes: Sequence[Change]) -> list[Change]:
    """Sort changes by p-value, equal ones by their largest size in standard errors."""
    return sorted(changes, key=lambda change: (change.p_value, -_size_ratios(change).max(initial=0.0)))


def clear_directions(change: Change) -> list[int]:
    """Return the directions in which a change is significant, the clearest first; at least one."""
    ratios = _size_ratios(change)
    order = np.argsort(-ratios, kind="stable")
    return [int(k) for k in order if ratios[k] >= MIN_SURE_RATIO] or [int(order[0])]


def _size_ratios(change: Change) -> Array:
    """Return the sizes (k) in standard errors, zero where the logs do not determine a direction."""
    is_shown = np.isfinite(change.std) & (change.std > 0)
    ratios: Array = np.divide(np.abs(change.size), change.std, out=np.zeros(len(change.size)), where=is_shown)
    return ratios


def change_words(change: Change, start: datetime | None, before: Array) -> str:
    """Return a change as a sentence; ``before`` (k) are the values of its group before, nan where unknown."""
    join = "on" if change.shape is ChangeShape.STEP else "since"
    verb = VERBS[change.shape, _change_sign(change, before)]
    event = f"{group_words(change.group)} {verb} {join} {day_words(change.day, start)}"
    unsure = "" if change.odds >= MIN_CLEAR_ODDS else " (at once or slowly: the logs do not tell)"
    todo = RESIDUAL if change.group.kind is GroupKind.RESIDUAL and change.size[0] > 0 else ""
    return f"{change.robot}: {event}{unsure}: {join_names(_size_words(change), MAX_LISTED)}.{todo}"


def _change_sign(change: Change, before: Array) -> int:
    """Return 1 where friction, ripple or residual rises, -1 where it falls, 0 where that cannot be said."""
    if change.group.kind in (GroupKind.FRICTION, GroupKind.RESIDUAL):
        signs = {int(np.sign(change.size[k])) for k in clear_directions(change)}
        return signs.pop() if len(signs) == 1 else 0
    if change.group.kind is GroupKind.RIPPLE and np.isfinite(before).all():  # its size, whatever its phase
        return int(np.sign(np.linalg.norm(before + change.size) - np.linalg.norm(before)))
    return 0


def _size_words(change: Change) -> Iterator[str]:
    if change.group.kind is GroupKind.RESIDUAL:
        # of a logarithm in percent, the standard error to first order
        factor = float(np.exp(change.size[0]))
        std = number(100 * factor * float(change.std[0]), 2)
        yield f"{change.group.names[0]} by {signed_text(100 * (factor - 1))} +- {std} %"
        return
    for k in clear_directions(change):
        size = f"{change.group.names[k]} by {signed_text(change.size[k])} +- {number(float(change.std[k]), 2)}"
        if change.per_day is None:
            yield f"{size} {change.group.units[k]}"
        else:
            rate = signed_text(RATE_DAYS * change.per_day[k])
            yield f"{size} {change.group.units[k]} ({rate} in {RATE_DAYS:.0f} days)"


def change_table(
    fleet: FleetResult, changes: Sequence[Change], max_rows: int, *, with_times: bool = False
) -> PageTable:
    """Return the table of the first ``max_rows`` changes; ``with_times`` also with the days between which each began,
    and the log of its begin."""
    days = {history.robot: dict(zip(history.logs, history.days, strict=True)) for history in fleet.histories}
    rows = []
    for change in changes[:max_rows]:
        what, began = group_words(change.group), day_words(change.day, fleet.start)
        sizes = "; ".join(list(_size_words(change))[:MAX_LISTED])
        row = (change.robot, what, began, shape_words(change), sizes, number(change.p_value, 2))
        ends = dict.fromkeys(day_words(days[change.robot][log], fleet.start) for log in change.between)
        rows.append((*row, " to ".join(ends), change.since) if with_times else row)
    suffix = f", the {max_rows} worst of {len(changes)}" if len(changes) > max_rows else ""
    heads: list[Head] = [Column("by", numeric=False, prose=True), "p-value"]
    heads += [Column("between", numeric=False), Column("log", numeric=False)] if with_times else []
    return PageTable.of(("robot", "what", "began", "how"), heads, rows, f"Changes, worst first{suffix}")


class RobotTrends:
    """The parameters of one robot over time, by group, with all else as in the mean of its logs.

    ``changes`` are those found in its history; ``scatter`` is that of its type, which intervals and means count;
    ``residual_trends`` are the trends of the torque that the model leaves.
    """

    def __init__(
        self,
        history: History,
        changes: Sequence[Change],
        scatter: Scatter | None,
        residual_trends: RobotTrends | None = None,
    ) -> None:
        self.history, self.changes, self.scatter, self.left = history, changes, scatter, residual_trends

    @property
    def all_changes(self) -> list[Change]:
        """All changes of this robot, the worst first."""
        return sort_by_severity([*self.changes, *(self.left.changes if self.left else ())])

    @cached_property
    def information(self) -> Array:
        """Information (K, b, b) of each log on the robot in general, which scatters from log to log."""
        information = self.history.information
        return information if self.scatter is None else np.array(list(map(self.scatter.with_scatter, information)))

    def group_trends(self, group: ParameterGroup) -> list[ParameterTrend]:
        """Return one trend for each direction of the group.

        A log says a = (D' I D)^-1 D' I (beta - mean - the other changes) of it. Friction, offset and ripple have
        their values, where a direction is one base parameter; all others the difference from the mean before the
        changes. A residual is drawn as a torque, of which its history has the logarithm.
        """
        if group.kind is GroupKind.RESIDUAL and self.left is not None:
            return [_exponential_trend(trend) for trend in self.left.history_trends(group)]
        return self.history_trends(group)

    def history_trends(self, group: ParameterGroup) -> list[ParameterTrend]:
        """Return the trends in the parameters of the history; those of a residual stay logarithms."""
        group_changes = [change for change in self.changes if _is_same_group(change.group, group)]
        other_changes = [change for change in self.changes if not _is_same_group(change.group, group)]
        # What the other changes did is taken out, so that only those of this group remain
        deviations = self.history.value - self.mean - _change_effect(other_changes, self.history.days, self.history)
        weighted = group.directions.T @ self.information
        value, std = _solve_information(weighted @ group.directions, (weighted @ deviations[..., None])[..., 0])
        zero = self.mean_values(group)
        line = self._change_line(group_changes, zero) if group_changes else None
        days = dict(zip(self.history.logs, self.history.days.tolist(), strict=True))
        ends = [(days[change.between[0]], days[change.between[1]]) for change in group_changes]
        marks = [Mark(change.day, shape_words(change), end) for change, end in zip(group_changes, ends, strict=True)]
        return [
            ParameterTrend(
                robot=self.history.robot, name=name if np.isfinite(zero[k]) else f"{name}, difference from the mean",
                unit=group.units[k], logs=self.history.logs, days=self.history.days,
                value=np.nan_to_num(zero[k]) + value[:, k], std=std[:, k],
                change_line=(line[0], line[1][:, k]) if line else None, marks=marks,
            )
            for k, name in enumerate(group.names)
        ]  # fmt: skip

    @cached_property
    def mean(self) -> Array:
        """The mean (b) of the logs by their information, without the changes found."""
        quiet = self.history.value - _change_effect(self.changes, self.history.days, self.history)
        # Weighted mean: solve sum(I_k) mean = sum(I_k beta_k), without the changes found
        right = np.einsum("kij,kj->i", self.information, quiet)
        mean: Array = _solve_information(self.information.sum(axis=0)[None], right[None])[0][0]
        return mean

    def mean_values(self, group: ParameterGroup) -> Array:
        """Return the value (k) of each direction in the mean, NaN for one that is no single base parameter."""
        if group.kind is GroupKind.RESIDUAL and self.left is not None:
            return self.left.mean_values(group)
        D = group.directions
        row = np.abs(D).argmax(axis=0)
        # A direction along one base parameter has a value of its own, but for a payload
        is_single = ((D != 0).sum(axis=0) == 1) & (group.kind is not GroupKind.PAYLOAD)
        size = D[row, np.arange(D.shape[1])]
        zero: Array = np.divide(self.mean[row], size, out=np.full(len(size), np.nan), where=is_single)
        return zero

    def _change_line(self, changes: Sequence[Change], zero: Array) -> tuple[Array, Array]:
        """Return the days (L) and values (L, k) of the changes of one group, with both ends of each step."""
        corners = np.unique([self.history.days[0], self.history.days[-1], *(change.day for change in changes)])
        # A step has two values on its day: just before and just after it
        ends = [
            sum(_change_share(change, corners, self.history, after) * change.size for change in changes)
            for after in (False, True)
        ]
        return np.repeat(corners, 2), np.nan_to_num(zero) + np.stack(ends, axis=1).reshape(-1, len(zero))


def _exponential_trend(trend: ParameterTrend) -> ParameterTrend:
    """Return the trend of exponentials for one of logarithms."""
    value = np.exp(trend.value)
    line = trend.change_line and (trend.change_line[0], np.exp(trend.change_line[1]))
    return replace(trend, value=value, std=value * trend.std, change_line=line)


def _is_same_group(group: ParameterGroup, other_group: ParameterGroup) -> bool:
    return (group.kind, group.joint) == (other_group.kind, other_group.joint)


def _change_share(change: Change, days: Array, history: History, after: bool = True) -> Array:
    """Return the share of a change that is present on days (L, 1), just ``after`` a step or just before it."""
    if change.shape is ChangeShape.STEP:
        return np.where(days >= change.day if after else days > change.day, 1.0, 0.0)[:, None]
    return np.asarray(np.clip((days - change.day) / (history.days[-1] - change.day), 0.0, 1.0))[:, None]


def _change_effect(changes: Sequence[Change], days: Array, history: History) -> Array:
    """Return the effect of changes on the base parameters (K, b), as far as the logs determine it."""
    effect = np.zeros((len(days), history.value.shape[1]))
    for change in changes:
        size = np.where(np.isfinite(change.std), change.size, 0.0)
        effect += _change_share(change, days, history) * (change.group.directions @ size)
    return effect


def _solve_information(matrix: Array, right: Array) -> tuple[Array, Array]:
    """Return x (K, k) of A x = right for information matrices A (K, k, k), with standard errors, infinite if free."""
    # Scale the parameters alike before the pseudo-inverse cuts off small eigenvalues
    scale = np.sqrt(np.diagonal(matrix, axis1=1, axis2=2).max(axis=0))
    scale = np.where(scale > 0, scale, 1.0)
    normalised: Array = matrix / np.outer(scale, scale)
    inverse = np.linalg.pinv(normalised, MAX_ZERO_EIGENVALUE, hermitian=True)
    # Where a direction is determined, inverse times matrix is the identity
    is_determined = np.diagonal(inverse @ normalised, axis1=1, axis2=2) > 1 - MAX_MISSING_SHARE
    std = np.sqrt(np.maximum(np.diagonal(inverse, axis1=1, axis2=2), 0.0)) / scale
    return (inverse @ (right / scale)[..., None])[..., 0] / scale, np.where(is_determined, std, np.inf)


def pooled_sections(fleet: FleetResult) -> Iterator[PageSection]:
    """Yield a section for each type of robots that were compared."""
    for kind, pooled in fleet.pooled.items():
        yield PageSection(f"Robots of type {kind}", tuple(_pooled_blocks(pooled, fleet.base)))


def _pooled_blocks(pooled: Population, base: FleetBase) -> Iterator[PageBlock]:
    yield _LEAD.format(robots=count(len(pooled.robots), "robot"))
    if unlike := [pooled.robots[k].robot for k in np.flatnonzero(pooled.weights < MAX_UNLIKE_WEIGHT)]:
        yield f"Unlike the others, and counted less for the mean: {join_names(unlike)}."
    size = np.sqrt(np.maximum(np.diag(pooled.spread), 0.0))
    deviation = np.array([robot.value - pooled.mean for robot in pooled.robots])
    # Deviations in spreads of the robots; a parameter without spread counts as equal
    relative = np.divide(deviation, size, out=np.zeros_like(deviation), where=size > 0)
    yield _pooled_figure(pooled, base, deviation, relative)
    table = _pooled_table(pooled, base, size, relative)
    yield table if len(table.rows) <= MAX_UNFOLDED_ROWS else Fold(table.caption, (table,))


def _pooled_figure(pooled: Population, base: FleetBase, deviation: Array, relative: Array) -> Figure:
    """Return the figure of the robots and parameters that differ most."""
    # The robots that differ most, then the parameters in which they do, in the order of the model
    robots = np.argsort(-np.abs(relative).max(axis=1), kind="stable")[:MAX_DRAWN_ROBOTS]
    parameters = np.sort(np.argsort(-np.abs(relative[robots]).max(axis=0), kind="stable")[:MAX_DRAWN_PARAMETERS])
    words = [
        [
            f"{pooled.robots[r].robot}, {base.names[i]}: {number(deviation[r, i], 3)} ± "
            f"{number(NORMAL_95 * pooled.robots[r].std[i], 2)} {base.units[i]} from {number(pooled.mean[i])}"
            for i in parameters
        ]
        for r in robots
    ]
    names, robot_names = [base.names[i] for i in parameters], [pooled.robots[r].robot for r in robots]
    drawing = pooled_figure(names, robot_names, relative[np.ix_(robots, parameters)], words)
    omitted = relative.shape[0] - len(robots), relative.shape[1] - len(parameters)
    suffix = f" Not drawn, as they differ least: {count(omitted[0], 'robot')}, {count(omitted[1], 'parameter')}."
    return Figure(drawing, _FIGURE + (suffix if any(omitted) else ""))


def _pooled_table(pooled: Population, base: FleetBase, size: Array, relative: Array) -> PageTable:
    std = np.sqrt(np.maximum(np.diag(pooled.covariance), 0.0))
    farthest = np.abs(relative).argmax(axis=0)
    heads = (UNIT, "mean", "std. error", "spread", "spread, %", Column("farthest", numeric=False), "spreads away")
    rows = []
    for i, (name, unit) in enumerate(zip(base.names, base.units, strict=True)):
        share = number(100 * size[i] / abs(pooled.mean[i]), 2) if pooled.mean[i] else "-"
        farthest_cells = pooled.robots[farthest[i]].robot, number(relative[farthest[i], i], 2)
        rows.append((name, unit, number(pooled.mean[i]), number(std[i], 2), number(size[i], 2), share, *farthest_cells))
    return PageTable.of(("parameter",), heads, rows, "Mean and spread of the base parameters")
