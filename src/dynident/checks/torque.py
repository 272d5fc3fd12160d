"""Sign and scale of the measured torque relative to that of the robot file's inertias, reported as questions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynident.checks import file_notes
from dynident.checks.motion_notes import LoopDiffers, LoopGain, LoopVelocity
from dynident.models import INERTIAL, Model
from dynident.models.simulation import DifferencingLoop, HasTimes, longest_stretch
from dynident.motion.log import Controller, HasState, Log, Motion, subsample
from dynident.motion.smoothers import Spline, smooth_log
from dynident.runtime import DynidentError, Finding
from dynident.runtime.arrays import Array

# of a log, at which a controller is asked; in a row, of one that remembers
MAX_LOOP_SAMPLES, MAX_STATEFUL_SAMPLES = 1000, 5000
MIN_LOOP_SAMPLES = 10  # samples, of which nothing is told
VELOCITY_STEPS = range(11)  # of a drive, over which its velocity may be a difference; 0 where it is faster than is said
# of the error, which another velocity or factor must leave at most
MAX_VELOCITY_ERROR_RATIO, MAX_SCALED_ERROR_RATIO = 0.65, 0.5
# by how much a factor must differ from 1 to be named, and what it may leave of the torque
MIN_FACTOR_DEVIATION, MAX_SCALED_SHARE = 0.05, 0.2
MIN_DIFFERENCE_SHARE = 0.5  # share of the torque above which a controller is another one
MIN_NOISE_RATIO = 3.0  # times what the noise of the positions explains of that


@dataclass(frozen=True, eq=False)
class _ControllerTorques:
    """Torques (K, n) along a motion: the measured ones, and those that the controller commands, by number of steps.

    ``noise`` (n) is the root mean square change of the command by the noise of the positions.
    """

    tau: Array
    by_steps: dict[int, Array]
    noise: Array

    def error(self, steps: int, factor: Array | float = 1.0) -> Array:
        """Return the root mean squares (n) of measured minus commanded torque, with a ``factor`` (n) on the command."""
        return np.asarray(np.sqrt(np.mean(np.square(self.tau - factor * self.by_steps[steps]), axis=0)))


def loop_findings(logs: Sequence[Log]) -> Iterator[Finding]:
    """Yield what differs between the controllers that logs name and those that ran.

    That is the velocity that they see, a factor on a joint's torque, or all of it.
    """
    for log in logs:
        if log.controller is None or log.controller.joints != log.joints:
            continue
        try:
            with np.errstate(all="ignore"):  # what is not finite is left to the simulation, too
                torques = _command_torques(log, log.controller)
                steps = log.controller.steps if isinstance(log.controller, DifferencingLoop) else 1
        except DynidentError:  # the simulation says it
            continue
        if len(torques.tau) > MIN_LOOP_SAMPLES and np.isfinite(list(torques.by_steps.values())).all():
            yield from _controller_findings(log, torques, steps)


def _controller_findings(log: Log, torques: _ControllerTorques, configured_steps: int) -> Iterator[Finding]:
    size = np.sqrt(np.mean(np.square(torques.tau), axis=0))
    has_torque = size > 0
    if not has_torque.any():
        return
    # over how many steps the drives difference positions; it must be clearly better than the given number
    shares = {steps: torques.error(steps)[has_torque] / size[has_torque] for steps in torques.by_steps}
    total = {steps: float(np.sqrt(np.mean(np.square(share)))) for steps, share in shares.items()}
    best = min(total, key=lambda steps: total[steps])
    if total[best] > MAX_VELOCITY_ERROR_RATIO * total[configured_steps]:
        best = configured_steps
    else:
        yield Finding(LoopVelocity(configured_steps, best, total[configured_steps], total[best]), source=log.source)
    # then fit a factor of each joint's command: the least squares slope
    commanded, error = torques.by_steps[best], torques.error(best)
    power = np.sum(commanded**2, axis=0)
    factor = np.where(power > 0, np.sum(commanded * torques.tau, axis=0) / np.where(power > 0, power, 1.0), 1.0)
    scaled_error = torques.error(best, factor)
    for j in np.flatnonzero(has_torque):
        name, share = log.joints[j], float(error[j] / size[j])
        limit = min(MAX_SCALED_ERROR_RATIO * error[j], MAX_SCALED_SHARE * size[j])
        if abs(factor[j] - 1.0) > MIN_FACTOR_DEVIATION and scaled_error[j] < limit:
            yield Finding(LoopGain(float(factor[j]), share, float(scaled_error[j] / size[j])), name, source=log.source)
        elif share > MIN_DIFFERENCE_SHARE and error[j] > MIN_NOISE_RATIO * torques.noise[j]:
            yield Finding(LoopDiffers(share), name, source=log.source)


def _command_torques(log: Log, controller: Controller) -> _ControllerTorques:
    """Return the torques that a controller commands along the smoothed motion of a log.

    They are computed for each number of velocity steps.
    """
    loop = controller.loop if isinstance(controller, DifferencingLoop) else controller
    motion = smooth_log(Spline(), log)
    # steps are those of the controller, which may be faster than the log
    times = controller.t if isinstance(controller, HasTimes) and len(controller.t) > 1 else log.t
    period = float(np.median(np.diff(times)))
    if isinstance(loop, HasState):  # without gaps, over which its state would be unknown
        rows = np.arange(len(motion))[longest_stretch(motion)][:MAX_STATEFUL_SAMPLES]
    else:
        rows = np.flatnonzero(motion.mask)
        rows = rows[:: max(len(rows) // MAX_LOOP_SAMPLES, 1)]
    if len(rows) <= MIN_LOOP_SAMPLES:
        return _ControllerTorques(motion.tau[rows], {}, np.zeros(len(log.joints)))
    by_steps = {steps: _loop_torques(loop, motion, rows, motion.q[rows], steps * period) for steps in VELOCITY_STEPS}
    # the measured positions instead of the smoothed ones show how much noise the controller passes on
    noisy = _loop_torques(loop, motion, rows, log.q[rows], period)
    noise = np.sqrt(np.mean(np.square(noisy - by_steps[1]), axis=0))
    return _ControllerTorques(motion.tau[rows], by_steps, noise)


def _loop_torques(loop: Controller, motion: Motion, rows: NDArray[np.intp], q: Array, difference_time: float) -> Array:
    """Return the torques (K, n) that a controller commands at positions q (K, n).

    The velocity is that of a difference over ``difference_time`` (s) before each sample, so that of its middle.
    """
    t = motion.t[rows]
    dq = np.column_stack([np.interp(t - difference_time / 2, motion.t, velocity) for velocity in motion.dq.T])
    # without a state the samples are independent; with one they must be passed in their order
    torques = np.empty_like(q)
    if not isinstance(loop, HasState):
        for k, time in enumerate(t.tolist()):
            torques[k] = loop(time, q[k], dq[k])
        return torques
    gaps = np.diff(t, prepend=2 * t[0] - t[1]).tolist()
    state = loop.begin(float(t[0]), gaps[0], q[0], dq[0], motion.tau[rows[0]])
    for k, (time, gap) in enumerate(zip(t.tolist(), gaps, strict=True)):
        torques[k], state = loop.advance(time, gap, q[k], dq[k], state)
    return torques


AGREEMENT_SAMPLES = 2000  # of all motions: enough to see a sign
# a smaller |correlation| counts as none, where the nominal torque is over so many times the measured one
MAX_UNRELATED_CORRELATION, MIN_UNRELATED_RATIO = 0.3, 2.0
MIN_SIGN_CORRELATION = 0.6  # partial correlation from which a sign is trusted
MAX_SCALE = 3.0  # factor from which a scale is questioned, where the correlation is beyond STRONG
MIN_SCALE_CORRELATION = 0.85
# share of the nominal torque that rotor and friction cannot explain, below which nothing is compared
MIN_INDEPENDENT_SHARE = 1e-3
MIN_DRIVING_SHARE = 0.2  # share of rms torque times rms speed by which friction must drive the joint, to count


@dataclass(frozen=True)
class Agreement:
    """The measured torque of one joint compared with the nominal one; ``scale`` times the nominal torque fits best.

    ``scale`` and ``correlation`` (partial) are taken with friction, rotor inertia and offset projected out; both
    are nan where the file has no inertias; ``balanced`` is the correlation with a spring or counterbalance of this
    joint projected out as well. ``rotor`` (kg m^2 or kg) and ``friction``, the share of the power
    dissipated by friction, are those of a fit of this joint alone. ``asked`` is the rms of the nominal over the
    measured torque.
    """

    joint: str
    scale: float
    correlation: float
    rotor: float
    friction: float
    asked: float = float("nan")
    balanced: float = float("nan")


def agreement(model: Model, motions: Sequence[Motion]) -> tuple[Agreement, ...]:
    """Return for each joint of the model how its measured torque agrees with the nominal one."""
    q, dq, ddq, tau = thin_samples(motions)
    file_torque = torque_or_zero(model, q, dq, ddq)
    agreements = []
    for j, joint in enumerate(model.joints):
        # sine and cosine of the angle stand for gravity, so that this joint alone gives rotor inertia and friction
        gravity_columns = (np.sin(q[:, j]), np.cos(q[:, j])) if joint.kind == "revolute" else ()
        columns = nuisance_columns(q, dq, ddq, j)
        has_nominal = np.ptp(file_torque[:, j]) > 0
        coefficients = np.linalg.lstsq(np.column_stack([columns, *gravity_columns]), tau[:, j])[0]
        friction_power = coefficients[1] * np.mean(dq[:, j] ** 2) + coefficients[2] * np.mean(columns[:, 2] * dq[:, j])
        power = rms_speed(dq)[j] * max(float(np.sqrt(np.mean(tau[:, j] ** 2))), 1e-300)
        compared = _partial_regression(file_torque[:, j], tau[:, j], columns) if has_nominal else (np.nan,) * 3
        balance = np.column_stack([columns, *gravity_columns, q[:, j]])
        balanced = _partial_regression(file_torque[:, j], tau[:, j], balance)[1] if has_nominal else np.nan
        scale, correlation, ratio = map(float, compared)
        rotor, friction = float(coefficients[0]), float(friction_power / power)
        agreements.append(Agreement(joint.name, scale, correlation, rotor, friction, ratio, balanced))
    return tuple(agreements)


def rms_speed(dq: Array) -> Array:
    """Return the rms velocity (n) of each joint, more than zero."""
    return np.asarray(np.maximum(np.sqrt(np.mean(dq**2, axis=0)), 1e-12))


def nuisance_columns(q: Array, dq: Array, ddq: Array, joint: int) -> Array:
    """Return the regressor columns (M, 4) of rotor inertia, viscous and Coulomb friction, and offset of a joint."""
    # a smooth sign, as the sign of a noisy velocity near zero is noise
    sign = np.tanh(dq[:, joint] / (0.05 * rms_speed(dq)[joint]))
    return np.column_stack([ddq[:, joint], dq[:, joint], sign, np.ones(len(q))])


def thin_samples(motions: Sequence[Motion]) -> tuple[Array, ...]:
    """Return q, dq, ddq, tau (M, n) of a few thousand usable samples of all motions."""
    pairs = list(zip(motions, subsample(motions, AGREEMENT_SAMPLES), strict=True))
    return tuple(
        np.concatenate([getattr(motion, name)[rows] for motion, rows in pairs]) for name in ("q", "dq", "ddq", "tau")
    )


def nominal_torque(model: Model, q: Array, dq: Array, ddq: Array) -> Array | None:
    """Return the torque (M, n) of the inertias of the robot file, None where it does not give all of them."""
    values = [parameter.value if parameter.role in INERTIAL else 0.0 for parameter in model.parameters]
    if any(value is None for value in values):
        return None
    return model.torque(q, dq, ddq, np.array(values, dtype=float), np.zeros((len(q), model.memory)))


def torque_or_zero(model: Model, q: Array, dq: Array, ddq: Array) -> Array:
    """Return the torque (M, n) of ``nominal_torque``, zeros where there is none."""
    torque = nominal_torque(model, q, dq, ddq)
    return np.zeros_like(q) if torque is None else torque


def project_out(series: Array, columns: Array) -> Array:
    """Return ``series`` minus its projection on the columns."""
    return np.asarray(series - columns @ np.linalg.lstsq(columns, series)[0])


def _partial_regression(x: Array, y: Array, columns: Array) -> tuple[float, float, float]:
    """Return slope, correlation and relative size of x against y, with the columns projected out of both."""
    x_residual, y_residual = (project_out(series, columns) for series in (x, y))
    a, b = float(np.linalg.norm(x_residual)), float(np.linalg.norm(y_residual))
    # where the nominal torque is almost that of rotor and friction there is nothing to compare
    if a < MIN_INDEPENDENT_SHARE * float(np.linalg.norm(x)) or b == 0:
        return (float("nan"),) * 3
    inner = float(x_residual @ y_residual)
    return inner / a**2, inner / (a * b), a / b


def agreement_findings(entry: Agreement, unit: str) -> Iterator[Finding]:
    """Yield a question where the sign or scale of a torque looks wrong; ``unit`` is that of the torque."""
    # friction that drives the joint, and a negative rotor inertia, show a reversed sign, too
    is_driven = not entry.correlation > 0 and entry.rotor < 0 and entry.friction < -MIN_DRIVING_SHARE
    # with a spring or counterbalance beside it the torque is that of the file
    if entry.balanced > MIN_SIGN_CORRELATION and not entry.correlation > MAX_UNRELATED_CORRELATION:
        return
    if entry.correlation < -MIN_SIGN_CORRELATION or is_driven:
        yield Finding(file_notes.ReversedSign(None if is_driven else entry.correlation), entry.joint)
    elif entry.correlation > MIN_SCALE_CORRELATION and not 1 / MAX_SCALE < entry.scale < MAX_SCALE:
        yield Finding(file_notes.OddScale(entry.scale, unit), entry.joint)
    elif abs(entry.correlation) < MAX_UNRELATED_CORRELATION and entry.asked > MIN_UNRELATED_RATIO:
        yield Finding(file_notes.UnrelatedTorque(entry.asked, entry.correlation), entry.joint)


JACKKNIFE_BLOCKS = 10  # of the time, left out in turn for the standard error
MAX_RELATIVE_STD = 0.2  # standard error over gain, from which a gain is not given


@dataclass(frozen=True)
class RelativeGain:
    """The factor that turns a recorded value into a torque (N m or N) of the file's bodies, and its standard error.

    The standard error is by the jackknife over ten blocks of time; it does not include errors of the file's
    masses.
    """

    value: float
    std: float


def relative_gains(model: Model, motions: Sequence[Motion]) -> dict[str, RelativeGain]:
    """Return by joint the gain with which the recorded ``tau`` agrees with the torque of the file's bodies.

    The recorded value is fitted joint by joint as a multiple of the torque of the file's inertias, with rotor
    inertia, viscous and Coulomb friction and an offset beside it. Joints are left out whose motion does not show
    the gain: where the correlation (with the rest projected out) is below 0.85, or the standard error over a
    fifth. All are left out where the file has no inertias.
    """
    agreements = agreement(model, motions)
    # the jackknife leaves out each block of time in turn, as neighbouring samples are correlated
    parts = [agreement(model, [_drop_block(motion, k) for motion in motions]) for k in range(JACKKNIFE_BLOCKS)]
    gain_by_joint = {}
    for j, entry in enumerate(agreements):
        scales = np.array([part[j].scale for part in parts])
        if not (abs(entry.correlation) > MIN_SCALE_CORRELATION and np.isfinite(scales).all() and scales.all()):
            continue
        gains = 1.0 / scales
        std = float(np.sqrt((JACKKNIFE_BLOCKS - 1) / JACKKNIFE_BLOCKS * np.sum((gains - gains.mean()) ** 2)))
        if std < MAX_RELATIVE_STD / abs(entry.scale):
            gain_by_joint[entry.joint] = RelativeGain(1.0 / entry.scale, std)
    return gain_by_joint


def _drop_block(motion: Motion, block: int) -> Motion:
    """Return the motion with one block of its time masked out."""
    blocks = np.floor(JACKKNIFE_BLOCKS * np.arange(len(motion)) / len(motion))
    return replace(motion, mask=motion.mask & (blocks != block))
