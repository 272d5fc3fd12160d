"""Integrated Wiener processes: the banded splines against dense algebra and the recursion of the textbooks."""

import numpy as np
import pytest

from dynident.motion.smoothers import Order, posterior_errors, wiener
from dynident.runtime import InputError
from tests.motion.splines.wiener_reference import recursion, sampled

ORDERS: tuple[Order, ...] = (2, 3)
NONE = (None,)


def jittered(n: int, seed: int = 0) -> np.ndarray:
    return np.cumsum(np.random.default_rng(seed).uniform(0.2, 1.8, n))


def noisy(n: int, order: int, q: float, r: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    t, rng = jittered(n, seed), np.random.default_rng(seed + 1)
    return t, sampled(t, order, q, rng)[:, 0] + np.sqrt(r) * rng.standard_normal(n)


@pytest.mark.parametrize("order", ORDERS)
def test_is_what_kalman_rauch_tung_and_striebel_give(order: Order) -> None:
    t, y = noisy(300, order, 0.01, 0.5)
    means, spreads, _ = recursion(t, y, order, 0.5, 0.01)
    fit = wiener(t, y[:, None], order, [0.5**0.5], [0.01])
    kept = slice(order - 1, None)
    for k, result in enumerate((fit.values, fit.first_derivative, fit.second_derivative)[:order]):
        np.testing.assert_allclose(result[kept, 0], means[:, k], atol=1e-7 * np.abs(means[:, k]).max())
    errors = posterior_errors(t, order, np.array([0.5**0.5]), np.array([0.01]))
    np.testing.assert_allclose(errors[:, kept, 0].T ** 2, np.diagonal(spreads, axis1=1, axis2=2), rtol=1e-6)


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("reference", [None, 0.6])
def test_the_settings_are_the_likeliest(order: Order, reference: float | None) -> None:
    t, y = noisy(80, order, 0.02, 0.5, seed=3)
    fit = wiener(t, y[:, None], order, [reference], NONE)
    r, q = fit.sigma[0] ** 2, fit.intensity[0]
    best = recursion(t, y, order, r, q)[2]
    assert best >= max(recursion(t, y, order, r, q * k)[2] for k in (0.5, 0.95, 1.05, 2.0))
    if reference is None:
        assert best >= max(recursion(t, y, order, r * k, q)[2] for k in (0.9, 0.98, 1.02, 1.1))
    else:
        assert fit.sigma[0] == reference


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
    result, inside = [], []
    for seed in range(15):
        t, rng = jittered(200, seed), np.random.default_rng(seed)
        truth = sampled(t, order, 0.02, rng)
        fit = wiener(t, truth[:, :1] + 0.7 * rng.standard_normal((200, 1)), order, NONE, NONE)
        result.append((np.log(fit.sigma[0] / 0.7), np.log(fit.intensity[0] / 0.02)))
        errors = posterior_errors(t, order, fit.sigma, fit.intensity)[:, :, 0]
        states = np.stack([fit.values[:, 0], fit.first_derivative[:, 0], fit.second_derivative[:, 0]][:order])
        inside.append((np.abs(states - truth.T) < 1.96 * errors).mean(axis=1))
    spread = np.std(result, axis=0) / np.sqrt(15)
    assert (np.abs(np.mean(result, axis=0)) < 4 * spread).all()
    assert (np.abs(np.mean(inside, axis=0) - 0.95) < 0.04).all()


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
