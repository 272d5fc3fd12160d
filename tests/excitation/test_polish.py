"""The end of a search: better than the barrier alone, and within all limits."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.excitation import polish
from dynident.excitation.polish import fits, polished
from dynident.excitation.random_motion import random_motion
from dynident.excitation.search import Stage, improved, search
from tests.excitation.arms import LIMITS
from tests.excitation.requests import interior

ONE = interior(limits=replace(LIMITS, torque=np.array([11.0, 3.5])))


def test_it_goes_on_where_the_barrier_ends_and_keeps_to_the_limits():
    x, before = improved(ONE, random_motion(ONE, np.random.default_rng(0)), Stage(0.1, 20))
    better, after = polished(ONE, x, 15)
    assert after < before - 0.5
    assert ONE.keeps(better)
    assert after == pytest.approx(ONE.at(better, 0.0).criterion)


def test_without_a_better_motion_it_gives_the_one_it_began_with(monkeypatch):
    monkeypatch.setattr(polish, "EXCESS", -1.0)  # no iterate is good enough
    x = random_motion(ONE, np.random.default_rng(0))
    np.testing.assert_array_equal(polished(ONE, x, 2)[0], x)


def test_the_slopes_of_the_constraints_are_theirs():
    rng = np.random.default_rng(1)
    x = random_motion(ONE, rng)
    step = 1e-6 * rng.normal(size=x.shape)
    found = (polish._slacks(ONE, x + step) - polish._slacks(ONE, x - step)) / 2
    np.testing.assert_allclose(polish._slopes(ONE, x) @ step.ravel(), found, atol=1e-9)


def test_large_problems_keep_to_the_barrier(monkeypatch):
    assert fits(ONE)
    monkeypatch.setattr(polish, "MOST", 10)
    assert not fits(ONE)
    monkeypatch.setattr("dynident.excitation.search.INSTEAD", (Stage(0.1, 4),))
    monkeypatch.setattr("dynident.excitation.search.polished", pytest.fail)
    found = search(ONE, 1, np.random.default_rng(0), stages=(Stage(1.0, 4), Stage(0.0, 4)))
    assert ONE.keeps(found.x)
