"""What has changed on a robot from log to log beyond the uncertainty, with a stated rate of false alarms.

A change moves the base parameters along the directions of one group, from one log on (a step) or more and more (a
drift). The generalised likelihood ratio of each, weighted by standard errors and scatter, becomes a tail probability;
the smallest of all is compared with the smallest in draws in which nothing changes. What is found is taken into account
before the next is sought (forward selection).
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from dynident.apps.fleets.components import FEW_ROBOTS, History, Scatter, scatter_of
from dynident.apps.fleets.ratios import LikelihoodRatios, NullDraws
from dynident.regression import ParameterGroup
from dynident.runtime import Noun
from dynident.runtime.arrays import Array

DRAWS = 1000
MIN_SCATTER_DOF = 4  # degrees of freedom of the scatter, below which it is too uncertain
MAX_ROUNDS = 3  # of scatter and changes in turn
MAX_LIKELIHOOD_LOSS = 3.84  # twice the log-likelihood that the true time of a change loses at most, at 95 %
MAX_EXPONENT = 700.0  # of a logarithm that has an exponential
# logs, of others whose errors say how far logs differ by chance, with their tails; at most
MIN_POOL_LOGS, MAX_POOL_LOGS = 100, 2000
MIN_LASTING_LOGS = 3  # logs that show a change, at least, before the errors of a robot are taken without it
MAX_START_TIMES = 60  # of a change, at most, that are tried on one robot


class ChangeShape(StrEnum):
    """How a change comes: at once, or evenly with time."""

    STEP = "step"
    DRIFT = "drift"


class Change(Noun):
    """A change of one robot: since which log and day, in which group, by how much, and how likely by chance.

    ``size`` (k) is by how much the last log differs from before the change in the directions of ``group``, in its
    units, with standard errors ``std`` (k), infinite where the logs do not show a direction; of a drift ``per_day`` (k)
    is the rate. ``index`` is the number of the log ``since``: the first after a step, the last before a drift;
    ``between`` are the first and the last log that it may be (as far as the likelihood tells, at 95 %). ``odds`` say
    how much likelier this shape is than the other, infinite where there is no other. ``p_value``: the share of robots
    without a change (of as many logs) that would show as much.
    """

    robot: str
    group: ParameterGroup
    shape: ChangeShape
    index: int
    since: str
    day: float
    size: Array
    std: Array
    per_day: Array | None
    between: tuple[str, str]
    odds: float
    p_value: float


class Changes(Noun):
    """The changes of a fleet at a rate of false alarms (a share of robots in which nothing changes).

    ``p_values``: by robot, of the clearest change, found or not; ``silent``: robots of whom nothing can be said,
    because they have one log, or all have too few. ``scatter`` is that of the base parameters; ``residual_scatter``
    that of the logarithms of the residuals, None where these were not judged.
    """

    rate: float
    changes: tuple[Change, ...]
    p_values: dict[str, float]
    silent: tuple[str, ...]
    scatter: Scatter
    residual_scatter: Scatter | None = None

    def of(self, robot: str) -> tuple[Change, ...]:
        """Return the changes of one robot, the clearest first."""
        return tuple(change for change in self.changes if change.robot == robot)


def find_changes(
    histories: Sequence[History],
    groups: Sequence[ParameterGroup],
    rng: np.random.Generator,
    *,
    rate: float = 0.01,
    draws: int = DRAWS,
) -> Changes:
    """Return what has changed on robots of one type, and how their parameters scatter.

    ``rate`` is the share of robots without any change of which one is reported; ``draws`` of ``rng`` calibrate it, for
    each robot. Scatter and changes are estimated in turn, because each hides the other. Raises InputError where the
    robots are not of one type.
    """
    seeds = rng.integers(2**63, size=len(histories))  # the same draws in each round
    scatter, changes_by_robot = scatter_of(histories, groups, rng), dict[str, tuple[Change, ...]]()
    p_values, errors = dict[str, float](), _LogErrors(np.zeros((0, 0)), np.zeros(0, dtype=int))
    designs: list[Array] | None = None
    # the scatter hides changes, and changes inflate the scatter: estimate both in turn until the changes stay the same
    for _ in range(MAX_ROUNDS):
        previous_keys = _change_keys(changes_by_robot)
        for k, (history, seed) in enumerate(zip(histories, seeds, strict=True)):
            if scatter.dof >= MIN_SCATTER_DOF and len(history.logs) > 1:
                # each robot has its seed, so that rounds do not differ by chance alone
                draw, pool = np.random.default_rng(seed), errors.of_others(k)
                # of few robots, one that changes would else hide in the scatter that it makes itself
                is_few = 1 < len(histories) < FEW_ROBOTS
                other_scatter = _scatter_of_others(k, histories, groups, draw, designs) if is_few else None
                changes_by_robot[history.robot], p_values[history.robot] = changes_of(
                    history, groups, other_scatter or scatter, NullDraws(draw, draws, pool), rate
                )
        if _change_keys(changes_by_robot) == previous_keys:
            break
        # the next scatter is that about the changes found, and so are the errors to draw from
        changes = [changes_by_robot.get(history.robot, ()) for history in histories]
        designs = [design(*pair) for pair in zip(histories, changes, strict=True)]
        scatter = scatter_of(histories, groups, rng, designs, scatter)
        errors = _LogErrors.of(histories, changes, scatter, rng)
    silent = tuple(history.robot for history in histories if history.robot not in p_values)
    return Changes(rate, tuple(chain(*changes_by_robot.values())), p_values, silent, scatter)


def changes_of(
    history: History,
    groups: Sequence[ParameterGroup],
    scatter: Scatter,
    draws: NullDraws,
    rate: float,
) -> tuple[tuple[Change, ...], float]:
    """Return the changes of one robot, the clearest first, and the p-value of the clearest, found or not."""
    shapes, courses = _candidate_courses(history.days)
    ratios = LikelihoodRatios.of(history, groups, scatter, courses)
    selected, p_values = list[tuple[int, int]](), list[float]()
    # forward selection: each change is taken into account before the next is sought
    while True:
        best, p_value = ratios.clearest_change(selected, draws)
        p_values.append(p_value)
        if best is None or p_value > rate:
            break
        selected.append(best)
    # the course of an early pick may fit less well beside the later ones
    selected = ratios.refine(selected) if len(selected) > 1 else selected
    sizes = ratios.fit(selected)
    changes = []
    for k, (g, s) in enumerate(selected):
        (shape, index), (size, std) = shapes[s], sizes[k]
        between, odds = _start_range(history, shapes, s, ratios.profile(selected, k))
        days_after = history.days[-1] - history.days[index]
        changes.append(Change(
            robot=history.robot, group=groups[g], shape=shape, index=index, since=history.logs[index],
            day=float(history.days[index]), size=size, std=std,
            per_day=size / days_after if shape is ChangeShape.DRIFT else None,
            between=between, odds=odds, p_value=p_values[k],
        ))  # fmt: skip
    return tuple(changes), p_values[0]


def course(days: Array, shape: ChangeShape, index: int) -> Array:
    """Return how much of a change each log (K) has: of a step from log ``index`` on, of a drift after it."""
    if shape is ChangeShape.STEP:
        return np.where(np.arange(len(days)) >= index, 1.0, 0.0)
    return np.asarray(np.maximum(days - days[index], 0.0) / (days[-1] - days[index]))


def design(history: History, changes: Sequence[Change]) -> Array:
    """Return (K, b, q): the base parameters of each log from those before all changes, and from the changes."""
    k, b = history.value.shape
    courses = [course(history.days, change.shape, change.index) for change in changes]
    parts = [share[:, None, None] * change.group.directions for share, change in zip(courses, changes, strict=True)]
    return np.concatenate([np.broadcast_to(np.eye(b), (k, b, b)), *parts], axis=2)


def _scatter_of_others(
    robot: int,
    histories: Sequence[History],
    groups: Sequence[ParameterGroup],
    rng: np.random.Generator,
    designs: Sequence[Array] | None,
) -> Scatter | None:
    """Return the scatter of the robots but one; None where they do not tell it."""
    others = [k for k in range(len(histories)) if k != robot]
    scatter = scatter_of([histories[k] for k in others], groups, rng, designs and [designs[k] for k in others])
    return scatter if scatter.dof >= MIN_SCATTER_DOF else None


class _LogErrors(Noun):
    """Standardised errors (L, b) of logs, and the number of the robot of each (L)."""

    errors: Array
    owner: NDArray[np.intp]

    @classmethod
    def of(
        cls,
        histories: Sequence[History],
        changes: Sequence[Sequence[Change]],
        scatter: Scatter,
        rng: np.random.Generator,
    ) -> _LogErrors:
        """Return those of at most 2000 logs of robots with several."""
        several = [k for k, history in enumerate(histories) if len(history.logs) > 1]
        errors = np.concatenate([_standardised_errors(histories[k], scatter, changes[k]) for k in several])
        owner = np.repeat(several, [len(histories[k].logs) for k in several])
        # a random sample keeps the cost of drawing bounded
        rows = rng.permutation(len(owner))[:MAX_POOL_LOGS]
        return cls(errors[rows], owner[rows])

    def of_others(self, robot: int) -> Array | None:
        """Return those of other robots' logs; None where they are too few to draw from."""
        other_errors = self.errors[self.owner != robot]
        return other_errors if len(other_errors) >= MIN_POOL_LOGS else None


