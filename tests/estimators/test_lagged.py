"""Motions from before and after: exact for polynomials, and as far away as smoother and filter spread noise."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.estimators.instruments import cutoff_frequency, lag_of, lagged_instruments
from dynident.models.lagrangian import slider
from dynident.motion.filters import butterworth, zero_phase
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import Spline
from dynident.motion.splines import Fixed
from dynident.regression import ParallelFilter

STEP = 0.01
T = STEP * np.arange(400)


def polynomial(seed: int = 0) -> Motion:
    p = np.polynomial.Polynomial(np.random.default_rng(seed).standard_normal(6))
    q, dq, ddq = (one(T - 2.0)[:, None] for one in (p, p.deriv(), p.deriv(2)))
    return Motion(T, q, dq, ddq, 0 * q, ("slider",), np.ones(len(T), dtype=bool))


def test_a_polynomial_of_degree_five_is_found_exactly() -> None:
    """At lags of whole samples; the samples within a lag of the ends and of a gap have no instruments."""
    motion = polynomial()
    mask = np.abs(np.arange(len(T)) - 200) > 3
    gapped = Motion(T, motion.q, motion.dq, motion.ddq, motion.tau, motion.joints, mask)
    found = lagged_instruments(slider(), gapped, None, None, 5 * STEP)
    used = found.motion.mask
    for name in ("q", "dq", "ddq"):
        np.testing.assert_allclose(getattr(found.motion, name)[used], getattr(motion, name)[used], rtol=1e-5, atol=1e-4)
    assert found.lag == 5 * STEP
    away = np.abs(np.arange(len(T)) - 200)
    inside = (np.arange(len(T)) >= 6) & (np.arange(len(T)) < len(T) - 6)
    assert used[inside & (away > 9)].all()
    assert not used[(away < 8) & (away > 2)].any()
    assert not used[:5].any()
    assert not used[-5:].any()


@pytest.mark.parametrize("low", [5.0, 12.0])
def test_the_cutoff_is_that_of_a_low_pass(low: float) -> None:
    """Order 1 forward and backward passes half of the amplitude at its cut-off, in the presence of a large motion."""
    rng = np.random.default_rng(1)
    t = STEP * np.arange(20_000)
    before = (np.sin(2 * t) + 1e-4 * rng.standard_normal(len(t)))[:, None]
    after = zero_phase(butterworth(1, low, 1 / STEP), before[:, 0], 100)[:, None]
    assert cutoff_frequency(before, after) * 0.5 / STEP == pytest.approx(low, rel=0.1)
    assert cutoff_frequency(before, before) == 1.0
    assert cutoff_frequency(before[:8], before[:8]) == 1.0


def test_the_lag_grows_with_smoothing_and_filter() -> None:
    rng = np.random.default_rng(2)
    motion = polynomial()
    assert lag_of(motion, None, None) == pytest.approx(3 * STEP)
    slow = lag_of(motion, None, ParallelFilter(cutoff=5.0))
    assert slow > 1.5 * lag_of(motion, None, ParallelFilter(cutoff=10.0)) > 4 * STEP
    noisy = Log(T, motion.q + 1e-3 * rng.standard_normal(motion.q.shape), motion.tau, motion.joints)
    assert lag_of(motion, noisy, None) > lag_of(motion, None, None)


def test_errors_of_accelerations_are_no_longer_correlated_from_the_lag_on() -> None:
    """Those that a spline makes of white noise, of which chance leaves correlations of 0.02."""
    t, smoother = STEP * np.arange(20_000), Spline(Fixed(lam=1e-6))
    true, noise = np.sin(2 * t) + 0.3 * np.sin(7 * t), 1e-3 * np.random.default_rng(0).standard_normal(len(t))
    log, clean = (Log(t, one[:, None], 0 * one[:, None], ("slider",)) for one in (true + noise, true))
    motion, exact = smoother(log), smoother(clean)
    k = round(lag_of(motion, log, None) / STEP)
    e = (motion.ddq - exact.ddq)[motion.mask, 0]
    correlation = np.array([e[lag:] @ e[: len(e) - lag] for lag in range(200)]) / (e @ e)
    assert np.abs(correlation[k:]).max() < 0.03
    assert np.abs(correlation[k // 2 : k]).max() > 0.05
