"""What residuals look like: known series, and known causes."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from dynident.motion.filters import autocorrelation, ljung_box
from dynident.validation import (
    FrictionLevel,
    HighFrequency,
    LowFrequency,
    ResidualRipple,
    Reversals,
    decorrelation,
    residual_test,
)
from dynident.validation.residuals import _noise_moments

N, STEP = 4000, 0.005
T = np.arange(N) * STEP
DQ = np.cos(2 * np.pi * 0.3 * T)


def ar1(rho: float, n: int, seed: int) -> np.ndarray:
    """A stationary series of unit variance."""
    noise = np.random.default_rng(seed).standard_normal(n + 1000) * np.sqrt(1 - rho**2)
    return lfilter([1.0], [1.0, -rho], noise)[1000:]


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.9, 0.98])
def test_decorrelation_of_a_known_series(rho: float) -> None:
    """1 + 2 sum rho^k = (1 + rho) / (1 - rho); a mean of 20 series is within a tenth."""
    result = np.mean([decorrelation(autocorrelation(ar1(rho, 20_000, seed))) for seed in range(20)])
    assert result == pytest.approx((1 + rho) / (1 - rho), rel=0.1)


def test_white_noise_is_rejected_as_often_as_stated() -> None:
    """Of 1000 white series about 5 % have p < 0.05: between 3 and 7 % with 99 % confidence (binomial)."""
    rng = np.random.default_rng(1)
    rejected = np.mean([ljung_box(autocorrelation(rng.standard_normal(500)), 500) < 0.05 for _ in range(1000)])
    assert 0.03 < rejected < 0.07
    assert ljung_box(autocorrelation(ar1(0.5, 500, 0)), 500) < 1e-6


@pytest.mark.parametrize(("frequency", "low_share"), [(4.5, 1.0), (5.5, 0.0)])
def test_what_is_below_five_hertz_is_of_the_model(frequency: float, low_share: float) -> None:
    residual = np.sin(2 * np.pi * frequency * T) + 1e-3 * np.random.default_rng(0).standard_normal(N)
    test = residual_test(residual, DQ, STEP)
    assert test.low_share == pytest.approx(low_share, abs=0.02)
    assert (LowFrequency() in test.causes) == (low_share > 0.5)


def test_a_friction_that_is_missing_at_reversals_is_reported() -> None:
    residual = 0.01 * np.random.default_rng(2).standard_normal(N) + np.where(np.abs(DQ) < 0.03, 1.0, 0.0)
    test = residual_test(residual, DQ, STEP)
    assert test.reversal_share > 0.8
    assert test.slow_share < 0.05
    assert test.causes[0] == Reversals()
    for share, slow, is_said in ((0.14, 0.01, False), (0.3, 0.16, False), (0.3, 0.14, True)):
        assert (Reversals() in replace(test, reversal_share=share, slow_share=slow).causes) is is_said


def test_a_friction_of_another_level_is_reported() -> None:
    test = residual_test(0.1 * np.sign(DQ) + 0.02 * np.random.default_rng(3).standard_normal(N), DQ, STEP)
    assert test.sign_correlation > 0.9
    assert test.causes == (FrictionLevel(), LowFrequency())


def test_a_ripple_is_reported_with_its_frequency() -> None:
    test = residual_test(np.sin(2 * np.pi * 26 * T) + 0.3 * np.random.default_rng(4).standard_normal(N), DQ, STEP)
    assert test.peak == pytest.approx(26, abs=0.3)
    assert ResidualRipple(test.peak) in test.causes


def test_white_noise_is_no_ripple_and_no_model() -> None:
    test = residual_test(np.random.default_rng(5).standard_normal(N), DQ, STEP)
    assert test.p_value > 1e-3
    assert test.decorrelation == pytest.approx(STEP, rel=0.3)
    assert test.low_share == pytest.approx(0.05, abs=0.02)  # 5 of 100 Hz
    assert test.causes == (HighFrequency(),)


def test_the_moments_of_filtered_noise_are_those_of_its_correlation() -> None:
    """White noise and AR(1) by the sum of its autocorrelations rho^|k|, through the same filter."""
    w = (np.arange(20_000) + 0.5) * np.pi / 20_000
    passed = np.square((gain := 1 / (1 + (8.0 * w) ** 4)) * (1 - gain))
    for rho in (0.0, 0.6):
        spectrum = 1 + 2 * sum(rho**k * np.cos(k * w) for k in range(1, 60))
        power, bend_power, _ = _noise_moments(8.0, rho)
        assert power == pytest.approx(float(np.mean(passed * spectrum)), rel=1e-3)
        assert bend_power == pytest.approx(float(np.mean(w**4 * passed * spectrum)), rel=0.03)
