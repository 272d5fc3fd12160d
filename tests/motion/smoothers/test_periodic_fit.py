"""A log as one period: which rows and harmonics, and what is left."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.motion.log import Log
from dynident.motion.smoothers.periodic_fit import Period, PeriodicFitRequest, fit_periodic, misfit, periods_in, scatter


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
    found, sought = fit(np.sin(w * t) + 0.1 * np.sin(3.3 * w * t) + e, t, Period(4.0, 0.0), 4)
    share, bend = misfit(t[found.rows], found, sought)
    assert share[0] == pytest.approx(0.1, rel=0.1)
    assert bend[0] == pytest.approx(1.09 / np.hypot(1.0, 1.09), rel=0.1)
    found, sought = fit(np.sin(w * t) + e, t, Period(4.0, 0.0), 4)
    share, bend = misfit(t, found, sought)
    assert share[0] < 1e-3
    assert bend[0] < 0.04  # scatter of white noise in the band; a tenth is refused


@pytest.mark.parametrize("step", [0.01, 0.0137])
def test_scatter_is_that_of_the_noise_whether_or_not_samples_fall_on_samples(step: float) -> None:
    """What repeats cancels, of any size."""
    t = np.arange(20_000) * step
    q = 5 * np.sin(2 * np.pi * t / 2.0) * (step == 0.01) + 0.3 * np.random.default_rng(0).standard_normal(20_000)
    assert scatter(t, q[:, None], 2.0)[0] == pytest.approx(0.3, rel=0.02)


def test_periods_are_counted_by_what_samples_stand_for() -> None:
    assert periods_in(np.arange(800) * 0.01, 4.0) == pytest.approx(2.0)


def test_steps_of_an_encoder_that_repeat_are_no_harmonics() -> None:
    """Whole periods of whole samples: what is rounded is the same in each, and nothing is between the harmonics."""
    t = np.arange(2000) * 0.01
    w = 2 * np.pi / 10.0 * t
    q = 1e-3 * np.round(1e3 * (np.sin(w) + 0.2 * np.cos(3 * w)))
    assert fit(q, t, Period(10.0, 0.0))[0].harmonics[0] <= 7
