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

Array = NDArray[np.float64]
MAX_DELAY = 0.2  # s
DELAY_STEP = 0.004  # s, of the scan
CUTOFF = 6.0  # Hz, of the low-pass that positions and torques pass alike
MIN_SPEED = 0.05  # rad/s or m/s, below which the sign of dry friction is unsure
MIN_KP = 1e-3  # N m/rad, N/m
FLOORS = (1e-6, 1e-6, 1e-6)  # kg m^2, N m s, N m: the least that a search starts from


class SmoothLog(Noun):
    """A recording on an even grid: t (N), smooth positions, speeds and accelerations (N, n), and the raw positions."""

    log: ServoLog
    t: Array
    raw: Array
    q: Array
    dq: Array
    ddq: Array
    sections: Array

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
    if len(t) < 50:
        raise InputError(f"{log.name}: has {len(t)} samples; a servo fit needs at least 50.")
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
    plant: ServoPlant, motions: Sequence[SmoothLog], values: ServoValues, *, free_delay: bool, free_kp: Sequence[bool]
) -> ServoValues:
    """Return the values that explain the controllers' torques best, with the delay of a scan (``free_delay``).

    kp of a joint is sought where ``free_kp`` says so, by the torques of the bodies.
    """
    rigid = [rigid_torques(plant, values, motion) for motion in motions]
    delays = np.arange(0.0, MAX_DELAY, DELAY_STEP) if free_delay else np.array([values.delay])
    fits = [_linear_fit(motions, rigid, values, float(delay), free_kp, plant.joints) for delay in delays]
    costs = np.array([cost for cost, _ in fits])
    best = int(np.argmin(costs))
    table, delay = fits[best][1], float(delays[best])
    if 0 < best < len(delays) - 1:  # the vertex of a parabola through three costs
        a, b, c = costs[best - 1 : best + 2]
        delay += 0.5 * DELAY_STEP * float((a - c) / (a - 2 * b + c))
    armature, damping, frictionloss = np.maximum(table[:3], np.array(FLOORS)[:, None])
    starts = {"armature": armature, "damping": damping, "frictionloss": frictionloss, "delay": delay}
    return replace(values, **starts, kp=np.where(free_kp, np.maximum(table[3], MIN_KP), values.kp))  # type: ignore[arg-type]


def _linear_fit(
    motions: Sequence[SmoothLog],
    rigid: Sequence[Array],
    values: ServoValues,
    delay: float,
    free_kp: Sequence[bool],
    joints: Sequence[str],
) -> tuple[float, Array]:
    """Return the residual of a delay, as the sum of the joints' logarithms, and armature, damping, frictionloss, kp."""
    from scipy.optimize import nnls

    n = len(values.kp)
    late = []
    for motion in motions:
        step = motion.t[1] - motion.t[0]
        late.append(motion.log.commands_at(motion.t[0] - step / 2, step, len(motion.t), delay))
    cost, table = 0.0, np.zeros((4, n))
    for j in range(n):
        rows, sides = [], []
        for motion, torque, command in zip(motions, rigid, late, strict=True):
            dq = motion.dq[:, j]
            error = command[:, j] - motion.raw[:, j]
            spring = np.clip(values.kp[j] * error - values.kd[j] * dq, -values.limit[j], values.limit[j])
            stretch = error if free_kp[j] else np.zeros(len(error))
            side = torque[:, j] - (0.0 if free_kp[j] else spring)
            columns = [-motion.ddq[:, j], -dq, -np.tanh(dq / MIN_SPEED), stretch, side]
            smooth = motion.smooth(np.column_stack(columns))
            moving = np.abs(dq) > MIN_SPEED
            rows.append(smooth[moving, :4])
            sides.append(smooth[moving, 4])
        matrix, side = np.vstack(rows), np.concatenate(sides)
        if len(side) < 20:
            raise InputError(
                f"joint {joints[j]!r} moves faster than {MIN_SPEED} rad/s in {len(side)} samples; record more of it."
            )
        table[:, j], norm = nnls(matrix, side)
        cost += len(side) * np.log(max(norm, 1e-12))
    return float(cost), table
