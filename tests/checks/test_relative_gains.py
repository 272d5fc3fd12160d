"""Gains from the robot file: found where the motion shows them, refused where not."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.checks import relative_gains
from dynident.motion.log import Motion
from tests.checks import moving_arm

GAINS = np.array([12.0, -9.0, 5.0])


def currents(noise: float = 0.05, seed: int = 0) -> Motion:
    """What the drives of the moving arm would log: torque with friction, over the gains."""
    motion = moving_arm.motion()
    friction = 0.4 * motion.dq + 0.5 * np.tanh(motion.dq / 0.02)
    rough = noise * np.random.default_rng(seed).standard_normal(motion.tau.shape)
    return replace(motion, tau=(motion.tau + friction + rough) / GAINS)


def test_gains_are_found_with_their_standard_errors() -> None:
    result = relative_gains(moving_arm.arm(), [currents()])
    assert result
    names = [joint.name for joint in moving_arm.arm().joints]
    for name, case in result.items():
        true = GAINS[names.index(name)]
        assert case.value == pytest.approx(true, rel=0.05)
        assert 0 < case.std < 0.05 * abs(true)
        assert abs(case.value - true) < 5 * case.std + 0.01 * abs(true)


def test_what_does_not_follow_the_file_or_was_never_recorded_is_refused() -> None:
    motion, arm = currents(), moving_arm.arm()
    noise = replace(motion, tau=np.random.default_rng(1).standard_normal(motion.tau.shape))
    assert not relative_gains(arm, [noise])
    assert motion.joints[1] not in relative_gains(arm, [replace(motion, tau=motion.tau * [1.0, 0.0, 1.0])])
