"""Gains from the robot file: found where the motion shows them, refused where not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynident.checks import relative_gains
from dynident.models import Term
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
    found = relative_gains(moving_arm.arm(), [currents()])
    assert found
    names = [joint.name for joint in moving_arm.arm().joints]
    for name, one in found.items():
        true = GAINS[names.index(name)]
        assert one.value == pytest.approx(true, rel=0.05)
        assert 0 < one.std < 0.05 * abs(true)
        assert abs(one.value - true) < 5 * one.std + 0.01 * abs(true)


def test_what_does_not_follow_the_file_is_refused() -> None:
    noise = replace(currents(), tau=np.random.default_rng(1).standard_normal(currents().tau.shape))
    assert not relative_gains(moving_arm.arm(), [noise])


def test_a_current_that_was_never_recorded_is_refused() -> None:
    motion = currents()
    found = relative_gains(moving_arm.arm(), [replace(motion, tau=motion.tau * [1.0, 0.0, 1.0])])
    assert motion.joints[1] not in found


def test_a_file_without_inertias_gives_none() -> None:
    arm = moving_arm.arm()
    light = replace(arm, terms=tuple(map(_Unknown, arm.terms)))
    assert not relative_gains(light, [currents()])


class _Unknown(Term):
    """A term without nominal values."""

    def __init__(self, term: Term) -> None:
        self.term, self.joints = term, term.joints
        self.parameters = tuple(replace(parameter, value=None) for parameter in term.parameters)

    def regressor(self, q, dq, ddq):
        return self.term.regressor(q, dq, ddq)
