"""Series of harmonics: least squares by sums (of FFT and of powers), factorised once; the noise between harmonics."""

import numpy as np
import pytest

from dynident.motion.smoothers.harmonics import (
    choose_by_bic,
    factor_of,
    fit_series,
    highest_harmonic,
    noise_power,
    series_values,
)

EVEN = 3.0 + 0.01 * np.arange(5000)  # more than are summed at once


def design(t: np.ndarray, period: float, harmonics: int) -> np.ndarray:
    w = 2 * np.pi / period * t
    return np.column_stack(
        [np.ones_like(t), *(f(k * w) for k in range(1, harmonics + 1) for f in (np.cos, np.sin))],
    )


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


def test_a_line_that_stands_out_is_seen_and_noise_is_none() -> None:
    t, e = np.arange(2000) * 0.01, np.random.default_rng(4).normal(size=(2000, 50))
    assert highest_harmonic(t, e, 3.7, 100) == 0
    e[:, 7] += np.sin(2 * np.pi * 61 / 3.7 * t)
    assert highest_harmonic(t, e, 3.7, 100) == 61
    assert highest_harmonic(t, np.zeros((2000, 1)), 3.7, 100) == 0


def times(kind: str) -> np.ndarray:
    uneven = EVEN + 0.004 * np.random.default_rng(0).uniform(size=5000)
    return {"even": EVEN, "uneven": uneven, "gap": np.where(EVEN > 20.0, EVEN + 3.3, EVEN), "late": EVEN + 1e9}[kind]


@pytest.mark.parametrize("kind", ["even", "uneven", "gap"])
def test_each_column_has_its_own_number_of_harmonics(kind: str) -> None:
    """By one factor, each as by the dense design of its own number."""
    t, each = times(kind)[:900], np.array([0, 3, 40, 17])
    q = np.random.default_rng(2).normal(size=(900, 4))
    result = fit_series(t, q, 4.1, each)(t, 0)[0]
    for j, count in enumerate(each):
        X = design(t, 4.1, count)
        np.testing.assert_allclose(result[:, j], X @ np.linalg.lstsq(X, q[:, j])[0], atol=1e-9)


def test_times_from_anywhere_are_even() -> None:
    """Seconds since 1970 are rounded to 1e-7 s, which is no unevenness."""
    delayed = times("late")
    assert factor_of(delayed, 7.3, 30).sines is not None
    c = np.ones((31, 1), dtype=complex)
    np.testing.assert_allclose(series_values(delayed, c, 7.3, 1e9), series_values(EVEN, c, 7.3, 0.0), atol=1e-4)


def test_samples_that_do_not_determine_it_are_refused() -> None:
    for t in (EVEN[:30], times("uneven")[:30]):
        with pytest.raises(np.linalg.LinAlgError):
            factor_of(t, 7.3, 20)
