"""A log as one period: which, and how well it is known; which harmonics, and what is left."""

import numpy as np
import pytest

from dynident.motion.log import Log
from dynident.motion.smoothers.periodic_fit import (
    Period,
    PeriodicFitRequest,
    fit_periodic,
    likely_periods,
    misfit,
    refine_period,
)


def motion(t: np.ndarray, period: float) -> np.ndarray:
    w = 2 * np.pi / period
    return np.column_stack(
        (np.sin(w * t) + 0.2 * np.cos(3 * w * t + 1), 0.5 * np.cos(2 * w * t) + 0.1 * np.sin(5 * w * t))
    )


@pytest.mark.parametrize("period", [0.31, 3.7, 19.9])
def test_the_period_is_found_not_a_multiple(period: float) -> None:
    t = np.arange(4000) * 0.01
    q = motion(t, period) + 1e-3 * np.random.default_rng(0).standard_normal((4000, 2))
    assert likely_periods(t, q)[0] == pytest.approx(period, rel=1e-4)


@pytest.mark.parametrize("colour", [1, 10])
def test_the_period_is_within_its_standard_error(colour: int) -> None:
    """Over 80 logs the error in standard errors has mean 0 and deviation 1: within 0.75 and 1.25 with 99 % confidence
    where noise is white; coloured, within 0.6 and 1.4."""
    t, result = np.arange(750) * 0.04, []
    for seed in range(80):
        e = np.random.default_rng(seed).standard_normal((750 + colour - 1, 2))
        e = np.apply_along_axis(np.convolve, 0, e, np.full(colour, 1 / np.sqrt(colour)), mode="valid")
        case = refine_period(t, motion(t, 4.3) + 1e-2 * e, 4.32, 5, np.full(2, 1e-2))
        result.append((case.value - 4.3) / case.std)
    within = (0.75, 1.25) if colour == 1 else (0.6, 1.4)
    assert within[0] < np.std(result) < within[1]
    assert abs(np.mean(result)) < 0.4


def test_many_periods_do_not_lose_the_phase() -> None:
    """Off by 0.3 %, the phase is wrong by more than a turn of the fifth harmonic at the end of 200 periods."""
    t = np.arange(20_000) * 0.005
    assert refine_period(t, motion(t, 0.5), 0.5015, 5, np.ones(2)).value == pytest.approx(0.5, rel=1e-9)


def fit(q: np.ndarray, t: np.ndarray, period: Period, harmonics: int | None = None):
    sought = PeriodicFitRequest([harmonics], False, np.array([True]), np.array([1e-3]))
    return fit_periodic(Log(t, q[:, None], q[:, None], ("a",)), slice(0, len(t)), period, sought), sought


def test_a_period_with_an_error_is_refined_and_another_is_not() -> None:
    t = np.arange(3000) * 0.01
    q = np.sin(2 * np.pi / 4.0 * t) + 1e-3 * np.random.default_rng(0).standard_normal(3000)
    assert fit(q, t, Period(4.01, np.inf))[0].period.value == pytest.approx(4.0, abs=1e-4)
    assert fit(q, t, Period(4.01, 0.0))[0].period.value == 4.01


def test_what_is_left_is_a_share_of_motion_and_acceleration() -> None:
    """A tenth of the motion at three times its frequency: nine tenths of the acceleration; white noise is none."""
    t = np.arange(4000) * 0.01
    w = 2 * np.pi / 4.0
    e = 1e-3 * np.random.default_rng(0).standard_normal(4000)
    result, sought = fit(np.sin(w * t) + 0.1 * np.sin(3.3 * w * t) + e, t, Period(4.0, 0.0), 4)
    share, bend = misfit(t[result.rows], result, sought)
    assert share[0] == pytest.approx(0.1, rel=0.1)
    assert bend[0] == pytest.approx(1.09 / np.hypot(1.0, 1.09), rel=0.1)
    result, sought = fit(np.sin(w * t) + e, t, Period(4.0, 0.0), 4)
    share, bend = misfit(t, result, sought)
    assert share[0] < 1e-3
    assert bend[0] < 0.04  # scatter of white noise in the band; a tenth is refused


def test_steps_of_an_encoder_that_repeat_are_no_harmonics() -> None:
    """Whole periods of whole samples: what is rounded is the same in each, and nothing is between the harmonics."""
    t = np.arange(2000) * 0.01
    w = 2 * np.pi / 10.0 * t
    q = 1e-3 * np.round(1e3 * (np.sin(w) + 0.2 * np.cos(3 * w)))
    assert fit(q, t, Period(10.0, 0.0))[0].harmonics[0] <= 7
