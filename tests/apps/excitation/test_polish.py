"""The end of a search: better than the barrier alone, and within all limits."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.apps.excitation import search as polish
from dynident.apps.excitation.search import (
    Plan,
    Stage,
    improve_motion,
    is_small_enough,
    polish_motion,
    random_motion,
    search,
)
from tests.apps.excitation.arms import LIMITS
from tests.apps.excitation.requests import interior

ONE = interior(limits=replace(LIMITS, torque=np.array([11.0, 3.5])))


def test_it_goes_on_where_the_barrier_ends_and_keeps_to_the_limits():
    x, before = improve_motion(ONE, random_motion(ONE, np.random.default_rng(0)), Stage(0.1, 20))
    better, after = polish_motion(ONE, x, 15)
    assert after < before - 0.5
    assert ONE.is_inside(better)
    assert after == pytest.approx(ONE.at(better, 0.0).criterion)


def test_without_a_better_motion_it_gives_the_one_it_began_with(monkeypatch):
    monkeypatch.setattr(polish, "EXCESS", -1.0)  # no iterate is good enough
    x = random_motion(ONE, np.random.default_rng(0))
    np.testing.assert_array_equal(polish_motion(ONE, x, 2)[0], x)


def test_the_slopes_of_the_constraints_are_theirs():
    rng = np.random.default_rng(1)
    x = random_motion(ONE, rng)
    step = 1e-6 * rng.normal(size=x.shape)
    found = (polish._limit_slacks(ONE, x + step) - polish._limit_slacks(ONE, x - step)) / 2
    np.testing.assert_allclose(polish._slack_jacobian(ONE, x) @ step.ravel(), found, atol=1e-9)


def test_large_problems_keep_to_the_barrier(monkeypatch):
    assert is_small_enough(ONE)
    monkeypatch.setattr(polish, "MAX_JACOBIAN_SIZE", 10)
    assert not is_small_enough(ONE)
    monkeypatch.setattr("dynident.apps.excitation.search.LARGE_PROBLEM_STAGES", (Stage(0.1, 4),))
    monkeypatch.setattr("dynident.apps.excitation.search.polish_motion", pytest.fail)
    found = search(ONE, Plan(1, (Stage(1.0, 4), Stage(0.0, 4))), np.random.default_rng(0))
    assert ONE.is_inside(found.x)
