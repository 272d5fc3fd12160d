"""Findings on outliers: spikes, jumps, frozen or wrapped positions; spikes, frozen and clipped torques."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dynident.checks import log_notes as notes
from dynident.checks.finding import Finding, Topic
from dynident.errors import Severity
from dynident.identification.outliers import TorqueOutliers, runs
from dynident.log import Log
from dynident.smoothers.outliers import suspects
from dynident.splines import bridged, largest_up_to

__all__ = ["jumps", "position_outliers", "torque_findings"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

NAMED = 3  # rows that a finding names
WHOLE = 0.9  # share of the range by which a position that wraps jumps
JUMP = 10.0  # largest steps nearby that a jump exceeds
NEAR = 8  # samples nearby
STRAIGHT = 1e-3  # of the usual bend: below, a sample lies on the line between its neighbours
USUAL = 95  # percentile of the bends, which most samples of an interpolated signal do not have
MANY = 0.3  # share of straight samples that no measurement has


def jumps(log: Log) -> Iterator[Finding]:
    """Yield where a position jumps and stays: an error where it wraps, else a warning."""
    for j, name in enumerate(log.joints):
        q = log.q[:, j]
        at = _jumps(log.t, q)
        if len(at):
            bad = suspects(log).position_spikes[:, j] | suspects(log).position_frozen[:, j]
            at = at[~bad[at] & ~bad[at + 1]]
        if not len(at):
            continue
        size, row = np.abs(np.diff(q))[at], int(at[0])
        place = row, float(log.t[row])
        if size.max() >= WHOLE * np.ptp(q) and np.ptp(q) > 1.0:
            note = notes.WrappedPosition(len(at), float(size.max()), *place)
            yield Finding(Severity.ERROR, name, note, Topic.WRAPPED)
        else:
            jump = notes.PositionJump(len(at), float(size[0]), *place)
            yield Finding(Severity.WARNING, name, jump, Topic.JUMP)


def _jumps(t: Array, q: Array) -> NDArray[np.intp]:
    """Return the samples after which a position makes a step far larger than all steps near it."""
    apart = np.diff(t)
    steps = np.abs(np.diff(q)) * np.median(apart) / apart  # lost samples are no jump
    if len(steps) < 4 * NEAR or not steps.any():
        return np.empty(0, dtype=int)
    largest = largest_up_to(steps, NEAR)
    nearby = np.maximum(largest[NEAR - 1 : -NEAR - 1], largest[2 * NEAR :])  # before a step, and after it
    least = max(float(np.percentile(steps[steps > 0], 90)), 1e-9 * float(np.ptp(q)))
    return np.asarray(NEAR + np.flatnonzero(steps[NEAR:-NEAR] > JUMP * np.maximum(nearby, least)))


def position_outliers(log: Log, *, replaced: bool = True) -> Iterator[Finding]:
    """Yield spikes, frozen stretches and interpolated samples of positions; ``replaced`` says what becomes of them."""
    seen = suspects(log)
    for j, name in enumerate(log.joints):
        spike = seen.position_spikes[:, j]
        if spike.any():
            kind = notes.PositionSpikes if (spike <= seen.positions[:, j]).all() else notes.ManyPositionSpikes
            done = replaced and kind is notes.PositionSpikes
            note = kind(*_spikes(log.t, log.q[:, j], spike), replaced=done)
            yield Finding(Severity.WARNING, name, note, Topic.POSITION_SPIKES)
        for start, stop in runs(seen.position_frozen[:, j], log.q[:, j])[:NAMED]:
            done = replaced and bool(seen.positions[start, j])
            span = start, stop - start, float(log.t[start]), float(log.t[stop - 1]), float(log.q[start, j])
            yield Finding(Severity.WARNING, name, notes.FrozenPosition(*span, replaced=done), Topic.FROZEN)
        if (share := _straight(log.q[:, j])) > MANY:
            yield Finding(Severity.WARNING, name, notes.InterpolatedPositions(share), Topic.INTERPOLATED)


def _spikes(t: Array, x: Array, found: Mask) -> tuple[int, tuple[int, ...], tuple[float, ...], float]:
    """Return the number of spikes, the first rows and times, and the largest height."""
    rows = np.flatnonzero(found)
    largest = float(np.abs(x - bridged(t, x, found)).max())
    return len(rows), tuple(rows[:NAMED].tolist()), tuple(t[rows[:NAMED]].tolist()), largest


def _straight(q: Array) -> float:
    """Return the share of moving samples that lie on the line between their neighbours; zero for values on a grid."""
    step = np.diff(q)
    bend, moving = np.abs(np.diff(step)), (step[1:] != 0) & (step[:-1] != 0)
    usual = float(np.percentile(bend, USUAL)) if len(bend) else 0.0
    if usual == 0 or moving.mean() < 0.5 or np.mean(step == 0) > 0.01 or len(np.unique(np.abs(bend))) < len(bend) / 20:
        return 0.0
    return float(np.mean(bend[moving] < STRAIGHT * usual))


def torque_findings(
    logs: Sequence[Log], found: Sequence[TorqueOutliers | None], trained: int, *, masked: bool = True
) -> Iterator[Finding]:
    """Yield the torques of logs that are wrong; the first ``trained`` logs are of the training.

    ``masked`` says whether the fit leaves them out.
    """
    for k, (log, one) in enumerate(zip(logs, found, strict=True)):
        if one is not None:
            yield from (replace(said, source=log.source) for said in _of_log(log, one, masked, k >= trained))


def _of_log(log: Log, found: TorqueOutliers, masked: bool, held_out: bool) -> Iterator[Finding]:
    left_out, masked = found.masked, masked and not held_out
    for j, name in enumerate(log.joints):
        tau, wrong = log.tau[:, j], found.wrong[:, j]
        if (wrong & ~left_out[:, j]).any() and not held_out:
            row = int(np.argmax(wrong))
            many = notes.ManyTorqueOutliers(float(wrong.mean()), row, float(log.t[row]))
            yield Finding(Severity.WARNING, name, many, Topic.MANY_OUTLIERS)
            continue
        if found.spikes[:, j].any():
            spikes = notes.TorqueSpikes(*_spikes(log.t, tau, found.spikes[:, j]), masked, held_out)
            yield Finding(Severity.WARNING, name, spikes, Topic.TORQUE_SPIKES)
        for start, stop in runs(found.frozen[:, j], tau)[:NAMED]:
            span = start, stop - start, float(log.t[start]), float(log.t[stop - 1]), float(tau[start])
            yield Finding(Severity.WARNING, name, notes.FrozenTorque(*span, masked, held_out), Topic.FROZEN_TORQUE)
        for value in np.unique(tau[found.clipped[:, j]]):
            rows = np.flatnonzero(found.clipped[:, j] & (tau == value))
            clipped = notes.ClippedTorque(
                len(rows), float(value), int(rows[0]), float(log.t[rows[0]]), masked, held_out
            )
            yield Finding(Severity.WARNING, name, clipped, Topic.CLIPPED)
