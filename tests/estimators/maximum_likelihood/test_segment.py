"""One log with its splines: costs, gradients and normal equations."""

import numpy as np
import pytest

from dynident.apps.article import SCENARIOS
from dynident.estimators.maximum_likelihood import Hypothesis, Sigma, equations, leverage, plan_segment
from dynident.models.lagrangian import two_link_arm


def article_segment(*, rest: bool = True, stop: float = 0.5):
    scenario = SCENARIOS["stated"]
    log = scenario.record(1e-6, np.random.default_rng(0)).log.window(stop=stop)
    return plan_segment(log, (), 20.0, np.full(2, 0.1), from_rest=rest)


class TestSegment:
    @pytest.mark.parametrize("rest", [True, False])
    def test_gradient_is_that_of_the_cost(self, rng: np.random.Generator, rest: bool) -> None:
        arm, case = two_link_arm(), article_segment(rest=rest)
        theta, sigma = np.asarray(arm.values), Sigma(np.full(2, 1e-3), np.full(2, 0.1))
        state = case.initial_state(sigma.q, np.full(2, 30.0))
        result = equations(case, Hypothesis(arm, theta, sigma), state)
        assert result.cost == pytest.approx(case.cost(arm, state, theta, sigma))
        k = result.border.shape[1] - 7
        dC, dW = 1e-7 * rng.standard_normal(state.C.size), 1e-5 * rng.standard_normal(k)
        dtheta = 1e-6 * theta * rng.standard_normal(7)
        if rest:
            dC[:2] = 0.0  # they follow the next two
        ends = []
        for sign in (1, -1):
            moved = case.move(state, sign * dC, sign * dW)
            ends.append(case.cost(arm, moved, theta + sign * dtheta, sigma))
        along = result.by_coefficients @ dC + result.by_border @ np.concatenate([dW, dtheta])
        assert (ends[1] - ends[0]) / 2 == pytest.approx(along, rel=1e-3)

    def test_bend_is_the_mixed_second_derivative(self, rng: np.random.Generator) -> None:
        """The gradient by C changes with theta by the border and the bend."""
        arm, case = two_link_arm(), article_segment()
        theta, sigma = np.asarray(arm.values), Sigma(np.full(2, 1e-3), np.full(2, 0.1))
        state = case.initial_state(sigma.q, np.full(2, 30.0))
        here = equations(case, Hypothesis(arm, theta, sigma), state)
        dtheta = 1e-6 * theta * rng.standard_normal(7)
        there, back = (equations(case, Hypothesis(arm, theta + s * dtheta, sigma), state) for s in (1, -1))
        change = (there.by_coefficients - back.by_coefficients) / 2
        expected = -(here.border[:, -7:] + here.mixed_hessian) @ dtheta
        np.testing.assert_allclose(change, expected, rtol=1e-2, atol=1e-3 * np.abs(expected).max())

    def test_leverage_counts_the_coefficients(self) -> None:
        """Positions, torques and the equations between samples share the coefficients; none takes a negative part."""
        arm, case = two_link_arm(), article_segment(rest=False)
        sigma = Sigma(np.full(2, 1e-3), np.full(2, 0.1))
        state = case.initial_state(sigma.q, np.full(2, 30.0))
        taken = leverage(case, Hypothesis(arm, np.asarray(arm.values), sigma), state)
        assert (taken > 0).all()
        # without a step there are no equations between samples
        assert taken.sum() == pytest.approx(2 * case.trajectory.size, rel=1e-6)
