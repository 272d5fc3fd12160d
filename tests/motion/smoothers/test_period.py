"""The period of a motion: which, and how well it is known."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.motion.smoothers.periodic_fit import likely_periods, refine_period


def motion(t: np.ndarray, period: float) -> np.ndarray:
    w = 2 * np.pi / period
    return np.column_stack(
        (np.sin(w * t) + 0.2 * np.cos(3 * w * t + 1), 0.5 * np.cos(2 * w * t) + 0.1 * np.sin(5 * w * t))
    )


@pytest.mark.parametrize("period", [0.31, 3.7, 19.9])
def test_the_period_is_found_not_a_multiple(period: float) -> None:
    t = np.arange(8000) * 0.005
    q = motion(t, period) + 1e-3 * np.random.default_rng(0).standard_normal((8000, 2))
    assert likely_periods(t, q)[0] == pytest.approx(period, rel=1e-4)


def test_a_ripple_on_slow_motion_is_no_period() -> None:
    t = np.arange(6000) * 0.005
    q = np.column_stack([np.sin(0.2 * t**1.3) + 0.01 * np.sin(40 * t)])
    assert all(one > 1.0 for one in likely_periods(t, q))


@pytest.mark.parametrize("colour", [1, 20])
def test_the_period_is_within_its_standard_error(colour: int) -> None:
    """Over 80 logs the error in standard errors has mean 0 and deviation 1: within 0.75 and 1.25 with 99 % confidence
    where noise is white; coloured, within 0.6 and 1.4."""
    t, found = np.arange(1500) * 0.02, []
    for seed in range(80):
        e = np.random.default_rng(seed).standard_normal((1500 + colour - 1, 2))
        e = np.apply_along_axis(np.convolve, 0, e, np.full(colour, 1 / np.sqrt(colour)), mode="valid")
        one = refine_period(t, motion(t, 4.3) + 1e-2 * e, 4.32, 5, np.full(2, 1e-2))
        found.append((one.value - 4.3) / one.std)
    within = (0.75, 1.25) if colour == 1 else (0.6, 1.4)
    assert within[0] < np.std(found) < within[1]
    assert abs(np.mean(found)) < 0.4


def test_many_periods_do_not_lose_the_phase() -> None:
    """Off by 0.3 %, the phase is wrong by more than a turn of the fifth harmonic at the end of 200 periods."""
    t = np.arange(20_000) * 0.005
    assert refine_period(t, motion(t, 0.5), 0.5015, 5, np.ones(2)).value == pytest.approx(0.5, rel=1e-9)
