"""What to record or change next: which seconds to leave out, which speeds to add, which parameters to sharpen."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from dynident.identification.links import scaled_covariance
from dynident.identification.result import Identification
from dynident.identification.training_parts import TrainingParts, parts_of
from dynident.identification.verdict_steps import (
    MIN_GAIN_SHARE,
    CheckRipple,
    Cover,
    ExcitingMotion,
    LeaveOut,
    MoreRecordings,
    NextStep,
    SetRight,
    Sharpen,
    SlowReversals,
    excess_squares,
    gain_points,
    judged_log,
)
from dynident.motion.log import subsample
from dynident.regression import UnexcitedParameters
from dynident.runtime.arrays import Array
from dynident.validation import SLOW_SPEED_SHARE, Cause, LogValidation, ResidualRipple, Reversals

MIN_RELATIVE_STD = 0.3  # standard error over value from which a parameter wants better data
MIN_TORQUE_SHARE = 1.0  # %, of the torque, that the standard error must be worth for that
MAX_PARAMETER_STEPS = 5  # next steps on single parameters
MAX_SAMPLES = 500  # of the training, and of the log that is judged
RANK_TOLERANCE_GAINS = 1e-6  # share of the largest singular value below which the training says nothing


def next_steps(identification: Identification) -> tuple[UnexcitedParameters | NextStep, ...]:
    """Return what to record or change next, beyond the remedies of the reasons.

    What the checks found comes first, as it spoils the next recording, too; each are ordered by their gain. Those of
    unknown gain come last, parameters that are not excited before the others.
    """
    steps = (
        *_correction_steps(identification),
        *window_steps(identification),
        *_sharpening_steps(identification),
        *_residual_steps(identification),
        *_recording_steps(identification),
    )
    ranked = sorted((step for step in steps if step.gain is not None), key=_place)
    return (*ranked, *identification.base.unexcited, *(step for step in steps if step.gain is None))


def _place(step: NextStep) -> tuple[bool, float]:
    return not isinstance(step, SetRight), -(step.gain or 0.0)


def _correction_steps(identification: Identification) -> Iterator[SetRight]:
    """Yield findings of the checks whose correction would lower the error noticeably, or that are advice."""
    log = judged_log(identification)
    excess = excess_squares(log)  # of which a cause has the same share as in training
    for finding in identification.findings:
        gain = gain_points(log, {joint: share * excess[joint] for joint, share in finding.message.removed})
        is_worthwhile = gain is not None and gain > MIN_GAIN_SHARE * log.errors.relative_error
        if is_worthwhile or finding.message.advises:
            yield SetRight(finding, gain=gain)


def _residual_steps(identification: Identification) -> Iterator[NextStep]:
    """Yield the steps that the tests of the residuals suggest."""
    held_out = identification.of_role("validation") or identification.validations
    causes = {joint: test.causes for log in held_out for joint, test in log.residuals.items()}
    log = judged_log(identification)
    tests = {joint: (test, log.errors.rmse[joint] ** 2) for joint, test in log.residuals.items()}
    if joints := _joints_with(causes, Reversals):
        excess = {j: size * max(test.reversal_share - test.slow_share, 0.0) for j, (test, size) in tests.items()}
        speeds = SLOW_SPEED_SHARE * np.sqrt(np.mean(log.motion.dq[log.motion.mask] ** 2, axis=0))
        reported_speeds = tuple(float(speeds[log.motion.joints.index(joint)]) for joint in joints)
        terms_chosen = identification.calibration.terms is not None and bool(identification.calibration.terms.trials)
        yield SlowReversals(joints, reported_speeds, terms_chosen, gain=_gain_of_joints(log, excess, joints))
    if joints := _joints_with(causes, ResidualRipple):
        excess = {joint: size * max(test.peak_share, 0.0) for joint, (test, size) in tests.items()}
        frequencies = tuple(x.frequency for j in joints for x in causes[j] if isinstance(x, ResidualRipple))
        yield CheckRipple(joints, frequencies, gain=_gain_of_joints(log, excess, joints))


def _recording_steps(identification: Identification) -> Iterator[MoreRecordings]:
    """Yield the advice to fit more recordings, where errors of the parameters are a noticeable part of the error."""
    covariance, basis = scaled_covariance(identification), identification.base.on_data
    if covariance is None or not identification.of_role("validation"):
        return
    log = judged_log(identification)
    (rows,) = subsample([log.motion], MAX_SAMPLES)
    Y = identification.model.regressor(**log.motion.states(rows))
    columns = Y if basis is None else Y[:, :, list(basis.independent)]
    variance = np.einsum("tji,ik,tjk->j", columns, covariance, columns) / len(rows)
    gain = gain_points(log, dict(zip(log.motion.joints, (0.5 * variance).tolist(), strict=True)))
    if gain is not None and gain > MIN_GAIN_SHARE * log.errors.relative_error:
        yield MoreRecordings(len(identification.of_role("train")), gain=gain)


def _gain_of_joints(log: LogValidation, removed: Mapping[str, float], joints: Sequence[str]) -> float | None:
    return gain_points(log, {joint: removed.get(joint, 0.0) for joint in joints})


def _joints_with(causes: Mapping[str, tuple[Cause, ...]], kind: type[Cause]) -> tuple[str, ...]:
    return tuple(
        joint for joint, joint_causes in causes.items() if any(isinstance(cause, kind) for cause in joint_causes)
    )


def _sharpening_steps(identification: Identification) -> Iterator[Sharpen]:
    """Yield the motions that would improve the least accurate of the parameters that matter to the torque."""
    basis, errors = identification.base.on_data, identification.errors
    std = errors.std if basis is None else errors.base_std
    if basis is None:
        value, names = identification.estimate.value, identification.estimate.names
        leads: tuple[int, ...] = tuple(range(len(value)))
    else:
        value, names, leads = basis.to_base(identification.estimate.value), basis.groupings, basis.independent
    if std is None:
        return
    pairs = [(motion, subsample([motion], MAX_SAMPLES)[0]) for motion in identification.training_motions]
    columns = np.concatenate([identification.model.regressor(**motion.states(rows)) for motion, rows in pairs])
    torque = np.concatenate([motion.tau[rows] for motion, rows in pairs])
    # The torque of one standard error, relative to that of the training: parameters without effect do not matter.
    share = 100.0 * std * np.linalg.norm(columns, axis=(0, 1))[list(leads)] / (np.linalg.norm(torque) or 1.0)
    uncertain = np.flatnonzero((std > MIN_RELATIVE_STD * np.abs(value)) & (share > MIN_TORQUE_SHARE) & np.isfinite(std))
    worst = sorted(map(int, uncertain), key=lambda k: -share[k])[:MAX_PARAMETER_STEPS]
    gains = _gains_if_known(identification, columns, list(leads), worst, std)
    for k, gain in zip(worst, gains, strict=True):
        how, joint = _motion_for(identification, leads[k])
        needed = min(std[k] / (MIN_RELATIVE_STD * np.abs(value[k]) or np.inf), share[k] / MIN_TORQUE_SHARE)
        faster = float(np.sqrt(needed)) if how is ExcitingMotion.ACCELERATE else None
        figures = float(value[k]), float(std[k]), float(share[k])
        unit = identification.model.parameters[leads[k]].unit
        yield Sharpen(names[k], *figures, how, joint, faster, unit, gain=gain)


def _gains_if_known(
    identification: Identification, columns: Array, leads: list[int], parameters: Sequence[int], std: Array
) -> list[float | None]:
    """Return the gain in points, on the log that is judged, of knowing each of the parameters exactly.

    The others would change with it: with the covariance C of all, the torque Y C e_k / sqrt(C_kk) is then known,
    whose size is that by the standard error. C is taken from the regressor of the training, up to its scale.
    """
    log = judged_log(identification)
    (rows,) = subsample([log.motion], MAX_SAMPLES)
    motion = log.motion
    weight = identification.estimate.residual.sigma
    weight = 1.0 / np.where(weight > 0, weight, 1.0)
    # Columns scaled to norm one, so that the rank does not depend on the units of the parameters.
    X = (columns[:, :, leads] * weight[:, None]).reshape(-1, len(leads))
    size = np.linalg.norm(X, axis=0)
    size = np.where(size > 0, size, 1.0)
    C = np.linalg.pinv((X / size).T @ (X / size), rcond=RANK_TOLERANCE_GAINS, hermitian=True)
    Y = identification.model.regressor(**motion.states(rows))[:, :, leads] / size
    gains = []
    for k in parameters:
        torque = Y @ C[:, k] / (C[k, k] or np.inf) * size[k] * std[k]
        removed = np.mean(torque**2, axis=0)
        gains.append(gain_points(log, dict(zip(motion.joints, map(float, removed), strict=True))))
    return gains


def _motion_for(identification: Identification, column: int) -> tuple[ExcitingMotion, str | None]:
    """Return the motion that excites a parameter, which acts on the torque by position, velocity or acceleration."""
    model, n = identification.model, len(identification.model.joints)
    rng = np.random.default_rng(0)
    q, dq, ddq = rng.uniform(-1.0, 1.0, (3, 20, n))
    rest, memory = np.zeros_like(q), rng.uniform(-1.0, 1.0, (20, model.memory))
    # At rest only gravity acts, on starting also inertia: the difference tells which motion shows the parameter.
    full, standing, starting = (
        np.abs(model.regressor(q, *rates)[:, :, column])
        for rates in ((dq, ddq, memory), (rest, rest, 0 * memory), (rest, ddq, 0 * memory))
    )
    threshold = 1e-9 * full.max()  # a share, so that the unit does not count
    acting = [joint.name for joint, size in zip(model.joints, full.max(axis=0), strict=True) if size > threshold]
    joint = acting[-1] if acting else None
    if model.parameters[column].role not in ("viscous", "coulomb"):
        if standing.max() > threshold:
            return ExcitingMotion.MANY_POSES, joint
        if starting.max() > threshold:
            return ExcitingMotion.ACCELERATE, joint
    return ExcitingMotion.CONSTANT_SPEEDS, joint


MIN_ODD_RATIO = 4.0  # times the median squared residual of the parts of the training: one is looked at from here on
MAX_ODD_SHARE = 0.3  # share of the parts that are odd, at most: more are no exception
MIN_SIGNIFICANCE = 2.0  # standard errors over the parts
MIN_EXCESS = 1.05  # times the largest speed or acceleration of the training
MIN_SAMPLES_BEYOND = 20  # samples beyond
MAX_GAP = 0.3  # s: stretches this near to each other are one


def window_steps(identification: Identification) -> Iterator[NextStep]:
    """Yield which speeds to add to the training, and which seconds to leave out of it."""
    log = judged_log(identification)
    if log.role == "validation" and (step := _coverage_step(identification, log)) is not None:
        yield step
    parts = parts_of(identification)
    if parts.count < 3 or not parts.Z.shape[2] or not np.isfinite(parts.residual).all():
        return
    yield from _odd_parts(parts, log, [joint.name for joint in identification.model.joints])


def _odd_parts(parts: TrainingParts, log: LogValidation, joints: list[str]) -> Iterator[LeaveOut]:
    """Yield the part of the training that the others contradict, with its odd neighbours, if leaving it out helps."""
    size = np.bincount(parts.part, minlength=parts.count)
    if not size.all():  # of so short a training that a part of it has no sample
        return
    squares = parts.squares(parts.residual).sum(axis=1) / size
    is_odd = squares > MIN_ODD_RATIO * np.median(squares)
    if not is_odd.any() or is_odd.mean() > MAX_ODD_SHARE:
        return
    worst = first_odd = last_odd = int(np.argmax(squares))
    log_of_part = np.array([parts.log[parts.part == k][0] for k in range(parts.count)])
    # Neighbouring odd parts of the same log are one event.
    while first_odd > 0 and is_odd[first_odd - 1] and log_of_part[first_odd - 1] == log_of_part[worst]:
        first_odd -= 1
    while last_odd + 1 < parts.count and is_odd[last_odd + 1] and log_of_part[last_odd + 1] == log_of_part[worst]:
        last_odd += 1
    is_event = (np.arange(parts.count) >= first_odd) & (np.arange(parts.count) <= last_odd)
    out = is_event[parts.part]
    gain = _removal_gain(parts, out, log, joints)
    if gain is not None:
        t = parts.t[out]
        odd_mean, other_mean = (float(np.average(squares[k], weights=size[k])) for k in (is_event, ~is_event))
        yield LeaveOut(parts.names[log_of_part[worst]], float(t[0]), float(t[-1]), odd_mean / other_mean, gain=gain)


def _removal_gain(parts: TrainingParts, out: NDArray[np.bool_], log: LogValidation, joints: list[str]) -> float | None:
    """Return the gain in points, on the cross-validated residual of the others, of leaving the samples ``out`` (M) out.

    None where it is small or may be chance.
    """
    without, rows = parts.residual_without(out), ~out
    if not np.isfinite(without).all():
        return None
    before, after = parts.squares(parts.residual, rows), parts.squares(without, rows)
    change = (before - after).sum(axis=1)
    # Changes by part are nearly independent; their spread gives the error of the sum.
    has_rows = parts.squares(np.ones_like(parts.y), rows).sum(axis=1) > 0
    std = float(np.std(change[has_rows], ddof=1) * np.sqrt(has_rows.sum())) if has_rows.sum() > 1 else np.inf
    if not change.sum() > MIN_SIGNIFICANCE * std:
        return None
    mean = (before - after).sum(axis=0) / rows.sum() / parts.weight**2
    gain = gain_points(log, dict(zip(joints, map(float, mean), strict=True)))
    return gain if gain is not None and gain > MIN_GAIN_SHARE * log.errors.relative_error else None


def _coverage_step(identification: Identification, log: LogValidation) -> Cover | None:
    """Return the speeds of the held-out log beyond those of the training, if its error is larger there."""
    train = identification.training_motions
    motion = log.motion
    ratios = []
    for name in ("dq", "ddq"):
        largest = np.max([np.abs(getattr(x, name)[x.mask]).max(axis=0) for x in train], axis=0)
        ratios.append(np.abs(getattr(motion, name)) / np.where(largest > 0, largest, np.inf))
    # Accelerations grow with the square of the speed: both become a factor of speed.
    faster = np.maximum(ratios[0], np.sqrt(ratios[1]))
    beyond = (faster > MIN_EXCESS).any(axis=1) & motion.mask
    inside = motion.mask & ~beyond
    residual = np.where(motion.mask[:, None], motion.tau - log.predicted_torque, 0.0)
    if beyond.sum() < MIN_SAMPLES_BEYOND or inside.sum() < MIN_SAMPLES_BEYOND:
        return None
    error, other_error = (100.0 * np.linalg.norm(residual[rows]) / (np.linalg.norm(motion.tau[rows]) or np.inf)
                   for rows in (motion.mask, inside))  # fmt: skip
    if not error - other_error > MIN_GAIN_SHARE * error:
        return None
    squares = np.square(residual).sum(axis=1)
    # The joint that is beyond its training where most of the squared residual is.
    j = int(np.argmax(((faster > MIN_EXCESS) * squares[:, None])[beyond].sum(axis=0)))
    start, stop = _worst_stretch(motion.t, beyond, squares)
    factor = float(faster[beyond, j].max())
    speed = factor * max(float(np.abs(train_motion.dq[train_motion.mask, j]).max()) for train_motion in train)
    return Cover(log.name, start, stop, motion.joints[j], factor, speed, gain=float(error - other_error))


def _worst_stretch(t: Array, mask: NDArray[np.bool_], squares: Array) -> tuple[float, float]:
    """Return begin and end (s) of the stretch of chosen samples (N) with the largest sum of squares (N)."""
    rows = np.flatnonzero(mask)
    groups = np.split(rows, np.flatnonzero(np.diff(t[rows]) > MAX_GAP) + 1)
    worst = max(groups, key=lambda group: float(squares[group].sum()))
    return float(t[worst[0]]), float(t[worst[-1]])
