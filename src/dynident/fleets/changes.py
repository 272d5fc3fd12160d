"""What has changed on a robot from log to log beyond the uncertainty, with a stated rate of false alarms.

A change moves the base parameters along the directions of one group, from one log on (a step) or more and more (a
drift). The generalised likelihood ratio of each, weighted by standard errors and scatter, becomes a tail probability;
the smallest of all is compared with the smallest in draws in which nothing changes. What is found is taken into account
before the next is sought (forward selection).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError, brief
from dynident.fleets.history import History
from dynident.fleets.ratios import Ratios
from dynident.fleets.scatter import FEW, Scatter, scatter_of
from dynident.regression import Group

__all__ = ["Change", "Changes", "Shape", "changes_of", "course", "design", "find_changes"]

Array = NDArray[np.float64]
DRAWS = 1000
FEWEST = 4  # degrees of freedom of the scatter, below which it is too uncertain
ROUNDS = 3  # of scatter and changes in turn
LIKELY = 3.84  # twice the log-likelihood that the true time of a change loses at most, at 95 %
MOST = 700.0  # of a logarithm that has an exponential
POOLED, MANY = 100, 2000  # logs, of others whose errors say how far logs differ by chance, with their tails; at most
LASTING = 3  # logs that show a change, at least, before the errors of a robot are taken without it
TIMES = 60  # of a change, at most, that are tried on one robot


class Shape(StrEnum):
    """How a change comes: at once, or evenly with time."""

    STEP = "step"
    DRIFT = "drift"


@dataclass(frozen=True, eq=False)
class Change:
    """A change of one robot: since which log and day, in which group, by how much, and how likely by chance.

    ``size`` (k) is by how much the last log differs from before the change in the directions of ``group``, in its
    units, with standard errors ``std`` (k), infinite where the logs do not show a direction; of a drift ``per_day`` (k)
    is the rate. ``index`` is the number of the log ``since``: the first after a step, the last before a drift;
    ``between`` are the first and the last log that it may be (as far as the likelihood tells, at 95 %). ``odds`` say
    how much likelier this shape is than the other, infinite where there is no other. ``p_value``: the share of robots
    without a change (of as many logs) that would show as much.
    """

    robot: str
    group: Group
    shape: Shape
    index: int
    since: str
    day: float
    size: Array
    std: Array
    per_day: Array | None
    between: tuple[str, str]
    odds: float
    p_value: float

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class Changes:
    """The changes of a fleet at a rate of false alarms (a share of robots in which nothing changes).

    ``p_values``: by robot, of the clearest change, found or not; ``silent``: robots of whom nothing can be said,
    because they have one log, or all have too few. ``scatter`` is that of the base parameters; ``residual_scatter``
    that of the logarithms of the residuals, None where these were not judged.
    """

    rate: float
    found: tuple[Change, ...]
    p_values: dict[str, float]
    silent: tuple[str, ...]
    scatter: Scatter
    residual_scatter: Scatter | None = None

    __repr__ = brief

    def of(self, robot: str) -> tuple[Change, ...]:
        """Return the changes of one robot, the clearest first."""
        return tuple(change for change in self.found if change.robot == robot)


def find_changes(
    histories: Sequence[History],
    groups: Sequence[Group],
    rng: np.random.Generator,
    *,
    rate: float = 0.01,
    draws: int = DRAWS,
) -> Changes:
    """Return what has changed on robots of one type, and how their parameters scatter.

    ``rate`` is the share of robots without any change of which one is reported; ``draws`` of ``rng`` calibrate it, for
    each robot. Scatter and changes are estimated in turn, because each hides the other. Raises ConfigError for a wrong
    rate or too few draws, InputError where the robots are not of one type.
    """
    if not 0 < rate < 1:
        raise ConfigError(f"rate of false alarms is {rate}; give a share of robots between 0 and 1, such as 0.01.")
    if draws < 2 / rate:
        raise ConfigError(f"{draws} draws do not tell a rate of false alarms of {rate}; give at least {2 / rate:.0f}.")
    seeds = rng.integers(2**63, size=len(histories))  # the same draws in each round
    scatter, found = scatter_of(histories, groups, rng), dict[str, tuple[Change, ...]]()
    chances, errors = dict[str, float](), _Errors(np.zeros((0, 0)), np.zeros(0, dtype=int))
    designs: list[Array] | None = None
    for _ in range(ROUNDS):
        before = _named(found)
        for k, (history, seed) in enumerate(zip(histories, seeds, strict=True)):
            if scatter.dof >= FEWEST and len(history.logs) > 1:
                draw, pool = np.random.default_rng(seed), errors.of_others(k)
                others = _of_others(k, histories, groups, draw, designs, scatter)
                some, chance = changes_of(history, groups, others, draw, rate=rate, draws=draws, pool=pool)
                found[history.robot], chances[history.robot] = some, chance
        if _named(found) == before:
            break
        changes = [found.get(history.robot, ()) for history in histories]
        designs = [design(*one) for one in zip(histories, changes, strict=True)]
        scatter = scatter_of(histories, groups, rng, designs, scatter)
        errors = _Errors.of(histories, changes, scatter, rng)
    silent = tuple(history.robot for history in histories if history.robot not in chances)
    return Changes(rate, tuple(change for some in found.values() for change in some), chances, silent, scatter)


def changes_of(
    history: History,
    groups: Sequence[Group],
    scatter: Scatter,
    rng: np.random.Generator,
    *,
    rate: float = 0.01,
    draws: int = DRAWS,
    pool: Array | None = None,
) -> tuple[tuple[Change, ...], float]:
    """Return the changes of one robot, the clearest first, and the p-value of the clearest, found or not.

    Where there is no change, logs differ as the standardised errors of a ``pool`` (L, b) of logs do, else normally.
    """
    shapes, courses = _courses(history.days)
    ratios = Ratios.of(history, groups, scatter.parts, courses, scatter.dof)
    taken, chances = list[tuple[int, int]](), list[float]()
    while True:
        best, chance = ratios.clearest(taken, rng, draws, pool)
        chances.append(chance)
        if best is None or chance > rate:
            break
        taken.append(best)
    taken = ratios.refined(taken) if len(taken) > 1 else taken
    sizes = ratios.fit(taken)
    return tuple(
        _change(history, groups[g], shapes, s, ratios.profile(taken, k), sizes[k], chances[k])
        for k, (g, s) in enumerate(taken)
    ), chances[0]


def course(days: Array, shape: Shape, index: int) -> Array:
    """Return how much of a change each log (K) has: of a step from log ``index`` on, of a drift after it."""
    if shape is Shape.STEP:
        return np.where(np.arange(len(days)) >= index, 1.0, 0.0)
    return np.asarray(np.maximum(days - days[index], 0.0) / (days[-1] - days[index]))


def design(history: History, changes: Sequence[Change]) -> Array:
    """Return (K, b, q): the base parameters of each log from those before all changes, and from the changes."""
    k, b = history.value.shape
    courses = [course(history.days, change.shape, change.index) for change in changes]
    parts = [one[:, None, None] * change.group.directions for one, change in zip(courses, changes, strict=True)]
    return np.concatenate([np.broadcast_to(np.eye(b), (k, b, b)), *parts], axis=2)


def _of_others(
    robot: int,
    histories: Sequence[History],
    groups: Sequence[Group],
    rng: np.random.Generator,
    designs: Sequence[Array] | None,
    scatter: Scatter,
) -> Scatter:
    """Return the scatter to judge a robot by: that of all, of few robots that of the others, where it can be told.

    One of few robots that changes would else hide in the scatter that it makes itself.
    """
    if not 1 < len(histories) < FEW:
        return scatter
    rest = [k for k in range(len(histories)) if k != robot]
    known = designs and [designs[k] for k in rest]
    some = scatter_of([histories[k] for k in rest], groups, rng, known)
    return some if some.dof >= FEWEST else scatter


@dataclass(frozen=True, eq=False)
class _Errors:
    """Standardised errors (L, b) of logs, and the number of the robot of each (L)."""

    errors: Array
    owner: NDArray[np.intp]

    __repr__ = brief

    @classmethod
    def of(
        cls,
        histories: Sequence[History],
        changes: Sequence[Sequence[Change]],
        scatter: Scatter,
        rng: np.random.Generator,
    ) -> _Errors:
        """Return those of at most 2000 logs of robots with several."""
        several = [k for k, history in enumerate(histories) if len(history.logs) > 1]
        errors = np.concatenate([_errors(histories[k], scatter, changes[k]) for k in several])
        owner = np.repeat(several, [len(histories[k].logs) for k in several])
        rows = rng.permutation(len(owner))[:MANY]
        return cls(errors[rows], owner[rows])

    def of_others(self, robot: int) -> Array | None:
        """Return those of other robots' logs; None where they are too few to draw from."""
        others = self.errors[self.owner != robot]
        return others if len(others) >= POOLED else None


