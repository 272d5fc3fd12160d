"""An arm of servos in MuJoCo: its model with other values, and rollouts of it under the recorded commands."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.apps.servo.values import ServoValues
from dynident.runtime import ModelError, Noun, install_command
from dynident.runtime.arrays import Array

Indices = NDArray[np.intp]


def import_mujoco() -> Any:
    """Return MuJoCo; ModelError that says how to install it where it is missing."""
    try:
        import mujoco
        import mujoco.rollout
    except ImportError as error:
        raise ModelError(
            "a robot of servos is fitted by simulating it in MuJoCo, which is not installed; install it by: "
            f"{install_command('mujoco')} (or the extra `dynident[mujoco]`)."
        ) from error
    return mujoco


@contextmanager
def ignore_divergence() -> Iterator[None]:
    """Keep MuJoCo from printing that a simulation diverges, and from writing that into a file in the user's folder."""
    mujoco = import_mujoco()
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)


class ServoLog(Noun):
    """A recording: measured positions q (N, n) at times t (N), commands (M, n) at times ``sent`` (M); s, rad or m.

    A command is ``held`` until the next one, else interpolated.
    """

    name: str
    t: Array
    q: Array
    sent: Array
    command: Array
    held: bool = True

    def commands_at(self, start: float, step: float, count: int, delay: float) -> Array:
        """Return the commands (count, n) of simulation steps from ``start`` on, which act ``delay`` s late.

        A held command is its mean over the step, so that the result is continuous in the delay.
        """
        edges = start - delay + step * np.arange(count + 1)
        if not self.held:
            middles = edges[:-1] + step / 2
            return np.column_stack([np.interp(middles, self.sent, column) for column in self.command.T])
        # the integral of what is held is linear between the stamps; before them the first command holds
        t = np.concatenate([[min(edges[0], self.sent[0]) - 1.0], self.sent, [max(edges[-1], self.sent[-1]) + 1.0]])
        levels = np.concatenate([self.command[:1], self.command])
        integral = np.vstack([np.zeros(levels.shape[1]), np.cumsum(levels * np.diff(t)[:, None], axis=0)])
        sums = np.column_stack([np.interp(edges, t, column) for column in integral.T])
        return np.diff(sums, axis=0) / step


