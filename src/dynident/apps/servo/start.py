"""The start of a servo fit: the controllers' torques explained by inverse dynamics, for each delay of a scan."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dynident.apps.servo.plant import ServoLog, ServoPlant, import_mujoco
from dynident.apps.servo.values import ServoValues
from dynident.motion.filters import butterworth, zero_phase
from dynident.runtime import InputError, Noun
from dynident.runtime.arrays import Array

MAX_DELAY = 0.2  # s
DELAY_STEP = 0.004  # s, of the scan
CUTOFF = 6.0  # Hz, of the low-pass that positions and torques pass alike
MIN_SPEED = 0.05  # rad/s or m/s, below which the sign of dry friction is unsure
MIN_KP, MAX_KP = 1e-2, 1e5  # N m/rad, N/m
MIN_SAMPLES = 20  # of a recording, and of the motion of a joint
MIN_DURATION = 0.8  # s of a recording: its first 0.5 s are not compared
FLOORS = (1e-6, 1e-6, 1e-6)  # kg m^2, N m s, N m: the least that a search starts from


class StateWindows(Noun):
    """Samples ``starts`` to ``stops`` of a recording that are simulated anew from states that are found, too.

    ``bases`` span by window what its state changes: orthonormal columns (m n, 2 n) over m samples of n joints.
    """

    starts: tuple[int, ...]
    stops: tuple[int, ...]
    bases: tuple[Array, ...]


class SmoothLog(Noun):
    """A recording on an even grid: t (N), smooth positions, speeds and accelerations (N, n), and the raw positions.

    It is simulated as a whole, or in ``windows``.
    """

    log: ServoLog
    t: Array
    raw: Array
    q: Array
    dq: Array
    ddq: Array
    sections: Array
    windows: StateWindows | None = None

    def smooth(self, x: Array) -> Array:
        """Return x (N, n) behind the low-pass of the positions."""
        return zero_phase(self.sections, np.ascontiguousarray(x.T), _pad(len(x))).T

    @property
    def speeds(self) -> Array:
        """The speeds (N, n) at the stamps of the recording."""
        return np.column_stack([np.interp(self.log.t, self.t, column) for column in self.dq.T])


def _pad(n: int) -> int:
    return min(100, n - 1)


def smooth_servo_log(log: ServoLog) -> SmoothLog:
    """Return a recording behind a low-pass, with its derivatives; InputError for one that is too short."""
    step = float(np.median(np.diff(log.t)))
    t = np.arange(log.t[0], log.t[-1] + step / 2, step)
    if len(t) < MIN_SAMPLES or t[-1] - t[0] < MIN_DURATION:
        raise InputError(
            f"{log.name}: has {len(t)} samples in {log.t[-1] - log.t[0]:.3g} s; a servo fit needs "
            f"at least {MIN_SAMPLES} in {MIN_DURATION:g} s."
        )
    raw = np.column_stack([np.interp(t, log.t, column) for column in log.q.T])
    sections = butterworth(4, min(CUTOFF, 0.2 / step), 1 / step)
    q = zero_phase(sections, np.ascontiguousarray(raw.T), _pad(len(t))).T
    dq = np.gradient(q, step, axis=0)
    return SmoothLog(log, t, raw, q, dq, np.gradient(dq, step, axis=0), sections)


def rigid_torques(plant: ServoPlant, values: ServoValues, motion: SmoothLog) -> Array:
    """Return the torques (N, n) that the bodies of the file need, without armature, damping, friction and contact."""
    mujoco = import_mujoco()
    model = copy.copy(plant.model)
    model.body_mass[plant.bodies] *= values.mass
    model.body_inertia[plant.bodies] *= values.mass[:, None]
    model.dof_armature[plant.dofs] = model.dof_damping[plant.dofs] = model.dof_frictionloss[plant.dofs] = 0.0
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_ACTUATION
    data = mujoco.MjData(model)
    torques = np.empty(motion.q.shape)
    for k in range(len(motion.t)):
        data.qpos[plant.positions] = motion.q[k] - values.offset
        data.qvel[plant.dofs], data.qacc[plant.dofs] = motion.dq[k], motion.ddq[k]
        mujoco.mj_inverse(model, data)
        torques[k] = data.qfrc_inverse[plant.dofs]
    return torques


def start_values(
    plant: ServoPlant, motions: Sequence[SmoothLog], values: ServoValues, *, free_delay: bool
) -> ServoValues:
    """Return the values that explain the controllers' torques best, with the delay of a scan (``free_delay``).

    A kp that is nan is found by the torques of the bodies, one for all such joints.
    """
    rigid = [rigid_torques(plant, values, motion) for motion in motions]
    delays = np.arange(0.0, MAX_DELAY, DELAY_STEP) if free_delay else np.array([values.delay])
    commands = [[late_commands(motion, float(delay)) for motion in motions] for delay in delays]
    unknown = np.isnan(values.kp)
    if unknown.any():
        kp = max((_common_kp(motions, rigid, delayed, unknown) for delayed in commands), key=lambda pair: pair[1])[0]
        values = replace(values, kp=np.where(unknown, kp, values.kp))
    fits = [_linear_fit(motions, rigid, values, delayed, plant.joints) for delayed in commands]
    costs = np.array([cost for cost, _ in fits])
    best = int(np.argmin(costs))
    table, delay = fits[best][1], float(delays[best])
    if 0 < best < len(delays) - 1:  # the vertex of a parabola through three costs
        a, b, c = costs[best - 1 : best + 2]
        delay += 0.5 * DELAY_STEP * float((a - c) / (a - 2 * b + c))
    armature, damping, frictionloss = np.maximum(table, np.array(FLOORS)[:, None])
    return replace(values, armature=armature, damping=damping, frictionloss=frictionloss, delay=delay)


def late_commands(motion: SmoothLog, delay: float) -> Array:
    """Return the commands (N, n) that act at the times of a motion, the mean of each step."""
    step = motion.t[1] - motion.t[0]
    return motion.log.commands_at(motion.t[0] - step / 2, step, len(motion.t), delay)


def _regression(
    motions: Sequence[SmoothLog], columns: Sequence[Array], j: int, joint: str
) -> tuple[Array, Array]:  # fmt: skip
    """Return the columns of a motion of joint j, -ddq, -dq, -sign(dq), and the ``columns`` behind them, where it moves.

    All have passed the low-pass of the motion. Raises InputError where the joint hardly moves.
    """
    rows = []
    for motion, others in zip(motions, columns, strict=True):
        dq = motion.dq[:, j]
        smooth = motion.smooth(np.column_stack([-motion.ddq[:, j], -dq, -np.tanh(dq / MIN_SPEED), others]))
        rows.append(smooth[np.abs(dq) > MIN_SPEED])
    matrix = np.vstack(rows)
    if len(matrix) < MIN_SAMPLES:
        raise InputError(f"joint {joint!r} moves faster than {MIN_SPEED} rad/s in {len(matrix)} samples; record more.")
    return matrix[:, :3], matrix[:, 3:]


def _common_kp(
    motions: Sequence[SmoothLog], rigid: Sequence[Array], delayed: Sequence[Array], unknown: NDArray[np.bool_]
) -> tuple[float, float]:
    """Return one kp of the ``unknown`` joints, and how much of their stretch it explains (a sum of squares).

    The stretch of a servo, command less position, is the torque of the bodies over kp and what friction adds.
    """
    numerator = denominator = 0.0
    for j in np.flatnonzero(unknown):
        others = [
            np.column_stack([torque[:, j], command[:, j] - motion.raw[:, j]])
            for motion, torque, command in zip(motions, rigid, delayed, strict=True)
        ]
        friction, matrix = _regression(motions, others, int(j), str(j))
        matrix = matrix - friction @ np.linalg.lstsq(friction, matrix, rcond=None)[0]
        numerator += float(matrix[:, 0] @ matrix[:, 1])
        denominator += float(matrix[:, 0] @ matrix[:, 0])
    compliance = max(numerator / max(denominator, 1e-300), 1e-300)
    return min(max(1 / compliance, MIN_KP), MAX_KP), numerator**2 / max(denominator, 1e-300)


def _linear_fit(
    motions: Sequence[SmoothLog], rigid: Sequence[Array], values: ServoValues, delayed: Sequence[Array],
    joints: Sequence[str],
) -> tuple[float, Array]:  # fmt: skip
    """Return the residual of a delay, as the sum of the joints' logarithms, and armature, damping, frictionloss."""
    from scipy.optimize import nnls

    cost, table = 0.0, np.zeros((3, len(joints)))
    for j, joint in enumerate(joints):
        sides = [
            torque[:, j] - values.drive_torques(command, motion.raw, motion.dq)[:, j]
            for motion, torque, command in zip(motions, rigid, delayed, strict=True)
        ]
        matrix, side = _regression(motions, sides, j, joint)
        table[:, j], norm = nnls(matrix, side[:, 0])
        cost += len(side) * np.log(max(norm, 1e-12))
    return float(cost), table
