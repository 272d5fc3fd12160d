"""What physics holds back, by hand: one friction coefficient that the data would have elsewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynident.identification import Identification
from dynident.identification.verdict_rules import constraint_effect


def test_growth_and_distance_of_a_friction_that_is_held(arm: Identification) -> None:
    """The residual of one joint, 0.02 N m, is joined by dq; joints count alike; torques at twice the speed."""
    motion, value = arm.validations[0].motion, arm.estimate.value.copy()
    value[arm.model.names.index("Fv_elbow")] += 1.0
    held = constraint_effect(replace(arm, estimate=replace(arm.estimate, value=value)))
    extra = motion.dq[:, 1]
    share = 0.02**2 / (0.02**2 + np.mean(extra**2))
    assert held.growth == pytest.approx(100 * (np.sqrt(2 / (1 + share)) - 1), rel=0.01)
    torque = arm.model.torque(motion.q, 2 * motion.dq, 4 * motion.ddq, value)
    assert held.torque_change == pytest.approx(100 * np.linalg.norm(2 * extra) / np.linalg.norm(torque), rel=0.02)


def test_nothing_is_held_back_at_rest(arm: Identification) -> None:
    """Without any torque there is nothing to compare with."""
    (train, held) = arm.validations
    silent = replace(train, signals=replace(train.signals, motion=replace(train.motion, tau=0 * train.motion.tau)))
    none = replace(arm, validations=(silent, held), estimate=replace(arm.estimate, value=0 * arm.estimate.value))
    found = constraint_effect(none)
    assert (found.growth, found.torque_change) == (0.0, 0.0)
