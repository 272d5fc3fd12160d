"""Motions between ramps and ways: from rest to rest, continuous, and within the limits."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynident.apps.excitation import Purpose, Trajectory, verify
from dynident.apps.excitation.family import ClampedSpline, Fourier
from dynident.apps.excitation.limits import Feasibility
from dynident.apps.excitation.way import RAMP_IN, RAMP_OUT, from_rest
from tests.apps.excitation.arms import AROUND, FREE, LIMITS, MODEL, THETA, scaled, smooth_and_at_rest

seeds = st.integers(0, 2**32 - 1)


@given(seeds, st.integers(1, 3), st.booleans())
@settings(max_examples=12)
def test_a_series_begins_and_ends_at_rest_and_all_pieces_meet(seed, periods, chosen):
    rng, family = np.random.default_rng(seed), Fourier(6.0, 4)
    x, start = scaled(family, rng, share=0.6), None if chosen else np.array([0.3, -0.4])
    pieces = from_rest(FREE, family.course(x), periods, start, rng)
    trajectory = Trajectory(LIMITS.joints, pieces)
    first, last = smooth_and_at_rest(trajectory)
    np.testing.assert_allclose(first, last, atol=1e-9)
    if not chosen:
        np.testing.assert_allclose(first, start, atol=1e-12)
    assert [one.label for one in pieces if one.purpose is Purpose.MOTION] == [str(k + 1) for k in range(periods)]
    assert sum(one.label in (RAMP_IN, RAMP_OUT) for one in pieces) == 2
    verify(trajectory, Feasibility(MODEL, THETA, LIMITS))


def test_the_periods_are_those_of_the_series_from_another_phase_on():
    rng, family = np.random.default_rng(5), Fourier(6.0, 4)
    x = scaled(family, rng, share=0.6)
    pieces = from_rest(FREE, family.course(x), 1, None, rng)
    (course,) = (one.course for one in pieces if one.purpose is Purpose.MOTION)
    t = np.linspace(0, 6.0, 601)
    given = family.course(x).states(t)[0]
    found = course.states(np.array([0.0]))[0]
    assert np.abs(given - found).max(axis=1).min() < 0.02
    np.testing.assert_allclose(np.hypot(course.x[:, 1::2], course.x[:, 2::2]), np.hypot(x[:, 1::2], x[:, 2::2]))


def test_a_spline_needs_no_ramp():
    rng, family = np.random.default_rng(2), ClampedSpline(8.0, 10)
    x = scaled(family, rng, share=0.6)
    pieces = from_rest(FREE, family.course(x), 2, np.array([0.5, 0.5]), rng)
    assert [one.purpose.value for one in pieces] == ["way", "motion", "motion", "way"]
    smooth_and_at_rest(Trajectory(LIMITS.joints, pieces))
    assert len(from_rest(FREE, family.course(x), 2, None, rng)) == 2


def test_without_a_way_there_is_no_motion():
    rng, family = np.random.default_rng(2), Fourier(6.0, 4)
    inside = np.zeros(2)  # of the post
    assert from_rest(AROUND, family.course(0.1 * scaled(family, rng)), 1, inside, rng) is None
    fast = scaled(family, rng, share=5.0)
    assert from_rest(FREE, family.course(fast), 1, None, rng) is None or pytest.fail("beyond the limits")
