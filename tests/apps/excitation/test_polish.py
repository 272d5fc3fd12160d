"""The end of the search: better motions that keep to all limits."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.apps.excitation import polish
from dynident.apps.excitation.polish import limit_slacks, polish_motion, slack_jacobian
from dynident.apps.excitation.search import Stage, improve_motion, random_motion
from tests.apps.excitation.arms import LIMITS
from tests.apps.excitation.requests import interior

TIGHT_TORQUE = interior(limits=replace(LIMITS, torque=np.array([11.0, 3.5])))


def test_a_longer_polish_is_better_and_goes_on_where_the_barrier_ends_within_the_limits():
    x, value = improve_motion(TIGHT_TORQUE, random_motion(TIGHT_TORQUE, np.random.default_rng(0)), Stage(0.1, 20))
    start = value
    for steps in (1, 5, 15):
        better, after = polish_motion(TIGHT_TORQUE, x, steps)
        assert after <= value
        assert TIGHT_TORQUE.is_inside(better)
        assert after == pytest.approx(TIGHT_TORQUE.at(better, 0.0).criterion)
        value = after
    assert value < start - 0.5


def test_at_the_best_motion_no_small_step_within_the_limits_gains():
    rng = np.random.default_rng(3)
    x, _ = improve_motion(TIGHT_TORQUE, random_motion(TIGHT_TORQUE, rng), Stage(0.1, 40))
    best, value = polish_motion(TIGHT_TORQUE, x, 200)
    for _ in range(40):
        near = TIGHT_TORQUE.shrink(best + 1e-2 * rng.normal(size=x.shape) * np.abs(best).max())
        if near is not None:
            assert TIGHT_TORQUE.information.value(*TIGHT_TORQUE.states(near)[:3]) > value - 0.01


def test_a_solver_that_fails_makes_no_step(monkeypatch):
    class Failing:
        def __init__(self, *_: object) -> None:
            pass

        def solve(self):
            return type("Solution", (), {"x": [np.nan], "z": [np.nan]})()

    monkeypatch.setattr("clarabel.DefaultSolver", Failing)
    x = random_motion(TIGHT_TORQUE, np.random.default_rng(0))
    np.testing.assert_array_equal(polish_motion(TIGHT_TORQUE, x, 3)[0], x)


def test_without_a_better_motion_it_gives_the_one_it_began_with(monkeypatch):
    monkeypatch.setattr(polish, "EXCESS", -1.0)  # no iterate is good enough
    x = random_motion(TIGHT_TORQUE, np.random.default_rng(0))
    np.testing.assert_array_equal(polish_motion(TIGHT_TORQUE, x, 2)[0], x)


def test_the_curvature_follows_the_gradient_and_stays_positive():
    B, change = np.diag([2.0, 3.0]), np.array([1.0, -0.5])
    for bend in (np.array([3.0, 1.0]), np.array([0.3, 0.6]), np.array([-4.0, 1.0])):  # convex, nearly flat, concave
        curved = polish._update_curvature(B, change, bend)
        expected = B @ change
        low = 0.2 * change @ expected  # Powell: no smaller curvature along a change than this share of the last
        assert change @ curved @ change == pytest.approx(max(change @ bend, low))
        assert np.linalg.eigvalsh(curved).min() > 0
        if change @ bend > low:
            np.testing.assert_allclose(curved @ change, bend)


def test_the_slopes_of_the_constraints_are_theirs():
    rng = np.random.default_rng(1)
    x = random_motion(TIGHT_TORQUE, rng)
    step = 1e-6 * rng.normal(size=x.shape)
    change = (limit_slacks(TIGHT_TORQUE, x + step) - limit_slacks(TIGHT_TORQUE, x - step)) / 2
    np.testing.assert_allclose(slack_jacobian(TIGHT_TORQUE, x) @ step.ravel(), change, atol=1e-9)
