"""The noise floor: a residual that equals the sensors' scatter is at it, one with a fault of the model is not."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from dynident.motion.log import Motion
from dynident.validation import FloorOrigin, LogValidation, NoiseFloor, Signals, TorqueErrors, with_floors

N, STEP, PERIOD, NOISE = 4000, 0.005, 10.0, 0.1
T = STEP * np.arange(N)


def log(rng: np.random.Generator, fault: float = 0.0, rho: float = 0.0, period: float = PERIOD, name: str = "a",
        white: bool = False) -> LogValidation:  # fmt: skip
    """A log of 20 s whose model leaves noise of deviation 0.1 and a fault, of this rms in noises, of the position."""
    angle = 2 * np.pi * T / period
    q = (np.sin(angle) + 0.4 * np.sin(3 * angle + 1.0))[:, None]
    predicted = 5.0 * np.cos(q)
    noise = NOISE * lfilter([np.sqrt(1 - rho**2)], [1.0, -rho], rng.standard_normal((N + 200, 1)), axis=0)[200:]
    wrong = np.sin(4.0 * q) - np.sin(4.0 * q).mean()
    tau = predicted + noise + fault * NOISE * wrong / wrong.std()
    motion = Motion(T, q, 0 * q, 0 * q, tau, ("hinge",), np.ones(N, dtype=bool), name)
    rmse = {"hinge": float(np.sqrt(np.mean((tau - predicted) ** 2)))}
    errors = TorqueErrors(N, 1.0, None, rmse, {"hinge": 1.0}, sensor_noise={"hinge": NOISE} if white else {})
    return LogValidation(name, "validation", errors, signals=Signals(motion, predicted))


def floor(validation: LogValidation, *others: LogValidation) -> NoiseFloor:
    return with_floors([validation, *others])[0].floors["hinge"]


@pytest.mark.parametrize("rho", [0.0, 0.8])
def test_the_scatter_of_a_motion_that_repeats_is_the_floor(rho: float) -> None:
    """Its size is that of the noise, white or not; the upper limit is missed in about 5 % of the cases."""
    result = [floor(log(np.random.default_rng(seed), rho=rho)) for seed in range(60)]
    assert {x.origin for x in result} == {FloorOrigin.REPEATS}
    assert np.mean([x.size for x in result]) == pytest.approx(NOISE, rel=0.02)
    assert np.mean([x.upper < 1.0 for x in result]) < 0.15  # 95 % of at least 9 in 60: at most 5 % true
    assert np.mean([x.is_reached for x in result]) > 0.9


def test_a_fault_of_the_model_is_above_the_floor() -> None:
    """A fault as large as the noise makes the ratio sqrt 2; the limit is below 1.15 in none of 40 cases."""
    result = [floor(log(np.random.default_rng(seed), fault=1.0, rho=0.8)) for seed in range(40)]
    assert np.mean([x.ratio for x in result]) == pytest.approx(np.sqrt(2.0), rel=0.05)
    assert not any(x.is_reached for x in result)


def test_a_fault_at_the_limit_is_called_the_floor_in_five_of_a_hundred() -> None:
    """Noise and a fault of rms sqrt(1.15^2 - 1) are 1.15 times the noise: the stated level."""
    fault = np.sqrt(1.15**2 - 1)
    called = np.mean([floor(log(np.random.default_rng(seed), fault, rho=0.5)).is_reached for seed in range(130)])
    assert called < 0.11  # 5 %, with 99.8 % confidence of the binomial


def test_white_noise_stands_in_where_nothing_repeats() -> None:
    result = [floor(log(np.random.default_rng(seed), period=47.0, white=True)) for seed in range(20)]
    assert {x.origin for x in result} == {FloorOrigin.WHITE}
    assert all(x.is_reached for x in result)
    assert not floor(log(np.random.default_rng(0), fault=1.0, period=47.0, white=True)).is_reached
    assert with_floors([log(np.random.default_rng(0), period=47.0)])[0].floors == {}


def test_passes_that_the_model_tells_apart_are_no_scatter() -> None:
    """The positions repeat, but a torque that the model predicts differs, as with pulses on a stiff drive."""
    test_log = log(np.random.default_rng(0))
    pushed = test_log.predicted_torque + np.where(T < PERIOD, 3 * NOISE, 0.0)[:, None]
    motion = replace(test_log.motion, tau=test_log.motion.tau + pushed - test_log.predicted_torque)
    assert with_floors([replace(test_log, signals=Signals(motion, pushed))])[0].floors == {}


def test_too_few_independent_samples_tell_nothing() -> None:
    test_log = log(np.random.default_rng(0), rho=0.998)
    assert "hinge" not in with_floors([test_log])[0].floors or not floor(test_log).is_reached
    silent = replace(
        test_log, signals=Signals(replace(test_log.motion, tau=test_log.predicted_torque), test_log.predicted_torque)
    )
    assert with_floors([silent])[0].floors == {}


@pytest.mark.parametrize("size", [0.0, 4.0])
def test_friction_that_changes_between_the_passes_is_no_scatter(size: float) -> None:
    """A friction that falls over the log leaves the floor at the noise, and the residual above it."""
    result = []
    for seed in range(20):
        test_log = log(np.random.default_rng(seed), rho=0.8)
        speed = np.gradient(test_log.motion.q, T, axis=0)
        changed = test_log.motion.tau + size * NOISE * np.sign(speed) * (0.5 - T[:, None] / T[-1])
        rmse = {"hinge": float(np.sqrt(np.mean((changed - test_log.predicted_torque) ** 2)))}
        signals = Signals(replace(test_log.motion, dq=speed, tau=changed), test_log.predicted_torque)
        result.append(floor(replace(test_log, errors=replace(test_log.errors, rmse=rmse), signals=signals)))
    assert np.mean([x.size for x in result]) == pytest.approx(NOISE, rel=0.03)
    assert np.mean([x.is_reached for x in result]) == pytest.approx(float(size == 0.0), abs=0.1)
