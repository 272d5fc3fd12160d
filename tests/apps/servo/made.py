"""An identified servo arm that was not fitted, with what its report shows."""

import numpy as np

from dynident.apps.demo.servo_arm import FILE_VALUES, SERVO_JOINTS
from dynident.apps.servo.fit import ServoFit
from dynident.apps.servo.judge import ServoRollout
from dynident.apps.servo.plant import ServoLog
from dynident.apps.servo.result import ServoIdentification
from dynident.models import Joint
from tests.apps.servo.arms import ENTRIES, ONES, values


def rollout(name: str, role: str, size: float) -> ServoRollout:
    """A recording whose rollout is off by ``size`` (rad)."""
    t = np.arange(200) * 0.02
    q = np.sin(np.outer(t, ONES) + np.arange(3))
    log = ServoLog(name, t, q, t, q + 0.01)
    sizes = (size * ONES * (1.0, 1.234567, 1.5), 3 * size * ONES, 0.5 * size * ONES, 1e-3 * ONES, 0.7 * ONES)
    return ServoRollout(log, role, q + size, q + 3 * size, *sizes)


def identified() -> ServoIdentification:
    """The arm of the demo with its true values, two of which contradict its file."""
    covariance = np.diag(np.linspace(1e-6, 1e-4, len(ENTRIES)))
    residuals = np.zeros((10, 3))
    fit = ServoFit(
        values(), ENTRIES, covariance, residuals, np.zeros((10, 3, len(ENTRIES))), 0.00123456 * ONES, True, ()
    )
    joints = tuple(Joint(name) for name in SERVO_JOINTS)
    rollouts = (rollout("monday", "train", 0.002), rollout("tuesday", "validation", 0.00345678))
    return ServoIdentification(
        "arm", joints, fit, values(FILE_VALUES), ENTRIES[:2], (), rollouts, "<mujoco/>", 1e-9,
        ("odd <b>",), {"servos.xml": "0a1b"}, None, True,
    )  # fmt: skip
