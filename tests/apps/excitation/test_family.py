"""Families of motions: derivatives, periods, rest at the ends, and bounds that hold between points of a grid."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynident.apps.excitation.family import ClampedSpline, Fourier, LinearCourse

seeds = st.integers(0, 2**32 - 1)


@given(seeds, st.integers(2, 8), st.floats(0.5, 20.0))
@settings(max_examples=40)
def test_each_is_the_derivative_of_the_one_before_and_a_series_repeats(seed, size, duration):
    rng = np.random.default_rng(seed)
    for family in (Fourier(duration, size), ClampedSpline(duration, size)):
        h = 1e-5 * duration / size
        edges = np.linspace(0, duration, size + 1)  # of the spans, where the jerk of a spline has kinks
        t = rng.uniform(edges[:-1] + 9 * h, edges[1:] - 9 * h)
        here, before, after = (family.values(t + step) for step in (0.0, -h, h))
        sizes = np.abs(here).max(axis=(1, 2))[1:, None, None]
        assert (np.abs((after - before)[:3] / (2 * h) - here[1:]) <= 1e-6 * sizes).all()
        assert here.shape == (4, size, family.size)
    series = Fourier(duration, size).values(t)
    later = Fourier(duration, size).values(t + duration)
    np.testing.assert_allclose(later, series, atol=1e-9 * np.abs(series).max())


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


@given(seeds, st.floats(-20, 20))
@settings(max_examples=40)
def test_a_shifted_series_is_the_same_later(seed, shift):
    family, rng = Fourier(5.0, 4), np.random.default_rng(seed)
    x, t = rng.normal(size=(3, family.size)), rng.uniform(0, 5, 6)
    later = LinearCourse(family, family.shift(x, shift)).states(t)
    np.testing.assert_allclose(later, LinearCourse(family, x).states(t + shift), atol=1e-9)


@given(seeds, st.integers(2, 20), st.floats(0.5, 40.0))
@settings(max_examples=40)
def test_a_motion_begins_and_ends_at_rest_in_the_same_pose(seed, spans, duration):
    family, x = ClampedSpline(duration, spans), np.random.default_rng(seed).normal(size=(3, spans))
    q, dq, ddq, _ = LinearCourse(family, x).states(np.array([0.0, duration]))
    np.testing.assert_allclose(q, np.stack([x[:, 0]] * 2), atol=1e-12)
    assert np.abs(dq).max() * duration / spans < 1e-9
    assert np.abs(ddq).max() * (duration / spans) ** 2 < 1e-9
    shifted = x + np.eye(spans)[0]
    t = np.linspace(0, duration, 7)
    np.testing.assert_allclose(LinearCourse(family, shifted).states(t)[0] - LinearCourse(family, x).states(t)[0], 1.0)


@given(seeds, st.integers(2, 15), st.integers(1, 200))
@settings(max_examples=40)
def test_control_points_within_limits_keep_the_motion_within_them_everywhere(seed, spans, points):
    family, rng = ClampedSpline(7.0, spans), np.random.default_rng(seed)
    guard, fine = family.guard(points), family.values(np.linspace(0, 7.0, 1000))
    x = rng.normal(size=spans)
    for d in range(4):
        middle = float(rng.normal())
        bound = np.abs(guard.rows[d] @ x - middle).max() / guard.share
        reached = np.abs(fine[d] @ x - middle).max()
        assert reached <= bound * (1 + 1e-9)


def test_refined_control_points_give_little_away():
    family, x = ClampedSpline(10.0, 10), np.random.default_rng(1).normal(size=10)
    guard, fine = family.guard(200), family.values(np.linspace(0, 10.0, 4000))
    for d in range(4):
        assert np.abs(guard.rows[d] @ x).max() < 1.02 * np.abs(fine[d] @ x).max()