def _standardised_errors(history: History, scatter: Scatter, changes: Sequence[Change]) -> Array:
    """Return the standardised errors (K, b) of a robot's logs beside the changes that several logs show.

    What one or two logs show may be chance on this robot, which other robots may have as well.
    """
    k = len(history.logs)
    # a step must have several logs on both sides, a drift several after its start
    lasting = [
        x for x in changes if k - MIN_LASTING_LOGS >= x.index >= MIN_LASTING_LOGS * (x.shape is ChangeShape.STEP)
    ]
    courses = np.array([course(history.days, change.shape, change.index) for change in lasting]).reshape(-1, k)
    groups = [change.group for change in lasting]
    ratios = LikelihoodRatios.of(history, groups, scatter, courses)
    return ratios.standardised_errors([(j, j) for j in range(len(lasting))])


def _candidate_courses(days: Array) -> tuple[list[tuple[ChangeShape, int]], Array]:
    """Return the shapes and beginnings that are tried, and their courses (S, K); a drift has two logs after it."""
    k = len(days)
    # starts are spread evenly where there are more than can be tried
    steps = sorted({round(j) for j in np.linspace(1, k - 1, MAX_START_TIMES)}) if k > 1 else []
    drifts = [j - 1 for j in steps if len(np.unique(days[j - 1 :])) > 2]
    shapes = [*((ChangeShape.STEP, j) for j in steps), *((ChangeShape.DRIFT, j) for j in drifts)]
    return shapes, np.array([course(days, *candidate) for candidate in shapes]).reshape(-1, k)


