"""Excitation: how far, fast and often each joint moves, its limits, and the base parameters that are excited."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynident.checks import log_notes, motion_notes
from dynident.checks.misfit import FitCase, fit_case
from dynident.checks.motion_notes import OddLog
from dynident.checks.stamps import joint_errors, rms_error
from dynident.estimators.least_squares import solve_least_squares
from dynident.identification import held_joints
from dynident.models import Joint, Model
from dynident.models.robot_files import RobotJointLimits
from dynident.motion.log import Log, Motion
from dynident.regression import (
    MAX_REPEAT_DIFFERENCE,
    ParallelFilter,
    Regression,
    UnexcitedParameters,
    base_parameters,
    find_unexcited,
    repeat_of,
    structural_base_parameters,
)
from dynident.runtime import Finding
from dynident.runtime.arrays import Array

MAX_COMPENSATED_ERROR = 0.95  # of the error with gravity: with nearly none, a fit must be better by that much
MAX_GRAVITY_SHARE = 0.3  # share of gravity from which on it is not compensated
SHARE_STEP = 0.05  # of the share, for the curvature of the error
MAX_SAME_DATA_ERROR = 1e-4  # %, difference of logs that hold the same samples
MIN_ACCELERATION_SHARE = 1 / 3  # of the residual: less of the torque from accelerations does not show inertias
MAX_FIT_ERROR = 30.0  # %: what a fit leaves of a torque that another fault explains
TARGET_ACCELERATION_SHARE = 3.0  # times the residual: more shows them well
MAX_SHARED_SHARE = 0.1  # of a held-out log, that may be in the training
SHARED_SAMPLES = 10_000  # with which that is told
FRICTION_ROLES = ("viscous", "coulomb")
MIN_FRICTION_SHARE = 1.0  # %, of a joint's torque: drives and gears have several times this friction


def compensation_findings(regression: Regression) -> Iterator[Finding]:
    """Yield that the torque fits the model better with hardly any gravity, which was then compensated before logging.

    The share of gravity is fitted, with the parameters eliminated at each trial; its standard error assumes white
    residuals.
    """
    from scipy.optimize import minimize_scalar

    if not any(any(term.gravity or ()) for term in regression.model.terms):
        return

    def error(share: float) -> float:
        return rms_error(replace(regression, model=regression.model.with_gravity(lambda g: share * g)))

    before = rms_error(regression)
    if not error(0.0) < before:
        return
    # the share is near zero where gravity is compensated: search there only, and stop at the bounds
    bounds = (-MAX_GRAVITY_SHARE, MAX_GRAVITY_SHARE)
    factor = float(minimize_scalar(error, bounds=bounds, method="bounded", options={"xatol": 1e-3}).x)
    after = error(factor)
    if abs(factor) > 0.9 * MAX_GRAVITY_SHARE or after > MAX_COMPENSATED_ERROR * before:
        return
    # the standard error follows from the curvature of the squared error, by a second difference
    sides = error(factor - SHARE_STEP) ** 2 + error(factor + SHARE_STEP) ** 2
    curvature = max((sides - 2 * after**2) / SHARE_STEP**2, 1e-12)
    count = regression.usable_samples * len(regression.model.joints)
    std = float(after * np.sqrt(2 / (count * curvature)))
    yield Finding(log_notes.GravityCompensated(factor, std, before, after))


def friction_findings(regression: Regression) -> Iterator[Finding]:
    """Yield that no joint shows the friction that the model has: the torque is then not that of the drives."""
    roles = np.array([parameter.role for parameter in regression.model.parameters])
    factors = regression.triangular_factors.factors
    size = np.square(factors[:, :, -1]).sum(axis=1)
    is_excited = all(factors[:, :, np.flatnonzero(roles == role)].any() for role in FRICTION_ROLES)
    # without excited friction, or with a poor fit, the test would say nothing
    if not is_excited or not size.all() or (joint_errors(regression) > MAX_FIT_ERROR).any():
        return
    # weigh each joint by the size of its torque, so that weak joints count as much as strong ones
    theta = solve_least_squares(regression.triangular_factors.stack(1 / np.sqrt(size))).value
    torque = factors[:, :, :-1] @ np.where(np.isin(roles, FRICTION_ROLES), theta, 0.0)
    share = 100.0 * np.sqrt(np.square(torque).sum(axis=1) / size)
    if (share < MIN_FRICTION_SHARE).all():
        yield Finding(log_notes.NoFriction(float(share.max())))


def slow_findings(regression: Regression) -> Iterator[Finding]:
    """Yield that accelerations explain less of every joint's torque than a third of the residual."""
    # the share of the accelerations is what the error grows by when they are set to zero
    static_motions = tuple(replace(motion, ddq=np.zeros_like(motion.ddq)) for motion in regression.motions)
    full_error, static_error = joint_errors(regression), joint_errors(replace(regression, motions=static_motions))
    share = np.sqrt(np.maximum(static_error**2 - full_error**2, 0.0))
    has_torque = regression.triangular_factors.factors[:, :, -1].any(axis=1)
    # all joints must be slow: the advice is to repeat the whole motion faster
    is_slow = (full_error < MAX_FIT_ERROR) & (share < MIN_ACCELERATION_SHARE * full_error)
    if has_torque.any() and is_slow[has_torque].all():
        k = int(np.argmax(np.where(has_torque, share / np.maximum(full_error, 1e-12), -1.0)))
        speed_factor = float(np.sqrt(TARGET_ACCELERATION_SHARE * full_error[k] / max(share[k], 1e-3 * full_error[k])))
        yield Finding(log_notes.SlowMotion(float(share[k]), float(full_error[k]), speed_factor))


