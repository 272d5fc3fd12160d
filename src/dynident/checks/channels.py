"""Checks of the channels of a log: joints at rest, wrong units, quantised or repeated values."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynident.checks import channel_notes, log_notes, stamps
from dynident.checks.stamps import MINIMUM_SAMPLES
from dynident.identification import arm_rests, rest_blocks
from dynident.identification.outliers import TorqueOutliers, equal_runs
from dynident.motion.log import Log
from dynident.motion.smoothers import repair_log
from dynident.motion.smoothers.smoother import suspects
from dynident.motion.splines import bridge_gaps, grid_step, noise_sigma, stretches, trailing_maximum
from dynident.runtime import Finding, InputError, Severity
from dynident.runtime.arrays import Array

Mask = NDArray[np.bool_]

MAX_NAMED_ROWS = 3  # rows that a finding names
MIN_WRAP_SHARE = 0.9  # share of the range by which a position that wraps jumps
MIN_JUMP_RATIO = 10.0  # largest steps nearby that a jump exceeds
NEIGHBOUR_SAMPLES = 8  # samples nearby
MAX_STRAIGHT_BEND = 1e-3  # of the usual bend: below, a sample lies on the line between its neighbours
BEND_PERCENTILE = 95  # percentile of the bends, which most samples of an interpolated signal do not have
MAX_STRAIGHT_SHARE = 0.3  # share of straight samples that no measurement has
MAX_SPAN = 4 * np.pi  # rad: joints of arms seldom turn further from stop to stop
MAX_SPEED = 40.0  # rad/s: no arm moves its joints so fast
SPEED_LAG = 0.02  # s: over this time position noise is small beside 40 rad/s
MIN_RESOLVED_STEPS = 10.0  # median step in units of the resolution below which quantisation shapes the noise
MAX_REPEAT_SHARE = 0.05  # share of repeated positions in motion to warn of
MIN_NOISE_SAMPLES = 6  # samples between outliers, at least, to estimate the noise from


def jump_findings(log: Log) -> Iterator[Finding]:
    """Yield where a position jumps and stays: an error where it wraps, else a warning."""
    for j, name in enumerate(log.joints):
        q = log.q[:, j]
        jump_rows = _jump_rows(log.t, q)
        if len(jump_rows):
            # a spike or a frozen stretch begins and ends with a jump, too: these are reported elsewhere
            is_outlier = suspects(log).position_spikes[:, j] | suspects(log).position_frozen[:, j]
            jump_rows = jump_rows[~is_outlier[jump_rows] & ~is_outlier[jump_rows + 1]]
        if not len(jump_rows):
            continue
        size, row = np.abs(np.diff(q))[jump_rows], int(jump_rows[0])
        place = row, float(log.t[row])
        if size.max() >= MIN_WRAP_SHARE * np.ptp(q) and np.ptp(q) > 1.0:
            yield Finding(channel_notes.WrappedPosition(len(jump_rows), float(size.max()), *place), name)
        else:
            yield Finding(log_notes.PositionJump(len(jump_rows), float(size[0]), *place), name)


def _jump_rows(t: Array, q: Array) -> NDArray[np.intp]:
    """Return the samples after which a position makes a step far larger than all steps near it."""
    intervals = np.diff(t)
    steps = np.abs(np.diff(q)) * np.median(intervals) / intervals  # lost samples are no jump
    if len(steps) < 4 * NEIGHBOUR_SAMPLES or not steps.any():
        return np.empty(0, dtype=int)
    # the largest step among the neighbours on either side, by one running maximum
    largest = trailing_maximum(steps, NEIGHBOUR_SAMPLES)
    # before a step, and after it
    nearby = np.maximum(largest[NEIGHBOUR_SAMPLES - 1 : -NEIGHBOUR_SAMPLES - 1], largest[2 * NEIGHBOUR_SAMPLES :])
    # a floor for the steps nearby, as those of a joint at rest are zero
    min_step = max(float(np.percentile(steps[steps > 0], 90)), 1e-9 * float(np.ptp(q)))
    return np.asarray(
        NEIGHBOUR_SAMPLES
        + np.flatnonzero(steps[NEIGHBOUR_SAMPLES:-NEIGHBOUR_SAMPLES] > MIN_JUMP_RATIO * np.maximum(nearby, min_step))
    )


def position_outlier_findings(log: Log, *, replaced: bool) -> Iterator[Finding]:
    """Yield spikes, frozen stretches and interpolated samples of positions.

    ``replaced`` tells whether they are replaced.
    """
    outliers = suspects(log)
    for j, name in enumerate(log.joints):
        spike = outliers.position_spikes[:, j]
        if spike.any():
            are_few = (spike <= outliers.positions[:, j]).all()
            kind = log_notes.PositionSpikes if are_few else log_notes.ManyPositionSpikes
            yield Finding(kind(*_describe_spikes(log.t, log.q[:, j], spike), bool(replaced and are_few)), name)
        for start, stop in equal_runs(outliers.position_frozen[:, j], log.q[:, j])[:MAX_NAMED_ROWS]:
            is_replaced = replaced and bool(outliers.positions[start, j])
            yield Finding(
                log_notes.FrozenPosition(*_describe_stretch(log.t, log.q[:, j], start, stop), is_replaced), name
            )
        if (share := _interpolated_share(log.q[:, j])) > MAX_STRAIGHT_SHARE:
            yield Finding(log_notes.InterpolatedPositions(share), name)


def _describe_spikes(t: Array, x: Array, mask: Mask) -> tuple[int, tuple[int, ...], tuple[float, ...], float]:
    """Return the number of spikes where ``mask`` is True, the first rows and times, and the largest height."""
    rows = np.flatnonzero(mask)
    largest = float(np.abs(x - bridge_gaps(t, x, mask)).max())
    return len(rows), tuple(rows[:MAX_NAMED_ROWS].tolist()), tuple(t[rows[:MAX_NAMED_ROWS]].tolist()), largest


def _describe_stretch(t: Array, x: Array, start: int, stop: int) -> tuple[int, int, float, float, float]:
    """Return the first row, the number of rows, both times and the value of a frozen stretch."""
    return start, stop - start, float(t[start]), float(t[stop - 1]), float(x[start])


def _interpolated_share(q: Array) -> float:
    """Return the share of moving samples that lie on the line between their neighbours; zero for values on a grid."""
    step = np.diff(q)
    bend, moving = np.abs(np.diff(step)), (step[1:] != 0) & (step[:-1] != 0)
    # compare with the usual bend: an interpolated signal has many samples with almost none
    usual_bend = float(np.percentile(bend, BEND_PERCENTILE)) if len(bend) else 0.0
    on_a_grid = np.mean(step == 0) > 0.01 or len(np.unique(bend)) < len(bend) / 20
    if usual_bend == 0 or on_a_grid:
        return 0.0
    return float(np.mean(bend[moving] < MAX_STRAIGHT_BEND * usual_bend))


def torque_findings(
    logs: Sequence[Log], outliers: Sequence[TorqueOutliers | None], trained: int, *, masked: bool
) -> Iterator[Finding]:
    """Yield the torques of logs that are wrong; the first ``trained`` logs are of the training.

    ``masked`` says whether the fit leaves them out.
    """
    for k, (log, log_outliers) in enumerate(zip(logs, outliers, strict=True)):
        if log_outliers is not None:
            findings = _log_torque_findings(log, log_outliers, masked, k >= trained)
            yield from (replace(finding, source=log.source) for finding in findings)


def _log_torque_findings(log: Log, outliers: TorqueOutliers, masked: bool, held_out: bool) -> Iterator[Finding]:
    left_out, masked = outliers.excluded_torques, masked and not held_out
    for j, name in enumerate(log.joints):
        tau, wrong = log.tau[:, j], outliers.wrong[:, j]
        # more torques look wrong than are left out: so many are no outliers, and are not described one by one
        if (wrong & ~left_out[:, j]).any() and not held_out:
            row = int(np.argmax(wrong))
            yield Finding(log_notes.ManyTorqueOutliers(float(wrong.mean()), row, float(log.t[row])), name)
            continue
        if outliers.spikes[:, j].any():
            spikes = log_notes.TorqueSpikes(*_describe_spikes(log.t, tau, outliers.spikes[:, j]), masked, held_out)
            yield Finding(spikes, name)
        for start, stop in equal_runs(outliers.frozen[:, j], tau)[:MAX_NAMED_ROWS]:
            yield Finding(log_notes.FrozenTorque(*_describe_stretch(log.t, tau, start, stop), masked, held_out), name)
        for value in np.unique(tau[outliers.clipped[:, j]]):
            rows = np.flatnonzero(outliers.clipped[:, j] & (tau == value))
            place = int(rows[0]), float(log.t[rows[0]])
            yield Finding(log_notes.ClippedTorque(len(rows), float(value), *place, masked, held_out), name)


@dataclass(frozen=True)
class ChannelFacts:
    """Statistics of one joint of a log, in SI units: ``span`` of the position and ``rms`` of the torque.

    ``resolution`` and ``torque_resolution`` are the smallest steps, nan where the values lie on no grid; ``noise`` and
    ``torque_noise`` the estimates of ``noise_sigma``; ``repeats`` the share of positions, in motion, that are exactly
    the previous one; ``still`` the share of the time without motion. All but the steps are without the samples that the
    fit leaves out: ``left_out`` positions and ``torque_left_out`` torques.
    """

    joint: str
    span: float
    noise: float
    resolution: float
    repeats: float
    still: float
    rms: float
    torque_noise: float
    torque_resolution: float
    left_out: int = 0
    torque_left_out: int = 0


def channel_facts(log: Log, positions: Mask | None = None, torques: Mask | None = None) -> tuple[ChannelFacts, ...]:
    """Return statistics of each joint of a log, which must have at least 6 samples.

    ``positions`` and ``torques`` (N, n) mark the samples that the fit leaves out, None for none.
    """
    no_mask = np.zeros(log.q.shape, dtype=bool)
    q_out, tau_out = no_mask if positions is None else positions, no_mask if torques is None else torques
    # bridge the samples that are left out, so that span and rests are those of the motion
    q = np.stack([bridge_gaps(log.t, *column_pair) for column_pair in zip(log.q.T, q_out.T, strict=True)], axis=1)
    still = rest_blocks(replace(log, q=q)).mean(axis=0)
    return tuple(
        ChannelFacts(
            joint=name,
            span=float(np.ptp(q[:, j])),
            noise=_kept_noise(log.t, log.q[:, j], ~q_out[:, j]),
            resolution=grid_step(log.q[:, j]),
            repeats=_repeat_share(q[:, j]),
            still=float(still[j]),
            rms=float(np.sqrt(np.mean(log.tau[~tau_out[:, j], j] ** 2))),
            torque_noise=_kept_noise(log.t, log.tau[:, j], ~tau_out[:, j]),
            torque_resolution=grid_step(log.tau[:, j]),
            left_out=int(q_out[:, j].sum()),
            torque_left_out=int(tau_out[:, j].sum()),
        )
        for j, name in enumerate(log.joints)
    )


def _kept_noise(t: Array, x: Array, mask: Mask) -> float:
    """Return the noise of x (N) in the stretches where ``mask`` is True, nan where none is long enough."""
    # the noise is estimated by differences, which need several samples in a row
    parts = [part for part in stretches(mask) if part.stop - part.start >= MIN_NOISE_SAMPLES]
    squares = [noise_sigma(t[part], x[part])[0] ** 2 for part in parts]
    sizes = [part.stop - part.start for part in parts]
    return float(np.sqrt(np.average(squares, weights=sizes))) if parts else np.nan


def check_log(
    log: Log, kinds: Mapping[str, str], multi_turn: Set[str] = frozenset(), *, torque: bool = True
) -> tuple[Finding, ...]:
    """Return all findings on a log, those on time first, then joint by joint.

    ``kinds`` maps each joint of the log to "revolute" or "prismatic"; joints named in ``multi_turn`` may make any
    number of turns. With ``torque`` False the torques are not checked. Raises InputError where a joint of the log has
    no kind.
    """
    missing = [name for name in log.joints if name not in kinds]
    if missing:
        raise InputError(f"{log.source}: joint {missing[0]!r} has no kind; give 'revolute' or 'prismatic'.")
    clock = [*stamps.order_findings(log), *stamps.time_unit_findings(log)]
    wraps = [x for x in jump_findings(log) if isinstance(x.message, channel_notes.WrappedPosition)]
    findings, wrapped = [*stamps.step_findings(log), *clock, *wraps], [finding.joint for finding in wraps]
    for j, name in enumerate(log.joints):
        # an angle may be in degrees only where the joint neither turns often nor wraps, and the time is right
        turns = kinds[name] == "revolute" and name not in multi_turn and not clock and name not in wrapped
        findings += _joint_findings(log, j, turns=turns, torque=torque)
    return tuple(findings)


def _joint_findings(log: Log, j: int, *, turns: bool, torque: bool) -> Iterator[Finding]:
    """Yield what is wrong with the values of a joint, whose position may be in degrees only if it ``turns``."""
    q, tau, name = log.q[:, j], log.tau[:, j], log.joints[j]
    levels, resolution = len(np.unique(q)), grid_step(q)
    if levels <= 3:
        yield Finding(channel_notes.NeverMoves(levels, float(q[0])), name)
    if turns and _far_or_fast(log.t, q):
        clean = repair_log(log, torque=False).q[:, j]  # spikes are no motion
        if _far_or_fast(log.t, clean):
            yield Finding(channel_notes.PerhapsDegrees(float(np.ptp(clean)), _peak_speed(log.t, clean)), name)
    counts = np.abs(np.diff(q)) / resolution
    if not np.isnan(resolution) and np.median(counts[counts > 0.5]) < MIN_RESOLVED_STEPS:
        yield Finding(channel_notes.QuantisedPosition(resolution, MIN_RESOLVED_STEPS), name)
    if torque and tau.min() == tau.max():
        yield Finding(channel_notes.ConstantTorque(float(tau[0])), name)


def check_log_fully(
    log: Log,
    kinds: Mapping[str, str],
    multi_turn: Set[str] = frozenset(),
    *,
    replaced: bool = True,
    rests_kept: bool = False,
) -> tuple[Finding, ...]:
    """Return the findings of ``check_log`` and of the slower checks.

    These are stamps, lost samples, stale positions, rests and outliers of the positions. ``rests_kept`` says
    whether rests stay in the fit, ``replaced`` whether outliers of the positions are replaced. Each finding names
    the log's source. Raises the errors of ``check_log``.
    """
    quick_findings = check_log(log, kinds, multi_turn)
    findings = [finding for finding in quick_findings if not isinstance(finding.message, channel_notes.UnevenSteps)]
    # a log that is too short has an error already
    if len(log) >= MINIMUM_SAMPLES:
        findings += [
            *stamps.stamp_findings(stamps.timing(log)),
            *rest_findings(log, rests_kept=rests_kept),
            *position_outlier_findings(log, replaced=replaced),
        ]
        findings += [x for x in jump_findings(log) if isinstance(x.message, log_notes.PositionJump)]
        # spikes would pass for motion of a joint in millimetres
        clean = repair_log(log, torque=False)
        for j, name in enumerate(log.joints):
            if kinds[name] == "prismatic" and name not in multi_turn:
                findings += stamps.length_unit_findings(name, log.t, clean.q[:, j])
            if (share := _repeat_share(log.q[:, j])) > MAX_REPEAT_SHARE:
                update_interval = round(1 / (1 - share)) if share < 1 else 0
                findings.append(Finding(channel_notes.RepeatedPositions(share, update_interval), name))
    return tuple(replace(finding, source=log.source) for finding in findings)


def _far_or_fast(t: Array, q: Array) -> bool:
    return float(np.ptp(q)) > MAX_SPAN or _peak_speed(t, q) > MAX_SPEED


def _peak_speed(t: Array, q: Array) -> float:
    """Return the 99th percentile of the speed over 20 ms: from sample to sample it is too noisy."""
    return stamps.percentile_speed(t, q, round(SPEED_LAG / float(np.median(np.diff(t)))))


def _repeat_share(q: Array, reach: int = 5) -> float:
    """Return the share of positions equal to the previous one, while the joint moves by many of its smallest steps."""
    steps = np.abs(np.diff(q))
    nonzero_steps = steps[steps > 1e-9 * np.ptp(q)]
    if len(nonzero_steps) < MINIMUM_SAMPLES or len(q) <= 2 * reach:
        return 0.0
    # the mean step over a window tells whether the joint moves, as single steps may be zero between updates
    pace = np.abs(q[2 * reach :] - q[: -2 * reach]) / (2 * reach)
    moving = pace > 10 * nonzero_steps.min()
    is_repeat = steps[reach - 1 : reach - 1 + len(pace)] == 0
    return float(is_repeat[moving].mean()) if moving.sum() >= MINIMUM_SAMPLES else 0.0


def rest_findings(log: Log, *, rests_kept: bool = False) -> Iterator[Finding]:
    """Yield where the whole arm is at rest for longest; a warning where rests stay in the fit (``rests_kept``)."""
    if rests := arm_rests(log):
        longest = max(rests, key=lambda part: part.stop - part.start)
        start, stop = log.t[longest.start], log.t[longest.stop - 1]
        note = channel_notes.ArmAtRest(float(start), float(stop), rests_kept)
        yield Finding(note, severity=Severity.WARNING if rests_kept else Severity.INFO)
