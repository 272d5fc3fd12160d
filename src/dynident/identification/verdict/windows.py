"""Which seconds to leave out of the training, and which speeds it lacks."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from dynident.identification.result import Identification
from dynident.identification.verdict.gain import WORTH, judged_log, points
from dynident.identification.verdict.parts import Parts, parts_of
from dynident.identification.verdict.steps import Cover, LeaveOut, Step
from dynident.validation import LogValidation

__all__ = ["window_steps"]

Array = NDArray[np.float64]
ODD = 4.0  # times the median squared residual of the parts of the training: one is looked at from here on
MOST = 0.3  # share of the parts that are odd, at most: more are no exception
CERTAIN = 2.0  # standard errors over the parts
BEYOND = 1.05  # times the largest speed or acceleration of the training
FEWEST = 20  # samples beyond
JOINED = 0.3  # s: stretches this near to each other are one


def window_steps(found: Identification) -> Iterator[Step]:
    """Yield which speeds to add to the training, and which seconds to leave out of it."""
    log = judged_log(found)
    if log.role == "validation" and (step := _cover(found, log)) is not None:
        yield step
    parts = parts_of(found)
    if parts.count < 3 or not parts.Z.shape[2] or not np.isfinite(parts.left).all():
        return
    yield from _odd(parts, log, [joint.name for joint in found.model.joints])


def _odd(parts: Parts, log: LogValidation, joints: list[str]) -> Iterator[LeaveOut]:
    """Yield the part of the training that the others contradict, with the odd ones beside it, if they fit better
    without it."""
    size = np.bincount(parts.part, minlength=parts.count)
    if not size.all():  # of so short a training that a part of it has no sample
        return
    squares = parts.squares(parts.left).sum(axis=1) / size
    odd = squares > ODD * np.median(squares)
    if not odd.any() or odd.mean() > MOST:
        return
    worst = first = last = int(np.argmax(squares))
    place = np.array([parts.log[parts.part == k][0] for k in range(parts.count)])
    while first > 0 and odd[first - 1] and place[first - 1] == place[worst]:
        first -= 1
    while last + 1 < parts.count and odd[last + 1] and place[last + 1] == place[worst]:
        last += 1
    out = (parts.part >= first) & (parts.part <= last)
    gain = _gain(parts, np.repeat(out[:, None], len(joints), axis=1), ~out, log, joints)
    if gain is not None:
        t = parts.t[out]
        own = float(np.average(squares[first : last + 1], weights=size[first : last + 1]))
        rest = float(
            np.average(np.delete(squares, range(first, last + 1)), weights=np.delete(size, range(first, last + 1)))
        )
        yield LeaveOut(parts.names[place[worst]], float(t[0]), float(t[-1]), own / rest, gain=gain)


def _gain(
    parts: Parts, out: NDArray[np.bool_], rows: NDArray[np.bool_], log: LogValidation, joints: list[str]
) -> float | None:
    """Return the points that leaving equations out gains by the cross-validated residual of the rows (M); None where
    that is little or may be chance."""
    without = parts.without(out)
    if not np.isfinite(without).all():
        return None
    before, after = parts.squares(parts.left, rows), parts.squares(without, rows)
    change = (before - after).sum(axis=1)
    used = parts.squares(np.ones_like(parts.y), rows).sum(axis=1) > 0
    std = float(np.std(change[used], ddof=1) * np.sqrt(used.sum())) if used.sum() > 1 else np.inf
    if not change.sum() > CERTAIN * std:
        return None
    mean = (before - after).sum(axis=0) / rows.sum() / parts.weight**2
    gain = points(log, dict(zip(joints, map(float, mean), strict=True)))
    return gain if gain is not None and gain > WORTH * log.errors.relative_error else None


def _cover(found: Identification, log: LogValidation) -> Cover | None:
    """Return the speeds that the held-out log has beyond those of the training, if its error is larger there."""
    train = [one.motion for one in found.validations if one.role == "train"]
    motion = log.motion
    ratios = []
    for name in ("dq", "ddq"):
        most = np.max([np.abs(getattr(one, name)[one.mask]).max(axis=0) for one in train], axis=0)
        ratios.append(np.abs(getattr(motion, name)) / np.where(most > 0, most, np.inf))
    faster = np.maximum(ratios[0], np.sqrt(ratios[1]))
    beyond = (faster > BEYOND).any(axis=1) & motion.mask
    inside = motion.mask & ~beyond
    residual = np.where(motion.mask[:, None], motion.tau - log.predicted, 0.0)
    if beyond.sum() < FEWEST or inside.sum() < FEWEST:
        return None
    error, rest = (100.0 * np.linalg.norm(residual[rows]) / (np.linalg.norm(motion.tau[rows]) or np.inf)
                   for rows in (motion.mask, inside))  # fmt: skip
    if not error - rest > WORTH * error:
        return None
    squares = np.square(residual).sum(axis=1)
    j = int(np.argmax(((faster > BEYOND) * squares[:, None])[beyond].sum(axis=0)))
    start, stop = _worst_stretch(motion.t, beyond, squares)
    factor = float(faster[beyond, j].max())
    speed = factor * max(float(np.abs(one.dq[one.mask, j]).max()) for one in train)
    return Cover(log.name, start, stop, motion.joints[j], factor, speed, gain=float(error - rest))


def _worst_stretch(t: Array, chosen: NDArray[np.bool_], squares: Array) -> tuple[float, float]:
    """Return begin and end (s) of the stretch of chosen samples (N) with the largest sum of squares (N)."""
    rows = np.flatnonzero(chosen)
    groups = np.split(rows, np.flatnonzero(np.diff(t[rows]) > JOINED) + 1)
    worst = max(groups, key=lambda one: float(squares[one].sum()))
    return float(t[worst[0]]), float(t[worst[-1]])
