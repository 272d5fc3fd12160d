"""What the sensors' noise leaves of the torque, against the error of the true parameters on simulated recordings."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from dynident.models import Model
from dynident.models.lagrangian import pendulum, two_link_arm
from dynident.models.simulation import record, simulate
from dynident.motion.filters import butterworth, zero_phase
from dynident.motion.log import Motion
from dynident.motion.smoothers import KalmanSmoother, Spline
from dynident.validation import sensor_noise, validate

ARMS = {"pendulum": pendulum(), "arm": two_link_arm()}


@cache
def moved(model: Model) -> Motion:
    def torque(t: float) -> list[float]:
        return [np.sin((3.0 + k) * t) for k in range(len(model.joints))]

    return simulate(
        model, model.values, torque, np.arange(5001 if len(model.joints) == 1 else 1501) * 0.002, tolerance=1e-9
    )


@cache
def recorded(model: Model, sigma_q: float, sigma_tau: float, ratio: float = 1.0) -> Motion:
    """A motion at 500 Hz, smoothed after noise was added; each joint has a ``ratio`` of that of the one before."""
    sigma = sigma_q * ratio ** np.arange(len(model.joints))
    log = record(moved(model), sigma_q=sigma, sigma_tau=sigma_tau, rng=np.random.default_rng(0)).log
    return Spline(sigma=dict(zip(log.joints, sigma.tolist(), strict=True)))(log)


@pytest.mark.parametrize(
    ("model", "sigma_q", "sigma_tau", "ratio"),
    [
        *((model, *sigma, 1.0) for model in ARMS.values() for sigma in ((1e-6, 0.05), (2e-4, 0.02), (1e-3, 1e-3))),
        (ARMS["arm"], 1e-6, 1e-4, 100.0),
    ],
)
def test_the_true_parameters_leave_what_the_sensors_allow(
    model: Model, sigma_q: float, sigma_tau: float, ratio: float
) -> None:
    """Noise of the torque alone, both, and noise of the positions, which the smoother has left, alone; and of the
    positions of the second joint, in the torques of both."""
    errors = validate(model, model.values, recorded(model, sigma_q, sigma_tau, ratio)).errors
    assert errors.over_noise == pytest.approx(dict.fromkeys(errors.rmse, 1.0), rel=0.25)
    assert errors.all_over_noise == pytest.approx(1.0, rel=0.2)


@pytest.mark.parametrize("sigma_q", [2e-4, 1e-3])
def test_a_quintic_spline_lets_less_noise_through_and_this_is_counted(sigma_q: float) -> None:
    model = ARMS["pendulum"]
    log = record(moved(model), sigma_q=sigma_q, sigma_tau=1e-3, rng=np.random.default_rng(0)).log
    errors = validate(model, model.values, KalmanSmoother(sigma=sigma_q)(log)).errors
    assert errors.all_over_noise == pytest.approx(1.0, rel=0.25)


@pytest.mark.parametrize("order", [1, 2, 4])
@pytest.mark.parametrize("share", [0.05, 0.2])
def test_of_a_torque_that_was_filtered_it_is_not_known(order: int, share: float) -> None:
    model = ARMS["pendulum"]
    motion = recorded(model, 1e-5, 0.05)
    low = butterworth(order, share * 250.0, 500.0)
    filtered = replace(motion, tau=zero_phase(low, motion.tau.T.copy(), 100).T)
    assert sensor_noise(model, model.values, filtered) == {}
    assert sensor_noise(model, model.values, motion).keys() == set(motion.joints)


def test_of_a_torque_without_noise_it_is_not_known() -> None:
    model = ARMS["arm"]
    motion = recorded(model, 1e-5, 0.05)
    clean = motion.tau.copy()
    clean[:, 1] = model.torque(motion.q, motion.dq, motion.ddq, model.values)[:, 1]
    assert sensor_noise(model, model.values, replace(motion, tau=clean)).keys() == {motion.joints[0]}
    assert sensor_noise(model, model.values, replace(motion, tau=0 * clean)) == {}