def repeat_findings(logs: Mapping[str, Mapping[str, Log]]) -> Iterator[Finding]:
    """Yield the held-out logs that hold samples of the training, or repeat one of its motions, at any lag."""
    for name, held_out_log in logs.get("validation", {}).items():
        for train_name, log in logs.get("train", {}).items():
            repeat = repeat_of(held_out_log, log.select(held_out_log.joints))
            if repeat.error < MAX_SAME_DATA_ERROR:
                yield Finding(log_notes.SameData(train_name, repeat.lag), source=name)
                break
            if (share := _shared_share(held_out_log, log.select(held_out_log.joints))) > MAX_SHARED_SHARE:
                yield Finding(log_notes.SharedSamples(train_name, share), source=name)
                break
            if repeat.error < MAX_REPEAT_DIFFERENCE:
                yield Finding(log_notes.RepeatedMotion(train_name, repeat.lag, repeat.error), source=name)
                break


def _shared_share(first: Log, second: Log) -> float:
    """Return the share of the samples of the first log in motion that the second one holds, too."""

    def samples_in_motion(log: Log) -> NDArray[np.void]:
        rows = np.column_stack([log.q, log.tau])[1:][np.any(np.diff(log.q, axis=0), axis=1)]
        return np.ascontiguousarray(rows).view(np.dtype((np.void, rows.shape[1] * rows.itemsize))).ravel()

    samples = samples_in_motion(first)
    samples = samples[:: max(len(samples) // SHARED_SAMPLES, 1)]
    return float(np.isin(samples, samples_in_motion(second)).mean()) if len(samples) else 0.0


SLOW_SPEED_SHARE = 0.02  # of the peak speed: below, a joint hardly moves
LIMIT_TOLERANCE = 1.02  # x the limit
RANGE_TOLERANCE = 0.02  # share of the range (or rad, m) past a limit of position
MAX_RANGE_RATIO = 10.0  # times the range that the file allows: beyond, the unit is wrong, or the range
MIN_PEAK_SPEED = 1e-3  # rad/s or m/s: peak speed of a joint that moves at all
MIN_REVERSALS = 2  # reversals below which friction and offset are strongly correlated
MAX_CONDITION = 1e4  # condition number of the base parameters above which they are strongly correlated


@dataclass(frozen=True)
class Excitation:
    """How a joint moves over all training motions, in rad or m and s.

    ``peak`` and ``rms`` of velocity and acceleration (the peak is the 99.9th percentile), ``reversals`` of direction,
    and the share of samples that are ``slow``, below 2 % of the peak velocity; ``torque`` is the peak effort.
    """

    joint: str
    lower: float
    upper: float
    peak_speed: float
    rms_speed: float
    peak_acceleration: float
    rms_acceleration: float
    reversals: int
    slow: float
    torque: float


def excitation(motions: Sequence[Motion], joint: str) -> Excitation:
    """Return how a joint moves in the usable samples of all motions."""
    rows = [(motion, motion.joints.index(joint)) for motion in motions]
    q, dq, ddq, tau = (
        np.concatenate([getattr(motion, name)[:, j][motion.mask] for motion, j in rows])
        for name in ("q", "dq", "ddq", "tau")
    )
    peak = _peak(dq)
    # the sign of a speed below a share of the peak is that of noise
    fast = [x[np.abs(x) > SLOW_SPEED_SHARE * peak] for x in (motion.dq[:, j][motion.mask] for motion, j in rows)]
    return Excitation(
        joint=joint,
        lower=float(q.min()),
        upper=float(q.max()),
        peak_speed=peak,
        rms_speed=_rms(dq),
        peak_acceleration=_peak(ddq),
        rms_acceleration=_rms(ddq),
        reversals=sum(int(np.count_nonzero(np.diff(np.sign(x)))) for x in fast),
        slow=float(np.mean(np.abs(dq) < SLOW_SPEED_SHARE * peak)) if peak > 0 else 1.0,
        torque=_peak(tau),
    )


def _peak(x: Array) -> float:
    """Return the 99.9th percentile of the absolute value, which ignores single outliers."""
    return float(np.percentile(np.abs(x), 99.9))


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(x**2)))


