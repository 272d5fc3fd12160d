"""Recursive filters are SciPy's, by the kernel on every level of this CPU and without it."""

import numpy as np
import pytest
from scipy import signal

from dynident.motion import filters
from dynident.motion.filters import butterworth, frequency_response, one_pole_filter, slowest_pole, welch, zero_phase
from tests.kernel_levels import BEST, NAMES, functions_of


@pytest.fixture(params=["off", *NAMES])
def level(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    if request.param not in ("off", *BEST):
        pytest.skip(f"there is no kernel for {request.param} here")
    monkeypatch.setattr(filters, "function", functions_of(request.param))
    return str(request.param)


@pytest.mark.parametrize("order", range(1, 13))
@pytest.mark.parametrize("cutoff", [0.5, 10.0, 45.0])
def test_butterworth_is_that_of_scipy(order: int, cutoff: float) -> None:
    mine, expected = butterworth(order, cutoff, 100.0), signal.butter(order, cutoff, fs=100.0, output="sos")
    assert mine.shape == expected.shape
    np.testing.assert_allclose(frequency_response(mine, 64), signal.sosfreqz(expected, 64)[1], rtol=1e-9, atol=1e-13)
    poles = signal.butter(order, cutoff, fs=100.0, output="zpk")[1]
    assert slowest_pole(mine) == pytest.approx(np.abs(poles).max(), rel=1e-12)


@pytest.mark.parametrize("order", [1, 3, 4, 12])
@pytest.mark.parametrize(("series", "samples"), [(1, 63), (3, 64), (8, 200), (17, 500)])
def test_zero_phase_is_sosfiltfilt(level: str, order: int, series: int, samples: int) -> None:
    x = np.random.default_rng(0).normal(size=(series, samples))
    before = x.copy()
    sections = butterworth(order, 12.0, 100.0)
    expected = signal.sosfiltfilt(sections, x, padlen=3 * order)
    np.testing.assert_allclose(zero_phase(sections, x, 3 * order), expected, atol=1e-12)
    np.testing.assert_allclose(zero_phase(sections, x.T, 3 * order, axis=0), expected.T, atol=1e-12)
    cube = x[:, None].repeat(2, axis=1)
    np.testing.assert_allclose(zero_phase(sections, cube, 3 * order), expected[:, None].repeat(2, axis=1), atol=1e-12)
    np.testing.assert_array_equal(x, before)


@pytest.mark.parametrize("pad", [0, 1, 3])
def test_short_series_are_extended_as_far_as_they_go(level: str, pad: int) -> None:
    x, sections = np.array([[1.0, -2.0, 0.5, 3.0]]), butterworth(2, 12.0, 100.0)
    np.testing.assert_allclose(zero_phase(sections, x, pad), signal.sosfiltfilt(sections, x, padlen=pad), atol=1e-13)
    with pytest.raises(ValueError, match="4"):
        zero_phase(sections, x, 4)


def test_one_pole_is_lfilter(level: str) -> None:
    x = np.random.default_rng(0).normal(size=(9, 300))
    for a in (0.0, 0.9, -0.5):
        np.testing.assert_allclose(one_pole_filter(a, x), signal.lfilter([1.0], [1.0, -a], x), atol=1e-12)
        np.testing.assert_allclose(
            one_pole_filter(a, x[:, ::2][0]), signal.lfilter([1.0], [1.0, -a], x[0, ::2]), atol=1e-12
        )
    assert one_pole_filter(a, x[:, :0]).shape == (len(x), 0)


@pytest.mark.skipif(len(BEST) < 2, reason="there is only one level here")
def test_all_levels_give_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    x, sections = np.random.default_rng(0).normal(size=(11, 321)), butterworth(5, 9.0, 100.0)
    result = []
    for name in BEST:
        monkeypatch.setattr(filters, "function", functions_of(name))
        result.append(zero_phase(sections, x, 15))
    for other in result[1:]:
        np.testing.assert_array_equal(result[0], other)


@pytest.mark.parametrize(("samples", "length"), [(1000, 64), (1001, 77), (50, 50)])
def test_welch_is_that_of_scipy(samples: int, length: int) -> None:
    x = np.cumsum(np.random.default_rng(0).normal(size=samples))
    frequency, power = welch(x, 0.01, length)
    expected = signal.welch(x, fs=100.0, nperseg=length, detrend="constant")
    np.testing.assert_allclose(frequency, expected[0], rtol=1e-13)
    np.testing.assert_allclose(power, expected[1], rtol=1e-9, atol=1e-12 * expected[1].max())
