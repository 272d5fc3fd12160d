"""The difference-based noise estimate: statistics with a stated confidence, irregular times, weights, limits."""

import numpy as np
import pytest
from scipy.signal import lfilter

from dynident.motion.splines import coloured_noise, median_sigma, noise_sigma, smooth, steady_noise
from dynident.runtime import InputError


def bound(n: int) -> float:
    """4.9 standard deviations (1e-6, two-sided): the squared differences of order 4 are correlated, factor below 4."""
    return 4.9 * np.sqrt(4.0 / n) / 2


@pytest.mark.parametrize("kind", ["uniform", "jittered"])
@pytest.mark.parametrize("sigma", [1e-6, 1e-2])
def test_white_noise_on_a_moving_joint(kind: str, sigma: float) -> None:
    rng = np.random.default_rng(0)
    n = 20_000
    t = np.cumsum(1e-3 * (1 + (0.5 if kind == "jittered" else 0.0) * rng.uniform(-1, 1, n)))
    y = np.column_stack((np.sin(3 * t), 1e3 + 5 * t + np.cos(2 * t))) + sigma * rng.standard_normal((n, 2))
    np.testing.assert_allclose(noise_sigma(t, y), sigma, rtol=bound(n))


def test_quantised_standstill_reads_as_silence() -> None:
    """The stated limit: a quantised encoder at rest shows no noise at all."""
    t = np.arange(1000) * 1e-3
    assert noise_sigma(t, np.round(0.3 * np.ones(1000) / 1e-3) * 1e-3)[0] < 1e-15
    t = np.arange(50) * 0.01  # but the rounding of the data
    np.testing.assert_allclose(noise_sigma(t, np.full(50, 1e3)), 4e3 * np.finfo(float).eps, rtol=1e-9)
    assert noise_sigma(t, np.zeros(50))[0] == 1e-100


def test_few_samples_by_hand() -> None:
    """Fourth differences of even samples are 1, -4, 6, -4, 1, of squared norm 70."""
    y = np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    assert noise_sigma(np.arange(6), y)[0] == pytest.approx(np.sqrt((16 + 1) / 2 / 70))
    assert noise_sigma(np.arange(4), y[:4], order=2)[0] == pytest.approx(np.sqrt((4 + 1) / 2 / 6))


def test_too_few() -> None:
    with pytest.raises(InputError, match="at least 6 samples, got 5"):
        noise_sigma(np.arange(5), np.arange(5))


def test_steady_noise_does_not_see_a_step() -> None:
    rng = np.random.default_rng(0)
    x = rng.standard_normal((4000, 1)) * 0.1 + np.sin(np.arange(4000) / 500)[:, None]
    x[2000:] += 50
    assert steady_noise(x, 1e-9)[0] == pytest.approx(0.1, rel=0.06)
    # the other one does: fourth differences of a step of 50 are 50 times 1, -3, 3, -1, of squared norm 20 of 70
    assert noise_sigma(np.arange(4000), x)[0] == pytest.approx(np.sqrt(0.1**2 + 50**2 * 20 / 70 / 3996), rel=0.02)


def test_steady_noise_is_no_less_than_a_share_of_the_largest_value() -> None:
    np.testing.assert_allclose(steady_noise(np.array([[2.0, 0.0]] * 10), 1e-3), 2e-3)
    np.testing.assert_allclose(steady_noise(np.zeros((10, 2)), 1e-3), 1e-3)


def test_median_sigma_does_not_see_outliers() -> None:
    x = 0.1 * np.random.default_rng(0).standard_normal((20_000, 2))
    x[::50] = 100.0
    np.testing.assert_allclose(median_sigma(x), 0.1, rtol=0.05)


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9])
def test_coloured_noise_is_seen_in_what_was_smoothed_away(rho: float) -> None:
    """Five deviations of an estimate of rho from 8000 samples, (1 - rho^2) / 8000, and of the deviation at 0.9."""
    rng, t = np.random.default_rng(1), np.arange(8000) * 4e-3
    fresh = np.sqrt(1 - rho**2) * rng.standard_normal((9000, 2))
    noise = lfilter([1.0], [1.0, -rho], fresh, axis=0)[1000:]
    y = np.stack([np.sin(t), np.cos(2 * t)], axis=1) + 1e-3 * noise
    fitted = smooth(t, y, sigma=np.full(2, 1e-3))
    sigma, result = coloured_noise(t, y, y - fitted.values, fitted.bandwidth)
    np.testing.assert_allclose(result, rho, atol=5 * np.sqrt((1 - rho**2) / 8000) + 0.02)
    np.testing.assert_allclose(sigma, 1e-3, rtol=0.15)


def test_coloured_noise_is_read_above_twice_the_cut_off_alone() -> None:
    """A tone below twice the cut-off, where motion is left in the residual, changes nothing; one above it does."""
    n, h = 4000, 4e-3
    t = np.arange(n) * h
    y = 1e-3 * np.random.default_rng(4).standard_normal((n, 1))
    cutoff = 200 / (n * h)  # of a whole number of periods
    width = np.array([(np.sqrt(2.0) - 1.0) ** 0.25 / (2 * np.pi * cutoff)])

    def with_tone(times: float) -> np.ndarray:
        tone = 5e-4 * np.sin(2 * np.pi * times * cutoff * t)[:, None]
        return np.concatenate(coloured_noise(t, y, y + tone, width))

    without = np.concatenate(coloured_noise(t, y, y, width))
    np.testing.assert_allclose(with_tone(397 / 200), without, rtol=1e-4)
    assert with_tone(404 / 200)[1] > without[1] + 0.2
