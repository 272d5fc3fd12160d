"""Splines of a trajectory, one log with them, and a segment without its trajectory: products, gradients, equations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import BSpline

from dynident.apps.article import SCENARIOS
from dynident.estimators.maximum_likelihood import (
    Equations,
    Hypothesis,
    Sigma,
    SplineTrajectory,
    equations,
    leverage,
    plan_segment,
)
from dynident.estimators.maximum_likelihood.equations import scores
from dynident.estimators.maximum_likelihood.newton import Elimination
from dynident.estimators.maximum_likelihood.trajectory import DEGREE, Arrow, graded_breaks
from dynident.models.lagrangian import two_link_arm
from dynident.motion.log import Log
from dynident.runtime import ModelError


class TestTrajectory:
    def test_agrees_with_scipy(self, rng: np.random.Generator) -> None:
        path = SplineTrajectory(np.array([0.0, 0.1, 0.3, 0.7, 1.0]))
        t = np.sort(rng.uniform(0, 1, 50))
        local, first = path.local(t), path.first_coefficient[path.interval(t)]
        for order in range(3):
            whole = np.zeros((50, path.size))
            whole[np.arange(50)[:, None], first[:, None] + np.arange(5)] = local[order]
            spline = BSpline(path.knots, np.eye(path.size), DEGREE)
            np.testing.assert_allclose(whole, spline.derivative(order)(t) if order else spline(t), atol=1e-10)

    def test_acceleration_jumps_at_a_step_only(self, rng: np.random.Generator) -> None:
        path = SplineTrajectory(np.array([0.0, 0.2, 0.5, 0.8, 1.0]), steps=(0.5,))
        C = rng.standard_normal(path.size)

        def value(t: float, order: int) -> float:
            return float(
                path.local(np.array([t]))[order, 0] @ C[path.first_coefficient[path.interval(np.array([t]))[0]] :][:5]
            )

        for order, jumps in ((0, False), (1, False), (2, True)):
            gap = abs(value(0.5 + 1e-9, order) - value(0.5 - 1e-9, order))
            assert (gap > 1e-3) == jumps
        assert abs(value(0.2 + 1e-9, 2) - value(0.2 - 1e-9, 2)) < 1e-4

    def test_breaks_are_dense_after_a_step(self) -> None:
        breaks = graded_breaks((0.0, 10.0), [3.0], 0.01, 0.5, 1.3)
        assert (breaks[0], breaks[-1]) == (0.0, 10.0)
        assert 3.0 in breaks
        size = np.diff(breaks)
        assert size[breaks[:-1] < 3.0].min() > 0.4
        assert size[breaks[:-1] >= 3.0][0] <= 0.01
        assert size.max() <= 0.5 + 1e-12


T = np.linspace(0.0, 1.0, 41)


class TestArrow:
    def matrix(self, rng: np.random.Generator, size: int = 14, w: int = 4) -> tuple[np.ndarray, np.ndarray]:
        L = np.tril(rng.standard_normal((size, size))) * (np.abs(np.subtract.outer(range(size), range(size))) < w)
        A = (L + 3 * np.eye(size)) @ (L + 3 * np.eye(size)).T
        band = np.zeros((w, size))
        for d in range(w):
            band[d, : size - d] = np.diag(A, -d)
        return A, band

    def test_solves_and_inverts(self, rng: np.random.Generator) -> None:
        A, band = self.matrix(rng)
        B = rng.standard_normal((14, 3))
        arrow, inverse = Arrow(band, B), np.linalg.inv(A)
        np.testing.assert_allclose(arrow.solve_band(B), inverse @ B, rtol=1e-10)
        np.testing.assert_allclose(arrow.solve_transposed(arrow.half), inverse @ B, rtol=1e-10)
        np.testing.assert_allclose(arrow.lost_information, B.T @ inverse @ B, rtol=1e-10)
        for d in range(4):
            np.testing.assert_allclose(arrow.inverse[d, : 14 - d], np.diag(inverse, -d), rtol=1e-9, atol=1e-14)

    def test_refuses_what_is_not_determined(self) -> None:
        with pytest.raises(ModelError, match="not determined"):
            Arrow(np.zeros((2, 5)), np.zeros((5, 1))).solve_band(np.ones((5, 1)))


def article_segment(*, rest: bool = True, stop: float = 0.5):
    scenario = SCENARIOS["stated"]
    log = scenario.record(1e-6, np.random.default_rng(0)).log.window(stop=stop)
    return plan_segment(log, (), 20.0, np.full(2, 0.1), from_rest=rest)


class TestSegment:
    @pytest.mark.parametrize("rest", [True, False])
    def test_gradient_is_that_of_the_cost(self, rng: np.random.Generator, rest: bool) -> None:
        arm, one = two_link_arm(), article_segment(rest=rest)
        theta, sigma = np.asarray(arm.values), Sigma(np.full(2, 1e-3), np.full(2, 0.1))
        state = one.initial_state(sigma.q, np.full(2, 30.0))
        found = equations(one, Hypothesis(arm, theta, sigma), state)
        assert found.cost == pytest.approx(one.cost(arm, state, theta, sigma))
        k = found.border.shape[1] - 7
        dC, dW = 1e-7 * rng.standard_normal(state.C.size), 1e-5 * rng.standard_normal(k)
        dtheta = 1e-6 * theta * rng.standard_normal(7)
        if rest:
            dC[:2] = 0.0  # they follow the next two
        ends = []
        for sign in (1, -1):
            moved = one.move(state, sign * dC, sign * dW)
            ends.append(one.cost(arm, moved, theta + sign * dtheta, sigma))
        along = found.by_coefficients @ dC + found.by_border @ np.concatenate([dW, dtheta])
        assert (ends[1] - ends[0]) / 2 == pytest.approx(along, rel=1e-3)

    @pytest.mark.parametrize("rest", [False, True])
    def test_positions_summed_up_lose_nothing_where_a_joint_has_turned_far(self, rest: bool) -> None:
        one = article_segment(rest=rest)
        one = replace(one, log=replace(one.log, q=one.log.q + np.array([0.0, 1e5])))
        state = one.initial_state(np.full(2, 1e-4), np.full(2, 1e3))
        left = one.offset(state)
        share, squares = one.shares(state)
        np.testing.assert_allclose(squares, (left**2).sum(axis=0), rtol=1e-6)
        np.testing.assert_allclose(share, one.position_basis.values.T @ left, atol=1e-4 * np.abs(left).max())

    def test_bend_is_the_mixed_second_derivative(self, rng: np.random.Generator) -> None:
        """The gradient by C changes with theta by the border and the bend."""
        arm, one = two_link_arm(), article_segment()
        theta, sigma = np.asarray(arm.values), Sigma(np.full(2, 1e-3), np.full(2, 0.1))
        state = one.initial_state(sigma.q, np.full(2, 30.0))
        here = equations(one, Hypothesis(arm, theta, sigma), state)
        dtheta = 1e-6 * theta * rng.standard_normal(7)
        there, back = (equations(one, Hypothesis(arm, theta + s * dtheta, sigma), state) for s in (1, -1))
        change = (there.by_coefficients - back.by_coefficients) / 2
        expected = -(here.border[:, -7:] + here.mixed_hessian) @ dtheta
        np.testing.assert_allclose(change, expected, rtol=1e-2, atol=1e-3 * np.abs(expected).max())

    def test_scores_add_up_to_the_gradient(self) -> None:
        arm, one = two_link_arm(), article_segment(rest=False)
        theta, sigma = np.asarray(arm.values), Sigma(np.full(2, 1e-3), np.full(2, 0.1))
        state = one.initial_state(sigma.q, np.full(2, 30.0))
        found = equations(one, Hypothesis(arm, theta, sigma), state)
        follow = np.ones((len(found.band[0]), 7))
        pulls = scores(one, Hypothesis(arm, theta, sigma), state, follow)
        np.testing.assert_allclose(pulls.sum(axis=0), found.by_border - found.by_coefficients.sum(), rtol=1e-9)

    def test_leverage_counts_the_coefficients(self) -> None:
        """Positions, torques and the equations between samples share the coefficients; none takes a negative part."""
        arm, one = two_link_arm(), article_segment(rest=False)
        sigma = Sigma(np.full(2, 1e-3), np.full(2, 0.1))
        state = one.initial_state(sigma.q, np.full(2, 30.0))
        taken = leverage(one, Hypothesis(arm, np.asarray(arm.values), sigma), state)
        assert (taken > 0).all()
        # without a step there are no equations between samples
        assert taken.sum() == pytest.approx(2 * one.trajectory.size, rel=1e-6)

    def test_few_points_stand_for_many_torques(self) -> None:
        """Cost, gradient and information are those of all samples."""
        arm, one = two_link_arm(), article_segment(stop=2.0)
        theta, sigma = np.asarray(arm.values), Sigma(np.full(2, 1e-3), np.full(2, 0.1))
        state = one.initial_state(sigma.q, np.full(2, 30.0))
        few = one.condense(arm, state, theta, sigma.tau)
        assert len(few.points) < 0.7 * len(one.points)
        assert few.torques.weight[:, 0].sum() == pytest.approx(len(one.log))
        a, b = (equations(segment, Hypothesis(arm, theta, sigma), state) for segment in (one, few))
        assert a.cost == pytest.approx(b.cost, rel=1e-7)
        for name in ("band", "corner", "by_coefficients", "by_border"):
            wanted = getattr(a, name)
            np.testing.assert_allclose(getattr(b, name), wanted, rtol=1e-5, atol=1e-6 * np.abs(wanted).max())


def test_torque_between_the_samples_after_a_step_is_linear_up_to_the_last_knot() -> None:
    t = np.arange(200) * 0.01
    log = Log(t, np.sin(t)[:, None], np.cos(t)[:, None], ("a",))
    one = plan_segment(log, (), 20.0, np.full(1, 0.1), from_rest=True)
    (knots,), between = one.torque_knots, ~one.is_measured
    assert (one.points[between].min(), one.points[between].max()) == (knots[0], knots[-1])
    np.testing.assert_allclose(one.hats @ (2 + 3 * knots), np.where(between, 2 + 3 * one.points, 0.0), rtol=1e-12)


M, K, R, W = 12, 2, 3, 4  # unknowns of the trajectory, torques, parameters, width of the band


def random_equations(rng: np.random.Generator) -> tuple[np.ndarray, Equations]:
    """Return the dense matrix of trajectory, torques and parameters, and its equations."""
    A = rng.standard_normal((40, M + K + R))
    whole = A.T @ A + np.eye(M + K + R)
    apart = np.abs(np.subtract.outer(np.arange(M), np.arange(M))) >= W
    whole[:M, :M] = np.where(apart, 0.0, whole[:M, :M]) + 40 * np.eye(M)
    band = np.zeros((W, M))
    for d in range(W):
        band[d, : M - d] = np.diag(whole[:M, :M], -d)
    side = np.concatenate([whole[:M, M:], rng.standard_normal((M, 1 + R))], axis=1)
    return whole, Equations(band, side, whole[M:, M:], rng.standard_normal(K + R), 0.0)


@pytest.mark.parametrize("mixed", [False, True])
def test_it_is_the_schur_complement_and_leads_back(rng: np.random.Generator, mixed: bool) -> None:
    """With second derivatives, the border of the parameters has them in addition."""
    whole, one = random_equations(rng)
    if mixed:
        whole[:M, M + K :] += one.mixed_hessian
        whole[M + K :, :M] = whole[:M, M + K :].T
    pull = np.concatenate([one.by_coefficients, one.by_border])
    found = Elimination.of(one, Arrow(one.band, one.side), R, mixed_hessian=mixed)
    inner, away = whole[: M + K, : M + K], np.linalg.solve(whole[: M + K, : M + K], whole[: M + K, M + K :])
    rest = np.linalg.solve(inner, pull[: M + K])
    np.testing.assert_allclose(found.information, whole[M + K :, M + K :] - whole[M + K :, : M + K] @ away, rtol=1e-10)
    np.testing.assert_allclose(found.gradient, pull[M + K :] - whole[M + K :, : M + K] @ rest, rtol=1e-10)
    assert found.decrement == pytest.approx(pull[: M + K] @ rest)
    change = rng.standard_normal(R)
    np.testing.assert_allclose(np.concatenate(found.step(change)), rest - away @ change, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found.sensitivity, away, rtol=1e-9, atol=1e-12)
