"""One log with its splines: costs, gradients and normal equations."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.apps.article import SCENARIOS
from dynident.estimators.maximum_likelihood import Hypothesis, Sigma, equations, leverage, plan_segment, scores
from dynident.estimators.maximum_likelihood.trajectory import basis
from dynident.models.lagrangian import two_link_arm
from dynident.motion.log import Log


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

    @pytest.mark.parametrize("rest", [False, True])
    def test_positions_summed_up_lose_nothing_where_a_joint_has_turned_far(self, rest: bool) -> None:
        case = article_segment(rest=rest)
        case = replace(case, log=replace(case.log, q=case.log.q + np.array([0.0, 1e5])))
        state = case.initial_state(np.full(2, 1e-4), np.full(2, 1e3))
        left = case.offset(state)
        share, squares = case.shares(state)
        np.testing.assert_allclose(squares, (left**2).sum(axis=0), rtol=1e-6)
        np.testing.assert_allclose(share, case.position_basis.values.T @ left, atol=1e-4 * np.abs(left).max())

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

    def test_few_points_stand_for_many_torques(self) -> None:
        """Cost, gradient and information are those of all samples."""
        arm, case = two_link_arm(), article_segment(stop=2.0)
        theta, sigma = np.asarray(arm.values), Sigma(np.full(2, 1e-3), np.full(2, 0.1))
        state = case.initial_state(sigma.q, np.full(2, 30.0))
        few = case.condense(arm, state, theta, sigma.tau)
        assert len(few.points) < 0.7 * len(case.points)
        assert few.torques.weight[:, 0].sum() == pytest.approx(len(case.log))
        a, b = (equations(segment, Hypothesis(arm, theta, sigma), state) for segment in (case, few))
        assert a.cost == pytest.approx(b.cost, rel=1e-7)
        for name in ("band", "corner", "by_coefficients", "by_border"):
            wanted = getattr(a, name)
            np.testing.assert_allclose(getattr(b, name), wanted, rtol=1e-5, atol=1e-6 * np.abs(wanted).max())

    def test_scores_add_up_to_the_gradient(self) -> None:
        arm, case = two_link_arm(), article_segment(rest=False)
        theta, sigma = np.asarray(arm.values), Sigma(np.full(2, 1e-3), np.full(2, 0.1))
        state = case.initial_state(sigma.q, np.full(2, 30.0))
        result = equations(case, Hypothesis(arm, theta, sigma), state)
        follow = np.ones((len(result.band[0]), 7))
        pulls = scores(case, Hypothesis(arm, theta, sigma), state, follow)
        np.testing.assert_allclose(pulls.sum(axis=0), result.by_border - result.by_coefficients.sum(), rtol=1e-9)

    def test_late_positions(self) -> None:
        """Positions stamped late show an earlier motion: with the time offset known the trajectory is the same."""
        log = SCENARIOS["stated"].record(1e-6, np.random.default_rng(0)).log.window(1.0, 2.0)
        test_log = Log(log.t, np.roll(log.q, 2, axis=0), log.tau, log.joints)
        time_offset, noise = 2 * (log.t[1] - log.t[0]), (np.full(2, 1e-3), np.full(2, 30.0))
        states = []
        for case in (
            plan_segment(log, (), 20.0, np.full(2, 0.1), from_rest=False),
            plan_segment(test_log, (), 20.0, np.full(2, 0.1), from_rest=False, time_offset=time_offset),
        ):
            local = basis(case.trajectory, np.array([1.5]), from_rest=False).local[0, 0]
            at = case.trajectory.first_coefficient[case.trajectory.interval(np.array([1.5]))[0]]
            states.append(local @ case.initial_state(*noise).C[at : at + 5])
            assert case.raw.t[-1] <= case.trajectory.breaks[-1] + 1e-12
        np.testing.assert_allclose(states[1], states[0], atol=5e-3)

    def test_starts_from_rest(self) -> None:
        case = article_segment()
        _, dq, _ = case.motion(case.initial_state(np.full(2, 1e-3), np.full(2, 30.0)))
        assert case.points[0] == 0.0
        np.testing.assert_allclose(dq[0], 0.0, atol=1e-12)


def test_torque_between_the_samples_after_a_step_is_linear_up_to_the_last_knot() -> None:
    t = np.arange(200) * 0.01
    log = Log(t, np.sin(t)[:, None], np.cos(t)[:, None], ("a",))
    case = plan_segment(log, (), 20.0, np.full(1, 0.1), from_rest=True)
    (knots,), between = case.torque_knots, ~case.is_measured
    assert (case.points[between].min(), case.points[between].max()) == (knots[0], knots[-1])
    np.testing.assert_allclose(case.hats @ (2 + 3 * knots), np.where(between, 2 + 3 * case.points, 0.0), rtol=1e-12)
