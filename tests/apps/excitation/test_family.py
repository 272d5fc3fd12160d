"""Families of motions: derivatives, and bounds that hold between the points of a grid and are close."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynident.apps.excitation.family import ClampedSpline, Fourier

seeds = st.integers(0, 2**32 - 1)


@pytest.mark.parametrize("family", [Fourier(7.0, 4), ClampedSpline(7.0, 9)])
def test_each_is_the_derivative_of_the_one_before(family):
    t, h = np.linspace(0.1, 6.9, 50), 1e-5
    slopes = (family.values(t + h) - family.values(t - h))[:3] / (2 * h)
    np.testing.assert_allclose(slopes, family.values(t)[1:], atol=1e-5 * np.abs(slopes).max())


@given(seeds, st.integers(1, 8), st.floats(1.05, 12.0))
@settings(max_examples=40)
def test_what_is_within_the_share_on_the_grid_is_within_the_limits_everywhere(seed, harmonics, density):
    family, rng = Fourier(7.0, harmonics), np.random.default_rng(seed)
    guard = family.guard(int(np.ceil(2 * harmonics * density)) + 1)
    fine = family.values(np.linspace(0, 7.0, 1500))
    x = rng.normal(size=family.size) * rng.uniform(0, 1, family.size) ** 3
    for d in range(4):
        middle = float(rng.normal())
        half = np.abs(guard.rows[d] @ x - middle).max() / guard.share
        assert np.abs(fine[d] @ x - middle).max() <= half * (1 + 1e-12)


def test_a_pure_cosine_between_the_points_reaches_the_bound():
    family = Fourier(1.0, 3)
    guard = family.guard(12)
    x = np.zeros(7)
    x[5], x[6] = 3 * np.sin(3 * np.pi / 12), 3 * np.cos(3 * np.pi / 12)  # largest half a step after 0
    on_grid = np.abs(guard.rows[0] @ x).max()
    assert on_grid == pytest.approx(guard.share)
    assert np.abs(family.values(np.array([1 / 24]))[0] @ x)[0] == pytest.approx(1.0)


def test_refined_control_points_give_little_away():
    family, x = ClampedSpline(10.0, 10), np.random.default_rng(1).normal(size=10)
    guard, fine = family.guard(200), family.values(np.linspace(0, 10.0, 4000))
    for d in range(4):
        assert np.abs(guard.rows[d] @ x).max() < 1.02 * np.abs(fine[d] @ x).max()
