"""A velocity over several steps: what it is, in any loop, with its derivatives, and its settings."""

import numpy as np
import pytest

from dynident.models import Model
from dynident.models.simulation import DifferencingLoop, simulate_recording
from dynident.runtime import ConfigError
from tests.models.simulation.loops import ARM, LINKED, RUST, RUSTY, driven, loop
from tests.models.simulation.test_sensitivity import check

T = np.arange(300) * 1e-3


@pytest.mark.parametrize(("model", "theta"), [(RUSTY, RUST), (ARM, LINKED)])
def test_the_velocity_is_a_difference_over_its_steps(model: Model, theta: np.ndarray) -> None:
    motion = driven(model, T)
    drive = loop("cascade", motion)
    run = simulate_recording(model, theta, motion, DifferencingLoop(drive, 3))
    for k in (0, 1, 2, 10, 200):
        back = run.q[k - 3] if k > 2 else run.q[0] - (3 - k) * 1e-3 * run.dq[0]
        asked = drive(T[k], run.q[k], (run.q[k] - back) / 3e-3)
        np.testing.assert_allclose(run.tau[k], asked, rtol=1e-9, atol=1e-9)


def test_one_step_is_the_loop_itself() -> None:
    motion = driven(ARM, T)
    drive = loop("pid", motion)
    plain, same = (simulate_recording(ARM, LINKED, motion, x) for x in (drive, DifferencingLoop(drive, 1)))
    np.testing.assert_array_equal(plain.q, same.q)


@pytest.mark.parametrize("kind", ["cascade", "pid", "function"])
def test_derivatives(kind: str) -> None:
    for model, theta, limit in ((RUSTY, RUST, 0.6), (ARM, LINKED, 1.0)):
        motion = driven(model, T[:90])
        check(model, theta, motion, DifferencingLoop(loop(kind, motion, limit), 3))


def test_times_are_those_of_the_loop() -> None:
    drive = DifferencingLoop(loop("pd", driven(ARM, T)), 2)
    assert drive.joints == ("joint1", "joint2")
    np.testing.assert_array_equal(drive.timed(T + 1).t, T + 1)
    assert len(drive.every(0.5e-3).t) == 2 * len(T) - 1
    with pytest.raises(ConfigError, match="steps = 0; give a whole number from 1 to 100"):
        DifferencingLoop(drive.loop, 0)
