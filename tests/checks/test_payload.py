"""Another payload in a held-out log than in training."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.checks.missing import payload_findings
from dynident.checks.motion_notes import OtherPayload
from tests.checks.moving_arm import arm, motion, truth

MODEL = arm()


def with_payload(mass: float) -> np.ndarray:
    theta = truth(MODEL)
    theta[20] += mass
    theta[21] += 0.2 * mass
    theta[[26, 29]] += 0.04 * mass
    return theta


def loaded(seed: int, mass: float):
    return motion(seed, theta=with_payload(mass))


@pytest.mark.parametrize("mass", [1.0, -0.5])
def test_another_payload_is_found_with_its_mass(mass: float) -> None:
    logs = {"same": motion(2), "other": loaded(3, mass)}
    (result,) = payload_findings(MODEL, [motion(1)], logs)
    assert result.source == "other"
    assert isinstance(result.message, OtherPayload)
    assert result.message.mass == pytest.approx(mass, abs=5 * result.message.std)
    assert result.message.std < 0.1


def test_gains_that_are_too_small_make_a_payload_as_much_too_light() -> None:
    """The one thing that shows a factor of all torques: docs/gains.md relies on it."""
    bare, other = (replace(x, tau=0.9 * x.tau) for x in (motion(1), loaded(3, 1.0)))
    (result,) = payload_findings(MODEL, [bare], {"other": other})
    assert result.message.mass == pytest.approx(0.9, abs=5 * result.message.std)
    assert result.message.mass < 1.0 - 2 * result.message.std


def test_rougher_friction_is_no_payload() -> None:
    theta = truth(MODEL)
    theta[33:39] *= 1.3
    assert list(payload_findings(MODEL, [motion(1)], {"cold": motion(2, theta=np.array(theta))})) == []
