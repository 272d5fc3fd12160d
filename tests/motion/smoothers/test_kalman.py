"""The Kalman smoother of a log: its standard errors, encoders, and data without noise."""

import numpy as np
import pytest

from dynident.motion.log import Log
from dynident.motion.smoothers import KalmanSmoother, Order, Spline
from dynident.motion.splines import REML
from dynident.runtime import ConfigError, InputError

ORDERS: tuple[Order, ...] = (2, 3)


def log(q: np.ndarray, h: float = 0.0025, jitter: float = 0.0) -> Log:
    rng, q = np.random.default_rng(9), q.reshape(len(q), -1)
    t = np.arange(len(q)) * h
    t += jitter * h * rng.uniform(-0.5, 0.5, len(q))
    return Log(t, q, np.zeros(q.shape), tuple("abc"[: q.shape[1]]), "made")


def moving(noise: float = 1e-3, n: int = 4001, h: float = 0.0025) -> np.ndarray:
    t = np.arange(n) * h
    return np.column_stack((np.sin(t), np.cos(2 * t))) + noise * np.random.default_rng(0).standard_normal((n, 2))


def test_an_intensity_needs_its_noise() -> None:
    with pytest.raises(ConfigError, match="intensity is given without sigma"):
        KalmanSmoother(intensity=1.0)
    with pytest.raises(ConfigError, match="intensity of joint 'b' is given without its sigma"):
        KalmanSmoother(sigma={"a": 1e-3}, intensity={"b": 1.0})(log(moving()))


def test_order_two_is_the_spline_of_restricted_maximum_likelihood() -> None:
    test_log = log(moving(), jitter=0.8)
    made, spline = KalmanSmoother(2)(test_log), Spline(REML())(test_log)
    for name in ("q", "dq", "ddq"):
        result, other = getattr(made, name), getattr(spline, name)
        np.testing.assert_allclose(result, other, atol=1e-9 * np.abs(other).max())
    assert made.smoothing["bandwidth"] == pytest.approx(spline.smoothing["bandwidth"])
    assert made.smoothing["cutoff"] == pytest.approx(spline.smoothing["cutoff"])


@pytest.mark.parametrize("order", ORDERS)
def test_without_noise_nothing_is_smoothed_away(order: Order) -> None:
    """The likelihood has no bound then: the noise becomes that of rounding, or of what the process cannot follow."""
    made = KalmanSmoother(order)(log(moving(noise=0.0)))
    t = made.t
    assert max(made.smoothing["sigma"]) < 2e-6
    assert np.abs(made.ddq[:, 0] + np.sin(t))[made.mask].max() < 5e-3
    assert made.mask.mean() > 0.98


@pytest.mark.parametrize("count", [1e-5, 1e-3])
def test_a_quantised_encoder_is_smoothed(count: float) -> None:
    """Its error is uniform over a count: of standard deviation count / sqrt(12)."""
    made = KalmanSmoother()(log(np.round(moving(noise=0.0) / count) * count))
    assert made.smoothing["sigma"] == pytest.approx((count / 12**0.5,) * 2, rel=0.35)
    assert np.abs(made.ddq[:, 0] + np.sin(made.t))[made.mask].max() < 40 * count**0.5


def test_standard_errors_cover() -> None:
    """Of a joint whose jerk is white: 95 % intervals of q, dq, ddq hold the truth at 90 to 99 % of the samples."""
    rng, n, h = np.random.default_rng(2), 3000, 0.01
    jerk = np.cumsum(np.concatenate((np.zeros((20, 1)), rng.standard_normal((20 * (n - 1), 1)))), axis=0)
    fine = h / 20
    ddq = jerk * fine**0.5
    dq = np.cumsum(ddq, axis=0) * fine
    q = np.cumsum(dq, axis=0) * fine
    true = [x[::20] for x in (q, dq, ddq)]
    smoother = KalmanSmoother()
    made = smoother(log(true[0] + 0.01 * rng.standard_normal((n, 1)), h=h))
    errors = smoother.standard_errors(made)
    assert errors.shape == (3, n, 1)
    for result, truth, error in zip((made.q, made.dq, made.ddq), true, errors, strict=True):
        inside = np.mean(np.abs(result - truth) < 1.96 * error)
        assert 0.9 < inside < 0.99
    assert KalmanSmoother(2).standard_errors(KalmanSmoother(2)(log(moving(n=300)))).shape == (2, 300, 2)


def test_too_few_samples_are_said() -> None:
    with pytest.raises(InputError, match="made: an integrated Wiener process of order 3 needs 4 samples, got 3"):
        KalmanSmoother()(log(moving(n=3)))
    assert np.isfinite(KalmanSmoother()(log(moving(n=4))).ddq).all()