def hardly_moving_findings(excitations: Sequence[Excitation], model: Model) -> Iterator[Finding]:
    """Yield the joints that a controller holds and that hardly move: friction cannot be identified from these."""
    reach, kinds = np.array([facts.upper - facts.lower for facts in excitations]), [x.kind for x in model.joints]
    for facts, joint, is_held in zip(excitations, model.joints, held_joints(reach, kinds), strict=True):
        if is_held and facts.upper > facts.lower:  # of one that never moves, its log says so
            largest = max(x for x, kind in zip(reach.tolist(), kinds, strict=True) if kind == joint.kind)
            size, middle = facts.upper - facts.lower, (facts.lower + facts.upper) / 2
            yield Finding(motion_notes.HardlyMoves(size, largest, middle, joint.unit), facts.joint)


def limit_findings(facts: Excitation, limits: RobotJointLimits | None, joint: Joint) -> Iterator[Finding]:
    """Yield warnings: few reversals, limits of the robot file exceeded."""
    if facts.reversals < MIN_REVERSALS and facts.peak_speed > MIN_PEAK_SPEED:
        yield Finding(motion_notes.FewReversals(facts.reversals), facts.joint)
    if limits is None:
        return
    yield from _position_findings(facts, limits, joint)
    if limits.velocity is not None and 0 < LIMIT_TOLERANCE * limits.velocity < facts.peak_speed:
        yield Finding(motion_notes.VelocityAboveLimit(facts.peak_speed, limits.velocity), facts.joint)
    yield from _effort_findings(facts, limits, joint.effort)


def _position_findings(facts: Excitation, limits: RobotJointLimits, joint: Joint) -> Iterator[Finding]:
    if limits.lower is None or limits.upper is None or limits.lower >= limits.upper:
        return
    slack = RANGE_TOLERANCE * max(limits.upper - limits.lower, 1.0)
    # a joint stands the same after a whole turn: an encoder from 0 to 360 degrees has 350 for -10
    offset = (facts.lower + facts.upper - limits.lower - limits.upper) / 2
    turn = math.copysign(2 * math.pi, offset) if joint.kind == "revolute" and abs(offset) > math.pi else 0.0
    if facts.lower - turn < limits.lower - slack or facts.upper - turn > limits.upper + slack:
        is_far = facts.upper - facts.lower > MAX_RANGE_RATIO * (limits.upper - limits.lower)
        note = motion_notes.PositionBeyondLimits(facts.lower, facts.upper, limits.lower, limits.upper, is_far)
        yield Finding(note, facts.joint)


def _effort_findings(facts: Excitation, limits: RobotJointLimits, unit: str) -> Iterator[Finding]:
    limit = limits.effort
    if limit is None or limit <= 0:
        return
    if facts.torque > LIMIT_TOLERANCE * limit:
        above = motion_notes.EffortAboveLimit(facts.torque, limit, unit, far=facts.torque > 3 * limit)
        yield Finding(above, facts.joint)
    elif 0 < facts.torque < 1e-3 * limit:  # a torque of zero is a dead channel
        yield Finding(motion_notes.EffortFarBelowLimit(facts.torque, limit, unit), facts.joint)


@dataclass(frozen=True)
class ExcitedRank:
    """Rank and condition of the parameters of a model in the training motions.

    ``missing`` are the base parameters that the motions do not excite. ``count`` is the number of parameters,
    ``on_data`` the rank in these motions, ``structural`` the largest rank of any motion; ``condition`` is the
    condition number of the base parameters, with scaled columns.
    """

    count: int
    on_data: int
    structural: int
    condition: float
    missing: tuple[UnexcitedParameters, ...]


