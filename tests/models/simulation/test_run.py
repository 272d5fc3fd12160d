"""A recording simulated: its pieces, derivatives and failures."""

import numpy as np
import pytest

from dynident.models.lagrangian import slider, two_link_arm
from dynident.models.simulation import RunsAway, Singular, simulate, simulate_recording
from dynident.runtime import ConfigError, InputError
from tests.models.simulation.loops import ARM, LINKED, RUST, RUSTY, driven, loop

T = np.arange(601) * 1e-3


def test_an_arm_moves_as_by_an_accurate_integrator() -> None:
    """Positions, velocities and accelerations; the torque is held as the mean of two samples."""
    arm = two_link_arm()
    exact = simulate(arm, arm.values, lambda s: (1.13 * np.sin(s), 0.78 * np.cos(s)), T)
    run = simulate_recording(arm, arm.values, exact)
    np.testing.assert_allclose(run.q, exact.q, atol=2e-5)
    delayed = slice(30, -1)  # friction brakes the start within some steps
    np.testing.assert_allclose(run.dq[delayed], exact.dq[delayed], atol=1e-4)
    np.testing.assert_allclose(run.ddq[delayed], exact.ddq[delayed], atol=2e-3)
    motion = run.motion
    assert (motion.joints, motion.smoothing["method"]) == (exact.joints, "simulated")


def test_pieces_follow_each_other_and_are_simulated_together() -> None:
    motion = driven(ARM, T)
    run = simulate_recording(ARM, LINKED, motion, restart=0.2)
    assert run.rows.shape == (3, 201)
    assert run.q.shape == (603, 2)
    np.testing.assert_array_equal(run.t, motion.t[run.rows.ravel()])
    for rows, q, dq in zip(run.rows, run.q.reshape(3, 201, 2), run.dq.reshape(3, 201, 2), strict=True):
        alone = simulate_recording(ARM, LINKED, motion, rows=slice(rows[0], rows[-1] + 1))
        np.testing.assert_allclose(q, alone.q, atol=1e-12)
        np.testing.assert_allclose(dq, alone.dq, atol=1e-11)
    with pytest.raises(InputError, match="one piece"):
        _ = run.motion


def test_what_cannot_be_simulated_is_a_failure() -> None:
    motion = driven(slider(), np.arange(1001) * 0.01)
    singular = simulate_recording(slider(), (0.0, 0.0, 3.0, 0.5), motion)
    assert (singular.failure, singular.trace) == (Singular(), None)
    away = simulate_recording(slider(), (1.0, -300.0, 0.0, 0.0), motion)
    assert isinstance(away.failure, RunsAway)
    assert not np.isfinite(away.q[-1]).any()
    with pytest.raises(InputError, match="did not fail"):
        _ = away.motion


def test_wrong_arguments_are_named() -> None:
    motion = driven(RUSTY, T)
    with pytest.raises(InputError, match="too few usable samples"):
        simulate_recording(RUSTY, RUST, motion, rows=slice(3, 5))
    with pytest.raises(ConfigError, match="restart is -1"):
        simulate_recording(RUSTY, RUST, motion, restart=-1)
    with pytest.raises(InputError, match="the controller has joints"):
        simulate_recording(RUSTY, RUST, motion, loop("pd", driven(ARM, T)))