def _errors(history: History, scatter: Scatter, found: Sequence[Change]) -> Array:
    """Return the standardised errors (K, b) of a robot's logs beside the changes that several logs show.

    What one or two logs show may be chance on this robot, which other robots may have as well.
    """
    k = len(history.logs)
    some = [one for one in found if k - one.index >= LASTING and (one.shape is Shape.DRIFT or one.index >= LASTING)]
    courses = np.array([course(history.days, one.shape, one.index) for one in some]).reshape(-1, k)
    ratios = Ratios.of(history, [one.group for one in some], scatter.parts, courses, scatter.dof)
    return ratios.left([(j, j) for j in range(len(some))])


def _courses(days: Array) -> tuple[list[tuple[Shape, int]], Array]:
    """Return the shapes and beginnings that are tried, and their courses (S, K); a drift has two logs after it."""
    k = len(days)
    steps = sorted({round(j) for j in np.linspace(1, k - 1, TIMES)}) if k > 1 else []
    drifts = [j - 1 for j in steps if len(np.unique(days[j - 1 :])) > 2]
    shapes = [*((Shape.STEP, j) for j in steps), *((Shape.DRIFT, j) for j in drifts)]
    return shapes, np.array([course(days, *one) for one in shapes]).reshape(-1, k)


def _change(
    history: History,
    group: Group,
    shapes: Sequence[tuple[Shape, int]],
    best: int,
    profile: Array,
    sizes: tuple[Array, Array],
    chance: float,
) -> Change:
    (shape, k), (size, std) = shapes[best], sizes
    alike = np.array([one is shape for one, _ in shapes])
    near = [shapes[int(i)][1] for i in np.flatnonzero(alike & (profile >= profile[best] - LIKELY))]
    other = profile[~alike].max(initial=-np.inf)
    return Change(
        robot=history.robot,
        group=group,
        shape=shape,
        index=k,
        since=history.logs[k],
        day=float(history.days[k]),
        size=size,
        std=std,
        per_day=size / (history.days[-1] - history.days[k]) if shape is Shape.DRIFT else None,
        between=(history.logs[min(near)], history.logs[max(near)]),
        odds=float(np.exp(min(0.5 * (profile[best] - other), MOST))) if np.isfinite(other) else np.inf,
        p_value=chance,
    )


def _named(found: dict[str, tuple[Change, ...]]) -> dict[str, list[tuple[int, Shape, int]]]:
    """Return what tells one set of changes from another."""
    return {robot: [(id(x.group), x.shape, x.index) for x in some] for robot, some in found.items() if some}