def excited_rank(model: Model, regression: Regression, unfitted: Collection[str] = ()) -> ExcitedRank:
    """Return the rank on the data and the structural rank; torques of ``unfitted`` joints are not fitted."""
    on_data = base_parameters(regression.triangular_factors.stack(), model.parameters)
    structural = structural_base_parameters(model, unfitted=unfitted)
    values = on_data.singular_values
    condition = float(values[0] / values[on_data.rank - 1]) if on_data.rank else float("inf")
    missing = find_unexcited(structural, on_data, model, regression.motions)
    return ExcitedRank(len(model.parameters), on_data.rank, structural.rank, condition, missing)


def rank_findings(rank: ExcitedRank) -> Iterator[Finding]:
    """Yield the base parameters that the motions do not excite, and the joints to move."""
    yield from map(Finding, rank.missing)
    if rank.condition > MAX_CONDITION and not rank.missing:
        yield Finding(motion_notes.CorrelatedParameters(rank.on_data, rank.condition))


ODD_LOG_SAMPLES = 1000  # of all motions, up to twice as many
MIN_ROWS_PER_PARAMETER = 5  # equations of a log for each parameter: fewer are explained by any fit of their own
MIN_COMMON_ERROR = 2.0  # %, of the torque: a smaller error of all logs together is none
RANK_TOLERANCE = 1e-7  # share of the largest singular value below which the data say nothing
# times that error: with a fit of its own for the odd log it is below; real robots have 0.86 and more
MAX_ODD_ERROR_RATIO = 0.6


def odd_log_findings(
    model: Model,
    motions: Sequence[Motion],
    held_out: Mapping[str, Motion],
    parallel_filter: ParallelFilter | None = None,
    min_speed: tuple[float, ...] | None = None,
) -> Iterator[Finding]:
    """Yield the log that, fitted on its own, lets plain least squares leave far less of all torques.

    Of two logs it is the second. Errors are root mean squares over the joints, so that small torques count as
    much as large ones. Each fit is judged by the samples it is made of, so that noise in one log, or a motion
    that the others do not excite, makes it no odd one.
    """
    # a log needs several times as many equations as parameters, or its own fit explains anything
    min_samples = MIN_ROWS_PER_PARAMETER * len(model.parameters) // len(model.joints)
    # of a log without torque more is said elsewhere
    all_motions = (*motions, *held_out.values())
    logs = [x for x in all_motions if x.mask.sum() >= min_samples and x.tau[x.mask].any()]
    if len(logs) < 2:
        return
    samples = max(ODD_LOG_SAMPLES, min_samples * len(logs))
    factors = _log_factors(fit_case(model, logs, parallel_filter, min_speed, samples))
    torque = float(np.linalg.norm(np.concatenate([factor[:, -1] for factor in factors])))
    before = 100.0 * _residual_norm(factors) / (torque or np.inf)
    if not before > MIN_COMMON_ERROR:
        return
    # the error of each split into one log and all others, from the triangular factors without the samples
    parts = [([*factors[:k], *factors[k + 1 :]], [factors[k]]) for k in range(len(logs))]
    separate_errors = [np.hypot(_residual_norm(others), _residual_norm(single)) for others, single in parts]
    odd = int(np.argmin(separate_errors)) if len(logs) > 2 else 1
    after = 100.0 * float(separate_errors[odd]) / torque
    if after < MAX_ODD_ERROR_RATIO * before:
        yield Finding(OddLog(before, after), source=logs[odd].source)


def _log_factors(case: FitCase) -> list[Array]:
    """Return for each log the triangular factor (k, p + 1) of regressor and torque.

    The rows of each joint are divided by the rms of its torque in all logs.
    """
    size = np.sqrt((case.tau**2 * case.keep).sum(axis=0) / np.maximum(case.keep.sum(axis=0), 1))
    weight = case.keep / np.where(size > 0, size, np.inf)
    Y = case.model.regressor(**case.states)
    X = np.concatenate([Y, case.tau[:, :, None]], axis=2) * weight[:, :, None]
    parts = np.split(X, np.cumsum(case.lengths)[:-1])
    return [np.asarray(np.linalg.qr(rows.reshape(-1, rows.shape[2]), mode="r")) for rows in parts]


def _residual_norm(factors: Sequence[Array]) -> float:
    """Return the norm of the torque that one fit to all of these logs leaves."""
    stacked = np.concatenate(factors)
    A, y = stacked[:, :-1], stacked[:, -1]
    # scale the columns, so that the rank tolerance does not depend on units
    scale = np.linalg.norm(A, axis=0)
    A = A / np.where(scale > 0, scale, 1.0)
    return float(np.linalg.norm(y - A @ np.linalg.lstsq(A, y, rcond=RANK_TOLERANCE)[0]))
