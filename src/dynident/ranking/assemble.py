"""From rows to a ranking: errors on common samples, differences beyond chance, what does not apply."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.ranking.candidates import Candidate, Combination
from dynident.ranking.differences import Differences, differences, joint_errors
from dynident.ranking.ranking import Absent, Basis, Ranked, Ranking, TruthFigures
from dynident.ranking.rows import Outcome
from dynident.ranking.smoothing import Common
from dynident.ranking.task import Task
from dynident.ranking.truth import Truth
from dynident.splines import NORMAL_95
from dynident.validation import REPEATED, repeat_of

__all__ = ["Rows", "assembled"]

Array = NDArray[np.float64]
Row = Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class Rows:
    """All rows of a comparison: of the ``smoothers`` one each, of combinations that took part by both numbers."""

    smoothers: tuple[Candidate, ...]
    estimators: tuple[Candidate, ...]
    smooth: list[Row]
    fits: Mapping[tuple[int, int], Row]
    common: Common
    computed: int

    __repr__ = brief


def assembled(name: str, task: Task, rows: Rows, rng: np.random.Generator) -> Ranking:
    """Return the ranking of all rows; ``rng`` draws blocks of time."""
    basis: Basis = "validation" if task.held_out else "train"
    column = "held" if task.held_out else "cross"
    torque = task.torque_squares(rows.common.masks, basis, fitted=not task.held_out)
    judged = {key: _blocks(row[column], torque) for key, row in rows.fits.items() if len(row[column])}
    judged = {key: squares for key, squares in judged.items() if np.isfinite(squares).all()}
    found = {key: _ranked(task, rows, key, row) for key, row in rows.fits.items()}
    told: Differences | None = None
    if judged:
        told = differences(np.stack(list(judged.values())), torque, task.blocks[basis].log, rng)
        for k, key in enumerate(judged):
            found[key] = replace(
                found[key], error=float(told.error[k]), overall=_overall(judged[key], torque),
                p_value=float(told.p_value[k]),
                interval=(float(told.interval[k, 0]), float(told.interval[k, 1])),
            )  # fmt: skip
    _crossed(task, rows, found, rng)
    tried, others = list(found.values()), list(_without(rows))
    every = [*tried, *others]
    applies = [one for one in every if one.outcome is not Outcome.NOT_APPLICABLE]
    ordered = sorted(applies, key=lambda one: one.error if math.isfinite(one.error) else math.inf)
    return Ranking(
        name,
        task.joints,
        basis,
        tuple(ordered),
        tuple(_absent(tried, others)),
        rows.common.shares,
        rows.common.kept,
        math.nan if told is None else told.length * task.blocks[basis].seconds,
        0.0 if told is None else told.drawn,
        told is not None and told.told,
        task.folds,
        () if task.truth is None else task.truth.names,
        () if task.truth is None else task.truth.units,
        tuple(_used(rows)),
        rows.estimators,
        rows.computed,
        tuple(_repeats(task)),
        task.findings,
        _offsets(task, rows),
    )


def _repeats(task: Task) -> Iterator[tuple[str, str]]:
    """Yield held-out logs with the log of the training whose motion they repeat."""
    train = task.motions["train"]
    for held, motion in task.motions["validation"].items():
        again = (log for log, other in train.items() if repeat_of(motion, other).error < REPEATED)
        yield from ((held, log) for log in islice(again, 1))


def _crossed(task: Task, rows: Rows, found: dict[tuple[int, int], Ranked], rng: np.random.Generator) -> None:
    """Give those which held-out logs rank the chance that they are as good as any other in cross-validation."""
    torque = task.torque_squares(rows.common.masks, "train", fitted=True)
    ranked = (key for key, one in found.items() if math.isfinite(one.error) and len(rows.fits[key]["cross"]))
    crossed = {key: _blocks(rows.fits[key]["cross"], torque) for key in ranked} if task.held_out else {}
    crossed = {key: squares for key, squares in crossed.items() if np.isfinite(squares).all()}
    if crossed:
        told = differences(np.stack(list(crossed.values())), torque, task.blocks["train"].log, rng)
        for key, p_value in zip(crossed, told.p_value, strict=True):
            found[key] = replace(found[key], cross_p_value=float(p_value))


def _used(rows: Rows) -> Iterator[Candidate]:
    """Yield the smoothers, each with the part that was taken of several."""
    for one, row in zip(rows.smoothers, rows.smooth, strict=True):
        yield one if row["chosen"] is None else replace(one, parts=(one.parts[row["chosen"]],))


def _offsets(task: Task, rows: Rows) -> dict[str, float]:
    """Return the time offset (s) of each smoother that works."""
    pairs = zip(rows.smoothers, rows.smooth, strict=True)
    return {
        one.name: row["shift"][0] if len(row["shift"]) else task.late
        for one, row in pairs
        if row["status"] == Outcome.OK
    }


def _blocks(values: list[float], torque: Array) -> Array:
    """Return sums of squares (K, n)."""
    return np.array(values, dtype=float).reshape(torque.shape)


def _ranked(task: Task, rows: Rows, key: tuple[int, int], row: Row) -> Ranked:
    """Return what a row says of a combination, without its place among the others."""
    i, j = key
    one = _named(rows, i, j)
    outcome = Outcome(row["status"])
    if not len(row["train"]):
        return Ranked(one, outcome, row["reason"])
    masks = rows.common.masks
    whole = task.torque_squares(masks, "train", fitted=False).sum(axis=0)
    fitted = task.torque_squares(masks, "train", fitted=True)
    held = task.torque_squares(masks, "validation", fitted=False)
    return Ranked(
        one,
        outcome,
        row["reason"],
        held_out=_errors(task, row["held"], held) if task.held_out else {},
        same_motion=_of_sums(task, row["alike"], held.sum(axis=0)) if task.held_out else {},
        training=_of_sums(task, row["train"], whole),
        cross_validated=_errors(task, row["cross"], fitted),
        condition=math.nan if row["condition"] is None else row["condition"],
        eigenvalue=row["eigenvalue"],
        seconds_smoothing=rows.smooth[i]["seconds"],
        seconds_estimate=row["seconds"],
        seconds_validation=math.nan if row["cv_seconds"] is None else row["cv_seconds"],
        notes=tuple(row["notes"]),
        truth=None if task.truth is None else _truth(task.truth, row),
    )


def _errors(task: Task, values: list[float], torque: Array) -> dict[str, float]:
    if not len(values):
        return {}
    return _of_sums(task, _blocks(values, torque).sum(axis=0), torque.sum(axis=0))


def _of_sums(task: Task, squares: list[float] | Array, torque: Array) -> dict[str, float]:
    """Return the errors by joint from sums of squares (n)."""
    return dict(zip(task.joints, joint_errors(np.asarray(squares), torque).tolist(), strict=True))


def _overall(squares: Array, torque: Array) -> float:
    """Return the relative error (%) of all joints together that have a torque."""
    known = torque.sum(axis=0) > 0
    return float(100.0 * np.sqrt(squares[:, known].sum() / torque.sum()))


def _truth(truth: Truth, row: Row) -> TruthFigures:
    error, std = np.array(row["base"], dtype=float) - truth.value, np.array(row["std"], dtype=float)
    with np.errstate(divide="ignore", invalid="ignore"):
        relative, scaled = 100.0 * np.abs(error / truth.value), error / truth.bound
    known = np.isfinite(error) & np.isfinite(std)
    sized = np.isfinite(scaled)
    return TruthFigures(
        error,
        std,
        float(np.median(relative[np.isfinite(relative)])) if np.isfinite(relative).any() else math.nan,
        float(np.sqrt(np.mean(scaled[sized] ** 2))) if sized.any() else math.nan,
        int(np.sum(np.abs(error[known]) <= NORMAL_95 * std[known])),
        int(known.sum()),
    )


def _named(rows: Rows, i: int, j: int) -> Combination:
    one, other = rows.smoothers[i], rows.estimators[j]
    return Combination(one.name, other.name, one.own and other.own)


def _without(rows: Rows) -> Iterator[Ranked]:
    """Yield the combinations whose smoother takes no part, with its reason."""
    for i, row in enumerate(rows.smooth):
        name = rows.smoothers[i].name
        outcome = Outcome.TOO_FEW if name in rows.common.apart else Outcome(row["status"])
        if outcome is Outcome.OK:
            continue
        reason = rows.common.apart.get(name) or row["reason"]
        for j in range(len(rows.estimators)):
            yield Ranked(_named(rows, i, j), outcome, reason)


def _absent(tried: list[Ranked], others: list[Ranked]) -> Iterator[Absent]:
    """Yield what does not apply: a smoother, an estimator with all that were ``tried``, or one combination alone."""
    lacking = [one for one in others if one.outcome is Outcome.NOT_APPLICABLE]
    for name, reason in dict.fromkeys((one.combination.smoother, one.reason) for one in lacking):
        yield Absent(name, "", reason)
    absent = [one for one in tried if one.outcome is Outcome.NOT_APPLICABLE]
    for name in dict.fromkeys(one.combination.estimator for one in absent):
        some = [one for one in absent if one.combination.estimator == name]
        alike = len({one.reason for one in some}) == 1
        if alike and len(some) == sum(one.combination.estimator == name for one in tried):
            yield Absent("", name, some[0].reason)
        else:
            yield from (Absent(one.combination.smoother, name, one.reason) for one in some)
