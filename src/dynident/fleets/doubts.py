"""What speaks against the logs of a fleet themselves: the same recording twice, an arm at rest, everything of a robot
that changes at once, all robots that change together."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dynident.errors import listed
from dynident.fleets.changes import FEWEST, Change, Changes, Shape
from dynident.fleets.history import History
from dynident.fleets.scatter import Scatter
from dynident.jobs import Status
from dynident.regression import Group

if TYPE_CHECKING:
    import polars as pl

    from dynident.fleets.result import FleetResult

__all__ = ["common_groups", "doubts"]

Array = NDArray[np.float64]
MANY = 3  # groups of a robot that change with one log, before the log is doubted
ROBOTS, LOGS, BINS = 3, 4000, 60  # at least, at most, and at most, to look for what robots have in common
DRAWS = 199
SHOWN = 3
WORSE = 3.0  # times the median error of a type, from which on logs are named
ROUNDING = 1e-9


def doubts(found: FleetResult, rng: np.random.Generator) -> Iterator[str]:
    """Yield warnings about logs that may not be what they are taken for; ``rng`` draws permutations of them."""
    yield from _twice(found.histories)
    yield from _at_rest(found.histories)
    yield from _unlike(found.rows)
    for kind, one in zip(_kinds(found), found.changes, strict=True):
        yield from _all_at_once(one, len(found.groups))
        own = [history for history in found.histories if history.robot in found.types[kind]]
        if together := common_groups(own, found.groups, one.scatter, rng):
            words = listed([_name(group) for group in together], SHOWN)
            yield (
                f"most of what differs from log to log is the same on all robots of type {kind} at a time: {words}. "
                "The temperature, the motion, a recalibration? What all robots have at once is not among the changes."
            )


def common_groups(
    histories: Sequence[History], groups: Sequence[Group], scatter: Scatter, rng: np.random.Generator
) -> tuple[Group, ...]:
    """Return the groups in which robots move together: more than half of the scatter is that of times, not of robots.

    Logs of all robots are put into bins of time; the share of a bin's mean in the sum of squares is compared with the
    largest of all directions after the logs of each robot were permuted, which robots that differ independently allow.
    """
    several = [one for one in histories if len(one.logs) > 1]
    if len(several) < ROBOTS or not groups or scatter.dof < FEWEST:
        return ()
    chosen = [several[k] for k in rng.permutation(len(several))]
    keep = np.cumsum([len(one.logs) for one in chosen]) <= max(LOGS, len(chosen[0].logs))
    chosen = [one for one, yes in zip(chosen, keep, strict=True) if yes]
    errors = np.concatenate([_errors(one, groups, scatter) for one in chosen])
    days = np.concatenate([one.days for one in chosen])
    robots = np.repeat(np.arange(len(chosen)), [len(one.logs) for one in chosen])
    edges = np.unique(np.quantile(days, np.linspace(0, 1, min(len(days) // len(chosen), BINS) + 1))[1:-1])
    bins = np.searchsorted(edges, days, side="right")
    share = _share(errors, bins)
    chance = [_share(errors[np.lexsort((rng.random(len(days)), robots))], bins).max() for _ in range(DRAWS)]
    moves = (share > 0.5) & (share > max(chance))
    ends = np.cumsum([group.directions.shape[1] for group in groups])
    return tuple(group for group, own in zip(groups, np.split(moves, ends[:-1]), strict=True) if own.any())


def _errors(history: History, groups: Sequence[Group], scatter: Scatter) -> Array:
    """Return by log what the robot differs from its mean (K, d) along directions, each group's fitted by itself, in
    standard deviations."""
    weights = np.array([scatter.with_scatter(one) for one in history.information])
    mean = np.linalg.lstsq(weights.sum(axis=0), np.einsum("kij,kj->i", weights, history.value), rcond=None)[0]
    scores = np.einsum("kij,kj->ki", weights, history.value - mean)
    return np.concatenate([_moved(scores @ one.directions, weights, one.directions) for one in groups], axis=1)


def _moved(scores: Array, weights: Array, directions: Array) -> Array:
    """Return the sizes (K, d) that fit the scores (K, d) of directions, in standard deviations; zero where hidden."""
    information = np.einsum("id,kij,je->kde", directions, weights, directions)
    size = np.sqrt(np.maximum(np.einsum("kdd->kd", information), 0.0))
    scale = np.divide(1.0, size, out=np.zeros_like(size), where=size > ROUNDING * size.max(initial=0.0))
    inverse = np.linalg.pinv(information * scale[:, :, None] * scale[:, None, :], rcond=ROUNDING, hermitian=True)
    std = np.sqrt(np.maximum(np.einsum("kdd->kd", inverse), 0.0))
    moved = np.einsum("kde,ke->kd", inverse, scale * scores)
    found: Array = np.divide(moved, std, out=np.zeros_like(moved), where=std > ROUNDING)
    return found


def _share(errors: Array, bins: NDArray[np.intp]) -> Array:
    """Return the share (d) of the means of bins in the sum of squares of errors (N, d)."""
    order = np.argsort(bins, kind="stable")
    starts = np.flatnonzero(np.diff(bins[order], prepend=-1))
    sums = np.add.reduceat(errors[order], starts)
    counts = np.diff(starts, append=len(order))
    whole = (errors**2).sum(axis=0)
    found: Array = np.divide((sums**2 / counts[:, None]).sum(axis=0), whole, out=np.zeros_like(whole), where=whole > 0)
    return found


def _twice(histories: Sequence[History]) -> Iterator[str]:
    """Yield a warning where several logs have the same estimates to the bit, as only the same recording has."""
    of: dict[bytes, list[str]] = {}
    for history in histories:
        for log, value in zip(history.logs, history.value, strict=True):
            of.setdefault(value.tobytes(), []).append(f"{log} ({history.robot})")
    alike = [" = ".join(names) for names in of.values() if len(names) > 1]
    if alike:
        yield f"the same recording stands under several names, and counts as often: {listed(alike, SHOWN)}."


def _at_rest(histories: Sequence[History]) -> Iterator[str]:
    """Yield a warning where logs show less than half of what others show."""
    ranks = [(f"{log} ({one.robot})", _rank(J)) for one in histories
             for log, J in zip(one.logs, one.information, strict=True)]  # fmt: skip
    usual = np.median([rank for _, rank in ranks]) if ranks else 0
    if few := [name for name, rank in ranks if rank < usual / 2]:
        yield f"logs that show less than half of the parameters that others show, as at rest: {listed(few, SHOWN)}."


def _unlike(rows: pl.DataFrame) -> Iterator[str]:
    """Yield a warning where logs fit far worse than the others of their type."""
    import polars as pl

    usual = pl.col("error").median().over("type")
    worse = rows.filter(pl.col("status") == Status.OK).filter(pl.col("error") > WORSE * usual).sort("robot", "date")
    if names := [f"{log} ({robot}), {error:.3g} %" for log, robot, error in worse["log", "robot", "error"].iter_rows()]:
        yield (
            f"logs whose torque error is more than {WORSE:.0f} times the median: {listed(names, SHOWN)}. They may need "
            "terms that the recipe has not, because they were not among the logs that chose it."
        )


def _rank(information: Array) -> int:
    """Return the number of directions that are shown, whatever the units."""
    size = np.sqrt(np.maximum(np.diag(information), 0.0))
    shown = size > ROUNDING * size.max(initial=0.0)
    J = information[np.ix_(shown, shown)] / np.outer(size[shown], size[shown])
    return int((np.linalg.eigvalsh(J) > ROUNDING).sum()) if shown.any() else 0


def _all_at_once(changes: Changes, groups: int) -> Iterator[str]:
    """Yield a warning of each robot of which many groups, of so many, change with one log."""
    least = max(2, min(MANY, groups - 1))
    of: dict[tuple[str, str], list[Change]] = {}
    for one in changes.found:
        if one.shape is Shape.STEP:
            of.setdefault((one.robot, one.since), []).append(one)
    for (robot, log), some in of.items():
        if len(names := list(dict.fromkeys(_name(one.group) for one in some))) >= least:
            yield (
                f"{robot}: {listed(names, SHOWN)} change with {log}; look first whether units, signs and zeros are as "
                "they were, and whether the log is one of this robot."
            )


def _kinds(found: FleetResult) -> list[str]:
    """Return the types of robots that have results, in the order of the changes."""
    robots = {one.robot for one in found.histories}
    return [kind for kind, names in found.types.items() if not robots.isdisjoint(names)]


def _name(group: Group) -> str:
    return f"{group.kind.value} of {group.joint}"
