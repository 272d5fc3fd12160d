"""Integrated Wiener processes against dense algebra; the Kalman smoother of a log, joints at rest, encoders."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.motion.log import Log
from dynident.motion.smoothers import KalmanSmoother, Order, Spline, posterior_errors, wiener
from dynident.motion.splines import REML
from dynident.runtime import ConfigError, InputError
from tests.motion.splines.wiener_reference import dense, likelihood, sampled

ORDERS: tuple[Order, ...] = (2, 3)
NONE = (None,)


def jittered(n: int, seed: int = 0) -> np.ndarray:
    return np.cumsum(np.random.default_rng(seed).uniform(0.2, 1.8, n))


def noisy(n: int, order: int, q: float, r: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    t, rng = jittered(n, seed), np.random.default_rng(seed + 1)
    return t, sampled(t, order, q, rng)[:, 0] + np.sqrt(r) * rng.standard_normal(n)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("q", [1e-4, 0.1, 3.0])
def test_is_the_posterior_of_a_diffuse_start(order: Order, q: float) -> None:
    """Means of q, dq, ddq and standard errors, at all samples and at irregular times, by dense algebra."""
    t, y = noisy(15, order, q, 0.5)
    means, variances = dense(t, y, order, 0.5, q)
    fit = wiener(t, y[:, None], order, [0.5**0.5], [q])
    for found, mean in zip((fit.values, fit.first_derivative, fit.second_derivative), means, strict=True):
        np.testing.assert_allclose(found[:, 0], mean, atol=1e-6 * np.abs(mean).max())
    errors = posterior_errors(t, order, np.array([0.5**0.5]), np.array([q]))
    np.testing.assert_allclose(errors[:, :, 0] ** 2, variances, rtol=1e-5)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("known", [None, 0.6])
def test_the_settings_are_the_likeliest(order: Order, known: float | None) -> None:
    t, y = noisy(80, order, 0.02, 0.5, seed=3)
    fit = wiener(t, y[:, None], order, [known], NONE)
    r, q = fit.sigma[0] ** 2, fit.intensity[0]
    best = likelihood(t, y, order, r, q)
    assert best >= max(likelihood(t, y, order, r, q * k) for k in (0.5, 0.95, 1.05, 2.0))
    if known is None:
        assert best >= max(likelihood(t, y, order, r * k, q) for k in (0.9, 0.98, 1.02, 1.1))
    else:
        assert fit.sigma[0] == known


@pytest.mark.parametrize("order", ORDERS)
def test_long_data_are_smoothed_by_all_of_them(order: Order) -> None:
    """The middle, at rest here, only says where the search starts."""
    rng, n = np.random.default_rng(0), 20_000
    t = np.arange(n) * 1e-3
    moving = np.sin(3 * (t - 10)) + np.sin(9) * np.sign(10 - t)
    y = np.where(np.abs(t - 10) > 3, moving, 0.0) + 1e-3 * rng.standard_normal(n)
    fit = wiener(t, y[:, None], order, NONE, NONE)
    assert fit.sigma[0] == pytest.approx(1e-3, rel=0.05)


@pytest.mark.parametrize("order", ORDERS)
def test_noise_and_intensity_are_found_and_intervals_cover(order: Order) -> None:
    """Of 15 processes: means of the errors within four standard errors, 95 % intervals over 91 to 99 %."""
    found, inside = [], []
    for seed in range(15):
        t, rng = jittered(200, seed), np.random.default_rng(seed)
        truth = sampled(t, order, 0.02, rng)
        fit = wiener(t, truth[:, :1] + 0.7 * rng.standard_normal((200, 1)), order, NONE, NONE)
        found.append((np.log(fit.sigma[0] / 0.7), np.log(fit.intensity[0] / 0.02)))
        errors = posterior_errors(t, order, fit.sigma, fit.intensity)[:, :, 0]
        states = np.stack([fit.values[:, 0], fit.first_derivative[:, 0], fit.second_derivative[:, 0]][:order])
        inside.append((np.abs(states - truth.T) < 1.96 * errors).mean(axis=1))
    spread = np.std(found, axis=0) / np.sqrt(15)
    assert (np.abs(np.mean(found, axis=0)) < 4 * spread).all()
    assert (np.abs(np.mean(inside, axis=0) - 0.95) < 0.04).all()


@pytest.mark.parametrize("order", ORDERS)
def test_polynomials_pass_as_they_are(order: Order) -> None:
    t = jittered(200)
    y = np.column_stack([np.zeros(200), np.full(200, 2.0), 3 - t, t**2])[:, : order + 1]
    fit = wiener(t, y, order, [None] * (order + 1), [None] * (order + 1))
    np.testing.assert_allclose(fit.values, y, atol=1e-9)
    np.testing.assert_array_equal(fit.intensity, 0.0)
    assert np.isinf(fit.bandwidth).all()
    assert (fit.sigma > 0).all()
    again = wiener(t, y, order, fit.sigma.tolist(), fit.intensity.tolist())
    np.testing.assert_allclose(again.second_derivative, fit.second_derivative, atol=1e-10)


@pytest.mark.parametrize("order", ORDERS)
def test_few_samples(order: Order) -> None:
    rng = np.random.default_rng(0)
    for n in range(order + 1, 9):
        for _ in range(5):
            y = rng.standard_normal((n, 2))
            y[:, 1] = np.round(y[:, 1])
            fit = wiener(np.cumsum(rng.uniform(1e-3, 1, n)), y, order, [None] * 2, [None] * 2)
            assert np.isfinite(fit.second_derivative).all()
    with pytest.raises(InputError, match=f"order {order} needs {order + 1} samples, got {order}"):
        wiener(np.arange(order) * 1.0, np.zeros((order, 1)), order, NONE, NONE)


def test_what_cannot_be_smoothed_is_named() -> None:
    t = np.arange(10.0)
    with pytest.raises(InputError, match="t\\[5\\]"):
        wiener(np.where(t == 5, 3.0, t), np.zeros((10, 1)), 3, NONE, NONE)


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


def test_the_noise_is_found_or_given_by_joint() -> None:
    made = KalmanSmoother(sigma={"b": 2e-3})(log(moving()))
    assert made.smoothing["sigma"][1] == 2e-3
    assert made.smoothing["sigma"][0] == pytest.approx(1e-3, rel=0.05)
    assert made.smoothing["noise"] == pytest.approx((1e-3, 1e-3), rel=0.05)  # too large a noise is seen in what is left
    alone = KalmanSmoother()(log(moving()))
    np.testing.assert_array_equal(made.q[:, 0], alone.q[:, 0])
    assert made.smoothing["cutoff"][1] < alone.smoothing["cutoff"][1]


def test_order_two_is_the_spline_of_restricted_maximum_likelihood() -> None:
    one = log(moving(), jitter=0.8)
    made, spline = KalmanSmoother(2)(one), Spline(REML())(one)
    for name in ("q", "dq", "ddq"):
        found, other = getattr(made, name), getattr(spline, name)
        np.testing.assert_allclose(found, other, atol=1e-9 * np.abs(other).max())
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
    for found, truth, error in zip((made.q, made.dq, made.ddq), true, errors, strict=True):
        inside = np.mean(np.abs(found - truth) < 1.96 * error)
        assert 0.9 < inside < 0.99
    assert KalmanSmoother(2).standard_errors(KalmanSmoother(2)(log(moving(n=300)))).shape == (2, 300, 2)


def test_too_few_samples_are_said() -> None:
    with pytest.raises(InputError, match="made: an integrated Wiener process of order 3 needs 4 samples, got 3"):
        KalmanSmoother()(log(moving(n=3)))
    assert np.isfinite(KalmanSmoother()(log(moving(n=4))).ddq).all()
