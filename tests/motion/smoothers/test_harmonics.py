"""Series of harmonics: least squares, by normal equations of sums, and the noise between harmonics."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.motion.smoothers.harmonics import (
    choose_by_bic,
    fit_series,
    highest_harmonic,
    noise_correction,
    noise_power,
)


def design(t: np.ndarray, period: float, harmonics: int) -> np.ndarray:
    w = 2 * np.pi / period * t
    return np.column_stack(
        [np.ones_like(t), *(f(k * w) for k in range(1, harmonics + 1) for f in (np.cos, np.sin))],
    )


@pytest.mark.parametrize("uneven", [False, True])
def test_it_is_least_squares(uneven: bool) -> None:
    rng = np.random.default_rng(0)
    t = np.sort(rng.uniform(3.0, 10.0, 500)) if uneven else 3.0 + np.arange(500) * 0.014
    q = rng.normal((0.0, 50.0), size=(500, 2))
    series = fit_series(t, q, 2.7, 6)
    X = design(t, 2.7, 6)
    np.testing.assert_allclose(series(t, 0)[0], X @ np.linalg.lstsq(X, q)[0], atol=1e-10)


def test_derivatives_are_exact() -> None:
    t, w = np.linspace(0.0, 7.0, 3000), 2 * np.pi / 3.1
    series = fit_series(t, (np.sin(w * t) + 0.3 * np.cos(4 * w * t))[:, None], 3.1, 5)
    q, dq, ddq = series(t)[..., 0]
    np.testing.assert_allclose(q, np.sin(w * t) + 0.3 * np.cos(4 * w * t), atol=1e-12)
    np.testing.assert_allclose(dq, w * np.cos(w * t) - 1.2 * w * np.sin(4 * w * t), atol=1e-11)
    np.testing.assert_allclose(ddq, -(w**2) * np.sin(w * t) - 4.8 * w**2 * np.cos(4 * w * t), atol=1e-10)


def test_over_whole_periods_it_is_the_average_period() -> None:
    """With all harmonics below half the rate, the series passes through the mean of the periods (Swevers, 1997)."""
    rng, size = np.random.default_rng(1), 41
    t, q = np.arange(5 * size) * 0.01, rng.normal(size=(5 * size, 1))
    average = q.reshape(5, size).mean(axis=0)
    np.testing.assert_allclose(fit_series(t, q, 0.41, 20)(t[:size], 0)[0, :, 0], average, atol=1e-12)


def test_noise_is_amplified_as_known() -> None:
    """Of a series of H harmonics over N samples, q has the variance sigma^2 (2 H + 1) / N, and ddq sigma^2 2 / N times
    the sum of (k w)^4."""
    rng, w, H, N = np.random.default_rng(2), 2 * np.pi / 2.0, 4, 400
    t = np.arange(N) * 0.01
    q, _, ddq = fit_series(t, rng.normal(size=(N, 3000)), 2.0, H)(t)
    known = (2 * H + 1) / N, 2 / N * np.sum((np.arange(1, H + 1) * w) ** 4)
    assert q.var() == pytest.approx(known[0], rel=0.03)
    assert ddq.var() == pytest.approx(known[1], rel=0.03)


def test_too_few_samples_do_not_determine_it() -> None:
    with pytest.raises(np.linalg.LinAlgError):
        fit_series(np.arange(5) * 0.1, np.ones((5, 1)), 0.5, 4)


@pytest.mark.parametrize("rho", [0.0, 0.95])
def test_the_noise_of_a_harmonic_is_found_between_them(rho: float) -> None:
    """The mean of |c_k|^2 over many series is that of the estimates, but for what a slope of the spectrum makes of
    neighbouring lines; for white and for coloured noise."""
    rng, N = np.random.default_rng(3), 2000
    t, e = np.arange(N) * 0.01, rng.normal(size=(N, 400))
    for k in range(1, N):
        e[k] += rho * e[k - 1]
    series = fit_series(t, e, 4.0, 12)
    stated = noise_power(t, e - series(t, 0)[0], 4.0, 12)
    seen = np.square(np.abs(series.coefficients))
    ratio = stated[1:].mean(axis=1) / seen[1:].mean(axis=1)
    assert 0.85 < ratio.mean() < 1.25
    assert np.abs(np.log(ratio)).max() < 0.4
    assert (choose_by_bic(series, stated, N) == 0).mean() > 0.95


def test_a_fit_takes_one_line_of_so_many() -> None:
    assert noise_correction(2.0) == pytest.approx(2.0)
    assert noise_correction(10.0) == pytest.approx(10 / 9)


def test_a_line_that_stands_out_is_seen_and_noise_is_none() -> None:
    t, e = np.arange(2000) * 0.01, np.random.default_rng(4).normal(size=(2000, 50))
    assert highest_harmonic(t, e, 3.7, 100) == 0
    e[:, 7] += np.sin(2 * np.pi * 61 / 3.7 * t)
    assert highest_harmonic(t, e, 3.7, 100) == 61
    assert highest_harmonic(t, np.zeros((2000, 1)), 3.7, 100) == 0
