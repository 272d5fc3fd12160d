"""Integrated Wiener processes: the banded splines against dense algebra and the recursion of the textbooks."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.motion.smoothers import Order, posterior_errors, wiener
from dynident.motion.splines.banded import Grid, System, second_difference
from dynident.motion.splines.quintic import QuinticSystem
from dynident.runtime import InputError
from tests.motion.splines.wiener_reference import dense, recursion, sampled

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
    for result, mean in zip((fit.values, fit.first_derivative, fit.second_derivative), means, strict=True):
        np.testing.assert_allclose(result[:, 0], mean, atol=1e-6 * np.abs(mean).max())
    errors = posterior_errors(t, order, np.array([0.5**0.5]), np.array([q]))
    np.testing.assert_allclose(errors[:, :, 0] ** 2, variances, rtol=1e-5)


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
def test_the_likelihood_is_the_restricted_one_of_the_spline(order: Order) -> None:
    """Up to a constant that depends on the times alone."""
    t, y = noisy(60, order, 0.05, 0.5)
    t = (t - t[0]) * (len(t) - 1) / (t[-1] - t[0])
    left = []
    for r, q in ((0.5, 0.05), (0.1, 2.0), (3.0, 1e-3)):
        full, log_det = _banded(t, y, order, 0.5 * q / r)
        restricted = -0.5 * ((len(t) - order) * np.log(r) + log_det + full / r)
        left.append(recursion(t, y, order, r, q)[2] - restricted)
    assert np.ptp(left) < 1e-6


def _banded(t: np.ndarray, y: np.ndarray, order: int, p: float) -> tuple[float, float]:
    """y' Q u and the logarithm of the determinant, of which ``REML`` is made."""
    if order == 3:
        test_solution = QuinticSystem(np.diff(t)).solve(p, y)
        return test_solution.penalised_rss, test_solution.log_det
    system = System(Grid(np.diff(t)))
    solution = system.solve(p, second_difference(y, np.diff(t)), refine=False, trace=True)
    return solution.rss + p * solution.energy, solution.log_det


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
