"""Free simulation: its pieces, with friction that holds, and in a controller's loop."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.models import CoupledMotor, Joint, Model, RotorInertia
from dynident.models.friction import Coulomb
from dynident.models.lagrangian import slider
from dynident.models.simulation import CascadePD, RunsAway, Singular
from dynident.motion.log import Motion
from dynident.runtime import ConfigError, InputError
from dynident.validation import FreeRun, free_run

T = np.arange(1001) * 0.002
SLIDER = (5.0, 8.0, 3.0, 0.5)


def resting(t: np.ndarray, tau: np.ndarray, joints: tuple[str, ...], dq: float = 0.0) -> Motion:
    zero = np.zeros((len(t), len(joints)))
    return Motion(t, zero, zero + dq, zero, tau, joints, np.ones(len(t), dtype=bool), "run")


def cascade(t: np.ndarray, reference: np.ndarray, saturation: float = np.inf, extra: float = 0.0) -> CascadePD:
    ones = np.ones(1)
    limits, forward = saturation * ones, np.full((len(t), 1), extra)
    return CascadePD(("slider",), t, reference[:, None], 20 * ones, 30 * ones, 2 * ones, limits, forward)


def test_friction_holds_below_its_level_and_slides_above() -> None:
    """2.9 + 0.5 N of offset against 3 N of friction: at 3.4 N it stands, at 4 N it approaches 0.5 N / 8 N s/m."""
    held = free_run(slider(), SLIDER, resting(T, np.full((1001, 1), 3.4), ("slider",)), restart=9.0)
    np.testing.assert_array_equal(held.q, 0.0)
    slid = free_run(slider(), SLIDER, resting(T, np.full((1001, 1), 4.0), ("slider",)), restart=9.0)
    exact = 0.0625 * (slid.t - 5 / 8 * (1 - np.exp(-8 / 5 * slid.t)))
    np.testing.assert_allclose(slid.q[:, 0], exact, atol=1e-7)


def test_the_friction_of_a_coupled_motor_holds_the_sum_of_its_joints() -> None:
    """The motor at q1 + q2 sticks; torques that turn the joints against each other move them, and the sum stays."""
    joints = (Joint("a"), Joint("b"))
    model = Model((RotorInertia(joints), CoupledMotor(joints, {"a": 1, "b": 1}, "m", viscous=False), Coulomb(joints)))
    values = {"Ia_a": 1.0, "Ia_b": 2.0, "Ia_m": 0.5, "Fc_m": 1.0, "Fc_a": 0.1, "Fc_b": 0.1}
    theta = [values[name] for name in model.names]
    run = free_run(model, theta, resting(T[:501], np.tile([1.0, -1.2], (501, 1)), ("a", "b")), restart=9.0)
    assert run.q[-1, 0] > 0.3
    np.testing.assert_allclose(run.q.sum(axis=1), 0.0, atol=1e-9)


def test_the_cascade_is_its_formula() -> None:
    drive = cascade(T, np.sin(T), saturation=10.0, extra=0.25)
    q = np.array([0.1])
    near = np.array([np.sin(T[5]) - 0.001])
    assert drive(T[5] + 0.001, near, np.zeros(1)) == pytest.approx(2 * (30 * 20 * 0.001 + 0.25))
    assert drive(T[5], q, np.array([-9.0])) == pytest.approx(20.0)
    assert drive(T[5], q, np.array([9.0])) == pytest.approx(-20.0)
    with pytest.raises(InputError, match="reference has shape"):
        replace(drive, reference=np.zeros((3, 1)))


def looped(values: tuple[float, ...] = SLIDER) -> FreeRun:
    """The slider of SLIDER, recorded in the loop, simulated with other values in the same loop."""
    drive = cascade(T, 0.3 * np.sin(3 * T))
    start = resting(T, np.zeros((1001, 1)), ("slider",))
    recorded = free_run(slider(), SLIDER, start, drive)
    t, q, tau = recorded.t, recorded.q, recorded.tau
    dq = np.gradient(q, t, axis=0)
    dq[0] = 0.0
    motion = Motion(t, q, dq, 0 * q, tau, ("slider",), np.ones(len(t), dtype=bool), "loop")
    return free_run(slider(), values, motion, drive, name="again")


def test_the_loop_gives_back_what_it_made() -> None:
    run = looped()
    assert (run.name, run.driver, run.restart) == ("again", "controller", None)
    assert run.relative_error["slider"] < 1e-9
    assert run.torque_error["slider"] < 1e-9


def test_a_model_that_cannot_be_simulated_is_reported_and_does_not_stop() -> None:
    still = resting(T, np.full((1001, 1), 9.0), ("slider",))
    singular = free_run(slider(), (0.0, 0.0, 3.0, 0.5), still, restart=9.0)
    assert singular.failure == Singular()
    away = free_run(slider(), (1.0, -300.0, 0.0, 0.0), still, restart=9.0)
    assert isinstance(away.failure, RunsAway)
    assert 0 < away.failure.after < 9.0
    assert away.rms["slider"] == np.inf


def test_what_is_missing_is_refused() -> None:
    still = resting(T, np.zeros((1001, 1)), ("slider",))
    with pytest.raises(ConfigError, match="needs a controller, or `restart`"):
        free_run(slider(), SLIDER, still)
    with pytest.raises(InputError, match="the controller has joints"):
        free_run(slider(), SLIDER, replace(still, joints=("other",)), cascade(T, T))
    with pytest.raises(InputError, match="too few usable samples"):
        free_run(slider(), SLIDER, replace(still, mask=np.zeros(1001, dtype=bool)), restart=1.0)
