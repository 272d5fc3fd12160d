"""Polynomials around each sample: SciPy's at even times, and least squares at any."""

import numpy as np
import pytest
from scipy.signal import savgol_filter

from dynident.motion.smoothers import savitzky_golay as local_polynomials
from dynident.motion.smoothers.savitzky_golay import fit_polynomials, is_even, order_differences

RNG = np.random.default_rng(0)


def uneven(samples: int) -> np.ndarray:
    return np.sort(np.random.default_rng(1).uniform(0.0, 10.0, samples))


@pytest.mark.parametrize(("start", "shift", "expected"), [(0.0, 1e-10, True), (1e9, 0.0, True), (0.0, 1e-8, False)])
def test_stamps_are_even_but_for_rounding(start: float, shift: float, expected: bool) -> None:
    """The eighth is shifted by a share of the step."""
    t = start + 0.02 * (np.arange(500) + shift * (np.arange(500) == 7))
    assert is_even(t) is expected


@pytest.mark.parametrize(("half", "order"), [(3, 4), (10, 2), (40, 5)])
def test_at_even_times_it_is_scipys(half: int, order: int) -> None:
    q, step = np.cumsum(RNG.normal(size=(300, 2)), axis=0), 0.01
    made = fit_polynomials(np.arange(300) * step, q, half, order)
    for k, result in enumerate(made[:3]):
        expected = savgol_filter(q, 2 * half + 1, order, k, step, axis=0)
        np.testing.assert_allclose(result, expected, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("half", [4, 90])
def test_at_uneven_times_it_is_least_squares(half: int) -> None:
    t = uneven(400)
    q, order = np.sin(t)[:, None] + 0.1 * RNG.normal(size=(400, 1)) + 7.0, 4
    polynomials = fit_polynomials(t, q, half, order)
    for row in (half, 200, 399 - half, 399):
        first = min(max(row - half, 0), 400 - 2 * half - 1)
        part = slice(first, first + 2 * half + 1)
        curve = np.polynomial.Polynomial.fit(t[part], q[part, 0], order)
        for k, made in enumerate(polynomials[:3]):
            assert made[row, 0] == pytest.approx(curve.deriv(k)(t[row]), rel=1e-6)


def test_running_sums_are_least_squares_and_count_the_same_degrees_of_freedom(monkeypatch: pytest.MonkeyPatch) -> None:
    t = uneven(900)
    q = np.stack([np.sin(t), np.cos(3 * t)], axis=1)
    swept = fit_polynomials(t, q, 100, 4)
    monkeypatch.setattr(local_polynomials, "MIN_SWEPT_HALF", 10**6)
    plain = fit_polynomials(t, q, 100, 4)
    for first, second in zip(swept[:3], plain[:3], strict=True):
        np.testing.assert_allclose(first, second, atol=1e-9 * np.abs(second).max())
    assert swept[3] == pytest.approx(plain[3], rel=1e-9)


def test_noise_makes_two_orders_differ_by_its_known_gain() -> None:
    """Its variance is that of ddq of the lower order times the gain, which of a parabola is known in full."""
    t, half, sigma = np.arange(40_000) * 0.01, 10, 0.3
    q = sigma * np.random.default_rng(2).standard_normal((40_000, 1))
    rows = np.arange(half, 40_000 - half)
    squares, gain = order_differences(t, q, half, (2, 4), rows)
    m = np.arange(-half, half + 1)
    lower = 4.0 / np.square(m**2 - np.mean(m**2)).sum() / 0.01**4  # of ddq by a parabola, for unit noise
    assert squares[0] == pytest.approx(gain * lower * sigma**2, rel=0.05)
    q, dq, ddq, _ = fit_polynomials(t, q, half, 2)
    inside = slice(half, -half)
    assert ddq[inside].var() == pytest.approx(lower * sigma**2, rel=0.05)
    assert dq[inside].var() == pytest.approx(sigma**2 / np.square(m * 0.01).sum(), rel=0.05)
