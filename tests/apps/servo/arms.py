"""The arm of the demo as a plant with known values, and recordings of it."""

import mujoco
import numpy as np

from dynident.apps.demo.servo_arm import (
    COUNT,
    FILE_VALUES,
    KP,
    LIMIT,
    LOG_EVERY,
    SERVO_JOINTS,
    STEP,
    TRUE_DELAY,
    TRUE_VALUES,
    servo_mjcf,
    servo_recording,
)
from dynident.apps.servo.plant import ServoLog, ServoPlant
from dynident.apps.servo.robot import load_plant
from dynident.apps.servo.values import FRICTION, Entry, Quantity, ServoValues
from dynident.project.settings import RobotSettings

SETTINGS = RobotSettings.model_validate({"file": "servos.xml"})
ENTRIES = (*(Entry(quantity, k) for quantity in FRICTION for k in range(3)), Entry(Quantity.DELAY, 0))
ONES = np.ones(3)


def plant(text: str | None = None) -> ServoPlant:
    """The arm as its file has it."""
    return load_plant(SETTINGS, text or servo_mjcf(FILE_VALUES), SERVO_JOINTS, "servos.xml")


def values(table: dict[str, tuple[float, ...]] = TRUE_VALUES, kp: float = KP, delay: float = TRUE_DELAY) -> ServoValues:
    """The arm's values, by default the true ones."""
    arrays = {key: np.array(entries) for key, entries in table.items()}
    return ServoValues(**arrays, kp=kp * ONES, kd=0 * ONES, limit=LIMIT * ONES, offset=0 * ONES,
                       command_offset=0 * ONES, mass=ONES, delay=delay)  # fmt: skip


def recording(seed: int = 1, duration: float = 6.0) -> ServoLog:
    """What the arm's log has."""
    t, command, q = servo_recording(seed, duration)
    return ServoLog(f"seed {seed}", t, q, t, command)


def motor_mjcf(table: dict[str, tuple[float, ...]], gear: float = 1.0) -> str:
    """The arm with motors of torque, that of the elbow with a gear."""
    text = servo_mjcf(table).replace("<position name", "<motor name").replace(f' kp="{KP}"', "")
    return text.replace('joint="elbow" force', f'joint="elbow" gear="{gear}" force')


def torque_recording(seed: int = 1, duration: float = 3.0, delay: float = 0.012) -> ServoLog:
    """What the log of that arm has where a computer commands torques each 10 ms, which come late."""
    t, target, _ = servo_recording(seed, duration)
    data = mujoco.MjData(mujoco.MjModel.from_xml_string(motor_mjcf(TRUE_VALUES)))
    data.qpos[:] = target[0]
    command, q, delayed = np.empty(target.shape), np.empty(target.shape), round(delay / STEP)
    for k in range(len(t) * LOG_EVERY):
        if k % LOG_EVERY == 0:
            row = k // LOG_EVERY
            q[row] = np.round(data.qpos / COUNT) * COUNT
            command[row] = 8.0 * (target[row] - q[row]) - 0.1 * data.qvel
        data.ctrl[:] = command[max(k - delayed, 0) // LOG_EVERY]
        mujoco.mj_step(data.model, data)
    return ServoLog(f"seed {seed}", t, q, t, command)