class ServoPlant(Noun):
    """A compiled MuJoCo model and, by joint (n), the places of position, speed, actuator and moved body in it."""

    model: Any
    joints: tuple[str, ...]
    positions: Indices
    dofs: Indices
    actuators: Indices
    bodies: Indices

    def with_values(self, values: ServoValues) -> Any:
        """Return a copy of the model with other values, as if it was compiled with them."""
        mujoco = import_mujoco()
        model = copy.copy(self.model)
        model.dof_armature[self.dofs] = values.armature
        model.dof_damping[self.dofs] = values.damping
        model.dof_frictionloss[self.dofs] = values.frictionloss
        gear = self.gear
        stiffness = values.kp / gear**2
        model.actuator_gainprm[self.actuators, 0] = np.where(values.takes_torque, 1.0, stiffness)
        model.actuator_biasprm[self.actuators, 1] = -stiffness
        model.actuator_biasprm[self.actuators, 2] = -values.kd / gear**2
        model.actuator_forcelimited[self.actuators] = np.isfinite(values.limit)
        bound = np.where(np.isfinite(values.limit), values.limit, 0.0) / np.abs(gear)
        model.actuator_forcerange[self.actuators] = np.column_stack([-bound, bound])
        if (values.mass != 1).any():
            model.body_mass[self.bodies] *= values.mass
            model.body_inertia[self.bodies] *= values.mass[:, None]
        # what the compiler derives of inertias also scales the friction constraint
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return model

    @property
    def gear(self) -> Array:
        """The transmission (n) of each actuator."""
        return np.array(self.model.actuator_gear[self.actuators, 0])

    def controls(self, values: ServoValues, command: Array) -> Array:
        """Return what the actuators are given (N, n) for commands, before their gears."""
        return np.asarray((command + values.shift) * np.where(values.takes_torque, 1 / self.gear, self.gear))

    @property
    def step(self) -> float:
        """The time step of the simulation (s)."""
        return float(self.model.opt.timestep)

    @ignore_divergence()
    def rollout(
        self, values: ServoValues, log: ServoLog, starts: Sequence[int] = (0,), stops: Sequence[int] | None = None,
        speeds: Array | None = None,
    ) -> list[Array]:  # fmt: skip
        """Return the positions that the encoders show (N', n), simulated over the samples ``starts`` to ``stops``.

        Each rollout begins at the measured position with the ``speeds`` (N, n), by default at rest.
        """
        mujoco = import_mujoco()
        model = self.with_values(values)
        data = mujoco.MjData(model)
        stops = [len(log.t)] if stops is None else stops
        count = max(int(np.ceil((log.t[b - 1] - log.t[a]) / self.step)) for a, b in zip(starts, stops, strict=True)) + 1
        states, controls = [], []
        kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
        for a in starts:
            mujoco.mj_resetData(model, data)
            data.qpos[self.positions] = log.q[a] - values.offset
            data.qvel[self.dofs] = 0.0 if speeds is None else speeds[a]
            state = np.empty(mujoco.mj_stateSize(model, kind))
            mujoco.mj_getState(model, data, state, kind)
            states.append(state)
            control = np.zeros((count, model.nu))
            command = log.commands_at(log.t[a], self.step, count, values.delay)
            control[:, self.actuators] = self.controls(values, command)
            controls.append(control)
        history, _ = mujoco.rollout.rollout(model, data, np.array(states), np.array(controls))
        places, paths = 1 + self.positions, []  # the state begins with the time
        for state, steps, a, b in zip(states, history, starts, stops, strict=True):
            path = np.vstack([state[places], steps[:, places]])
            paths.append(sample_path(path, (log.t[a:b] - log.t[a]) / self.step) + values.offset)
        return paths


def sample_path(path: Array, place: Array) -> Array:
    """Return the positions (N, n) of a path (M, n) of simulation steps at places (N) along it, in steps."""
    k = np.minimum((place + 1e-9).astype(int), len(path) - 2)
    share = (place - k)[:, None]
    return np.asarray((1 - share) * path[k] + share * path[k + 1])


def compile_plant(spec: Any, joints: Sequence[str], source: str) -> ServoPlant:
    """Return the plant of a MuJoCo specification with one servo for each of the joints.

    Actuators of these joints become servos; joints without one get it. Raises ModelError for joints that are
    missing or turn about more than one axis, and where MuJoCo cannot compile the file.
    """
    mujoco = import_mujoco()
    servos = {}
    for actuator in spec.actuators:
        if actuator.trntype == mujoco.mjtTrn.mjTRN_JOINT and actuator.target in joints:
            if actuator.target in servos:
                raise ModelError(f"{source}: joint {actuator.target!r} has two actuators; keep that of the servo.")
            servos[actuator.target] = actuator
    for name in joints:
        actuator = servos.get(name) or spec.add_actuator(
            name=f"{name}_servo", target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT
        )
        actuator.gaintype, actuator.biastype = mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtBias.mjBIAS_AFFINE
        actuator.dyntype = mujoco.mjtDyn.mjDYN_NONE
        servos[name] = actuator
    try:
        model = spec.compile()
    except ValueError as error:
        raise ModelError(f"{source}: MuJoCo cannot compile it: {error}") from error
    places = [mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_JOINT, name) for name in joints]
    for name, k in zip(joints, places, strict=True):
        if k < 0 or int(model.jnt_type[k]) < int(mujoco.mjtJoint.mjJNT_SLIDE):
            raise ModelError(f"{source}: {name!r} is no joint of one axis in MuJoCo's model.")
    ids = [servos[name].id for name in joints]
    columns = model.jnt_qposadr[places], model.jnt_dofadr[places], ids, model.jnt_bodyid[places]
    return ServoPlant(model, tuple(joints), *(np.array(column, dtype=np.intp) for column in columns))
