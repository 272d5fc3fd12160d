"""What robots of one type share, in the report of their fleet: the mean, their spread, and who differs from it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from dynident.errors import listed
from dynident.report import figures
from dynident.report.figures import Array
from dynident.report.page import UNIT, Column, Figure, Fold, PageBlock, PageSection, PageTable, number
from dynident.report.words import count
from dynident.splines import NORMAL_95

if TYPE_CHECKING:
    from dynident.fleets import FleetBase, FleetResult, Pooled

__all__ = ["pooled_sections"]

ROBOTS, PARAMETERS = 60, 80  # drawn
ROWS = 24  # of a table that is not folded
UNLIKE = 0.9  # weight below which a robot is named as unlike the others
_LEAD = (
    "{robots} of one type: the mean, by how much single robots differ from it (spread, a standard deviation), and each "
    "robot's deviation. Changes do not count, each robot is as it was before them. A robot with few logs is near the "
    "mean: what its logs do not show, it has from the others."
)
_FIGURE = (
    "Deviation of each robot from the mean in spreads of the robots, red above and blue below; colours end at 3. Point "
    "at a field for its value with its 95 % interval."
)


def pooled_sections(found: FleetResult) -> Iterator[PageSection]:
    """Yield a section for each type of robots that were compared."""
    for kind, one in found.pooled.items():
        yield PageSection(f"Robots of type {kind}", tuple(_blocks(one, found.base)))


def _blocks(one: Pooled, base: FleetBase) -> Iterator[PageBlock]:
    yield _LEAD.format(robots=count(len(one.robots), "robot"))
    unlike = [robot.robot for robot, weight in zip(one.robots, one.weights, strict=True) if weight < UNLIKE]
    if unlike:
        yield f"Unlike the others, and counted less for the mean: {listed(unlike)}."
    size = np.sqrt(np.maximum(np.diag(one.spread), 0.0))
    deviation = np.array([robot.value - one.mean for robot in one.robots])
    relative = np.divide(deviation, size, out=np.zeros_like(deviation), where=size > 0)
    yield _figure(one, base, deviation, relative)
    table = _table(one, base, size, relative)
    yield table if len(table.rows) <= ROWS else Fold(table.caption, (table,))


def _figure(one: Pooled, base: FleetBase, deviation: Array, relative: Array) -> Figure:
    """Return the figure of the robots and parameters that differ most."""
    robots = np.argsort(-np.abs(relative).max(axis=1), kind="stable")[:ROBOTS]
    parameters = np.sort(np.argsort(-np.abs(relative[robots]).max(axis=0), kind="stable")[:PARAMETERS])
    words = [
        [
            f"{one.robots[r].robot}, {base.names[i]}: {number(deviation[r, i], 3)} ± "
            f"{number(NORMAL_95 * one.robots[r].std[i], 2)} {base.units[i]} from {number(one.mean[i])}"
            for i in parameters
        ]
        for r in robots
    ]
    names = [base.names[i] for i in parameters]
    drawn = figures.pooled_figure(
        names, [one.robots[r].robot for r in robots], relative[np.ix_(robots, parameters)], words
    )
    left = relative.shape[0] - len(robots), relative.shape[1] - len(parameters)
    more = f" Not drawn, as they differ least: {count(left[0], 'robot')}, {count(left[1], 'parameter')}."
    return Figure(drawn, _FIGURE + (more if any(left) else ""))


def _table(one: Pooled, base: FleetBase, size: Array, relative: Array) -> PageTable:
    std = np.sqrt(np.maximum(np.diag(one.covariance), 0.0))
    farthest = np.abs(relative).argmax(axis=0)
    heads = [Column("parameter", numeric=False), UNIT, Column("mean"), Column("std. error")]
    heads += [Column("spread"), Column("spread, %"), Column("farthest", numeric=False), Column("spreads away")]
    rows = []
    for i, (name, unit) in enumerate(zip(base.names, base.units, strict=True)):
        share = number(100 * size[i] / abs(one.mean[i]), 2) if one.mean[i] else "-"
        far = one.robots[farthest[i]].robot, number(relative[farthest[i], i], 2)
        rows.append((name, unit, number(one.mean[i]), number(std[i], 2), number(size[i], 2), share, *far))
    return PageTable(tuple(heads), tuple(rows), "Mean and spread of the base parameters")
