"""A small arm of three position servos, simulated in MuJoCo: a robot file that is off, and recordings of it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from dynident.files.results import write_text
from dynident.runtime import ModelError, install_command
from dynident.runtime.arrays import Array

SERVO_JOINTS = ("base", "shoulder", "elbow")
AXES = ("0 0 1", "0 1 0", "0 1 0")
TRUE_VALUES = {  # by quantity, of each joint; SI
    "armature": (0.028, 0.028, 0.014), "damping": (0.60, 0.65, 0.35), "frictionloss": (0.052, 0.060, 0.040),
}  # fmt: skip
FILE_VALUES = {"armature": (0.01, 0.06, 0.005), "damping": (0.3, 0.2, 0.8), "frictionloss": (0.1, 0.02, 0.1)}
TRUE_DELAY = 0.023  # s
KP, LIMIT = 17.8, 3.35  # N m/rad, N m
STEP, LOG_EVERY = 0.002, 5  # s, steps of the simulation between commands, which are logged
COUNT = 2 * np.pi / 4096  # rad: an encoder of 12 bits


def servo_mjcf(values: Mapping[str, tuple[float, ...]]) -> str:
    """Return the arm's MJCF with values of its joints."""
    opening, actuators = "", ""
    for k, name in enumerate(SERVO_JOINTS):
        numbers = " ".join(f'{key}="{entries[k]}"' for key, entries in values.items())
        opening += (
            f'  <body name="{name}_link" pos="{0.11 if k > 1 else 0} 0 {0.05 if k < 2 else 0}">\n'
            f'  <joint name="{name}" axis="{AXES[k]}" {numbers}/>\n'
            f'  <inertial pos="{0.06 if k else 0} 0 0.01" mass="{0.2 - 0.03 * k:g}" diaginertia="9e-5 9e-5 9e-5"/>\n'
        )
        actuators += f'  <position name="{name}" joint="{name}" kp="{KP}" forcerange="-{LIMIT} {LIMIT}"/>\n'
    return (
        '<mujoco model="servo_arm">\n<compiler angle="radian"/>\n'
        f'<option timestep="{STEP}" integrator="implicitfast"/>\n'
        f"<worldbody>\n{opening}  {'</body>' * 3}\n</worldbody>\n<actuator>\n{actuators}</actuator>\n</mujoco>\n"
    )


def servo_recording(seed: int, duration: float = 12.0) -> tuple[Array, Array, Array]:
    """Return stamps (N), commands (N, 3), and positions (N, 3) as the encoders show them; s, rad.

    Raises ModelError where MuJoCo is not installed.
    """
    t = np.arange(0.0, duration, LOG_EVERY * STEP)
    command = _commands(t, np.random.default_rng(seed))
    return t, command, play_commands(command)


def play_commands(command: Array) -> Array:
    """Return the positions (N, 3), rad, that the encoders show while the true arm follows commands (N, 3), rad.

    Commands are held for 10 ms and act 23 ms late. Raises ModelError where MuJoCo is not installed.
    """
    try:
        import mujoco
    except ImportError as error:
        words = f"the arm of servos is simulated in MuJoCo; install it by: {install_command('mujoco')}"
        raise ModelError(words) from error
    model = mujoco.MjModel.from_xml_string(servo_mjcf(TRUE_VALUES))
    data = mujoco.MjData(model)
    data.qpos[:] = command[0]
    held = np.repeat(command, LOG_EVERY, axis=0)
    steps = TRUE_DELAY / STEP
    lead = int(steps)
    padded = np.vstack([np.repeat(command[:1], lead + 1, axis=0), held])
    q = np.empty(command.shape)
    for k in range(len(held)):
        if k % LOG_EVERY == 0:
            q[k // LOG_EVERY] = data.qpos
        # within a step the old command still acts for a share of it
        data.ctrl[:] = (1 - (steps - lead)) * padded[k + 1] + (steps - lead) * padded[k]
        mujoco.mj_step(model, data)
    return np.asarray(np.round(q / COUNT) * COUNT)


def _commands(t: Array, rng: np.random.Generator) -> Array:
    """Return commands (N, 3): sums of sines, which begin gently, and steps."""
    command = np.zeros((len(t), 3))
    for k in range(3):
        for frequency in rng.uniform(0.15, 1.6, 6):
            command[:, k] += 0.2 / (0.3 + frequency) * np.sin(2 * np.pi * frequency * t + rng.uniform(0, 2 * np.pi))
        command[:, k] += 0.15 * (-1.0) ** np.searchsorted(np.sort(rng.uniform(0, t[-1], 5)), t)
    return command * np.minimum(1.0, (t[:, None] + 0.5) / 1.5)


def servo_files(folder: Path, duration: float = 12.0) -> tuple[Path, Path, Path]:
    """Write the arm's file and two recordings (CSV) into a folder; return their paths.

    Raises ModelError as ``servo_recording`` does.
    """
    robot = write_text(folder / "servos.xml", servo_mjcf(FILE_VALUES))
    logs = []
    head = ",".join(["time", *(f"cmd_{name}" for name in SERVO_JOINTS), *(f"pos_{name}" for name in SERVO_JOINTS)])
    for seed, day in ((1, "monday"), (2, "tuesday")):
        rows = np.column_stack(servo_recording(seed, duration))
        lines = [head, *(",".join(f"{x:.7g}" for x in row) for row in rows)]
        logs.append(write_text(folder / f"{day}.csv", "\n".join(lines) + "\n"))
    return robot, logs[0], logs[1]
