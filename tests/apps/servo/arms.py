"""The arm of the demo as a plant with known values, and recordings of it."""

from __future__ import annotations

import numpy as np

from dynident.apps.demo.servo_arm import (
    FILE_VALUES,
    KP,
    LIMIT,
    SERVO_JOINTS,
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
