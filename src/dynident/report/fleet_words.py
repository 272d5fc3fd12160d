"""What a fleet's report says of a change: what changed on which robot, since when, and by how much."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import datetime, timedelta
from typing import TYPE_CHECKING

import numpy as np

from dynident.errors import listed
from dynident.fleets import Shape
from dynident.regression import Group, GroupKind
from dynident.report.figures import Array
from dynident.report.group_words import kind_words, signed
from dynident.report.page import Column, PageTable, number

if TYPE_CHECKING:
    from dynident.fleets import Change, FleetResult

__all__ = [
    "change_table",
    "change_words",
    "changed_in",
    "day_words",
    "group_words",
    "shape_words",
    "with_times",
    "worst_first",
]

VERBS = {
    (Shape.STEP, 1): "rose",
    (Shape.STEP, -1): "fell",
    (Shape.STEP, 0): "changed",
    (Shape.DRIFT, 1): "has been rising",
    (Shape.DRIFT, -1): "has been falling",
    (Shape.DRIFT, 0): "has been drifting",
}
RESIDUAL = (
    " No term of the recipe describes this: look at the residual in the report of that log; if it follows the "
    "position, add a `ripple` to `recipe.yaml`; else look at the sensor and for play."
)
SURE, FEW = 2.0, 3  # standard errors from which on a part of a change is named, and how many are
RATE = 100.0  # days
CLEAR = 3.0  # odds from which on one shape is clear


def group_words(group: Group) -> str:
    """Word what can change, such as "friction of elbow"."""
    return kind_words(group.kind, group.joint)


def day_words(day: float, start: datetime | None) -> str:
    """Word a day as its date, where ``start`` is that of day 0."""
    return f"day {number(day)}" if start is None else (start + timedelta(days=float(day))).strftime("%Y-%m-%d")


def shape_words(change: Change) -> str:
    """Word the shape of a change, as far as the logs tell it."""
    return change.shape.value if change.odds >= CLEAR else " or ".join(Shape)


def worst_first(changes: Sequence[Change]) -> list[Change]:
    """Return the changes, the least probable by chance first, of equal ones the largest in standard errors."""
    return sorted(changes, key=lambda one: (one.p_value, -_ratios(one).max(initial=0.0)))


def changed_in(change: Change) -> list[int]:
    """Return the directions that a change is certain of, the clearest first; at least one."""
    ratios = _ratios(change)
    order = np.argsort(-ratios, kind="stable")
    return [int(k) for k in order if ratios[k] >= SURE] or [int(order[0])]


def _ratios(change: Change) -> Array:
    """Return the sizes (k) in standard errors, zero where the logs do not show a direction."""
    seen = np.isfinite(change.std) & (change.std > 0)
    ratios: Array = np.divide(np.abs(change.size), change.std, out=np.zeros(len(change.size)), where=seen)
    return ratios


def change_words(change: Change, start: datetime | None, before: Array) -> str:
    """Return a change as a sentence; ``before`` (k) are the values of its group before, nan where unknown."""
    join = "on" if change.shape is Shape.STEP else "since"
    verb = VERBS[change.shape, _sign(change, before)]
    what = f"{group_words(change.group)} {verb} {join} {day_words(change.day, start)}"
    unsure = "" if change.odds >= CLEAR else " (at once or slowly: the logs do not tell)"
    todo = RESIDUAL if change.group.kind is GroupKind.RESIDUAL and change.size[0] > 0 else ""
    return f"{change.robot}: {what}{unsure}: {listed(_sizes(change), FEW)}.{todo}"


def _sign(change: Change, before: Array) -> int:
    """Return 1 where friction, ripple or residual rises, -1 where it falls, 0 where that cannot be said."""
    if change.group.kind in (GroupKind.FRICTION, GroupKind.RESIDUAL):
        signs = {int(np.sign(change.size[k])) for k in changed_in(change)}
        return signs.pop() if len(signs) == 1 else 0
    if change.group.kind is GroupKind.RIPPLE and np.isfinite(before).all():  # its size, whatever its phase
        return int(np.sign(np.linalg.norm(before + change.size) - np.linalg.norm(before)))
    return 0


def _sizes(change: Change) -> Iterator[str]:
    if change.group.kind is GroupKind.RESIDUAL:
        yield _relative(change)
        return
    for k in changed_in(change):
        size = f"{change.group.names[k]} by {signed(change.size[k])} +- {number(float(change.std[k]), 2)}"
        rate = f" ({signed(RATE * change.per_day[k])} in {RATE:.0f} days)" if change.per_day is not None else ""
        yield f"{size} {change.group.units[k]}{rate}"


def _relative(change: Change) -> str:
    """Return the size of a logarithm in percent; the standard error to first order."""
    factor = float(np.exp(change.size[0]))
    std = number(100 * factor * float(change.std[0]), 2)
    return f"{change.group.names[0]} by {signed(100 * (factor - 1))} +- {std} %"


def change_table(found: FleetResult, changes: Sequence[Change], most: int) -> PageTable:
    """Return the table of the first ``most`` changes."""
    titles = ("robot", "what", "began", "how")
    heads = [Column(title, numeric=False) for title in titles]
    heads += [Column("by", numeric=False, prose=True), Column("p-value")]
    rows = tuple(
        (
            one.robot,
            group_words(one.group),
            day_words(one.day, found.start),
            shape_words(one),
            "; ".join(list(_sizes(one))[:FEW]),
            number(one.p_value, 2),
        )
        for one in changes[:most]
    )
    more = f", the {most} worst of {len(changes)}" if len(changes) > most else ""
    return PageTable(tuple(heads), rows, f"Changes, worst first{more}")


def with_times(table: PageTable, found: FleetResult, changes: Sequence[Change]) -> PageTable:
    """Return the table of the changes with the days between which each began, and the log."""
    days = {history.robot: dict(zip(history.logs, history.days, strict=True)) for history in found.histories}
    rows = []
    for row, one in zip(table.rows, changes, strict=False):
        ends = dict.fromkeys(day_words(days[one.robot][log], found.start) for log in one.between)
        rows.append((*row, " to ".join(ends), one.since))
    heads = (*table.columns, Column("between", numeric=False), Column("log", numeric=False))
    return PageTable(heads, tuple(rows), table.caption)