def _start_range(
    history: History, shapes: Sequence[tuple[ChangeShape, int]], best: int, profile: Array
) -> tuple[tuple[str, str], float]:
    """Return the logs between which a change begins, and the odds of its shape against the other one."""
    has_same_shape = np.array([candidate_shape is shapes[best][0] for candidate_shape, _ in shapes])
    # starts whose likelihood is within its 95 % interval, and the best of the other shape
    is_likely = has_same_shape & (profile >= profile[best] - MAX_LIKELIHOOD_LOSS)
    likely_starts = [shapes[int(i)][1] for i in np.flatnonzero(is_likely)]
    other_profile = profile[~has_same_shape].max(initial=-np.inf)
    odds = np.exp(min(0.5 * (profile[best] - other_profile), MAX_EXPONENT)) if np.isfinite(other_profile) else np.inf
    return (history.logs[min(likely_starts)], history.logs[max(likely_starts)]), float(odds)


def _change_keys(changes_by_robot: dict[str, tuple[Change, ...]]) -> dict[str, list[tuple[int, ChangeShape, int]]]:
    """Return what identifies the changes of each robot, to compare one round with the next."""
    return {
        robot: [(id(x.group), x.shape, x.index) for x in robot_changes]
        for robot, robot_changes in changes_by_robot.items()
        if robot_changes
    }
