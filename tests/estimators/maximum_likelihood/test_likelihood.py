"""The parts of the maximum-likelihood solver: the arrow, the splines, the normal equations, the barrier, the plan."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import BSpline

from dynident.errors import ModelError
from dynident.estimators.constraints import Barrier
from dynident.estimators.maximum_likelihood import (
    Sigma,
    State,
    Trajectory,
    equations,
    has_sign,
    leverage,
    plan,
    psd_constraints,
    scores,
    steps_of,
    whiteness,
    with_smooth_signs,
)
from dynident.estimators.maximum_likelihood.arrow import Arrow, gather, overlap
from dynident.estimators.maximum_likelihood.profile import crossing, swept
from dynident.estimators.maximum_likelihood.trajectory import DEGREE, graded
from dynident.log import Log
from dynident.models import Coulomb, CoupledMotor, Joint, Model, Viscous
from dynident.models.gallery import two_link_arm
from dynident.splines import NORMAL_95
from dynident.studies import SCENARIOS


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


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
        np.testing.assert_allclose(arrow.border_solution, inverse @ B, rtol=1e-10)
        np.testing.assert_allclose(arrow.log_det, np.linalg.slogdet(A)[1], rtol=1e-12)
        for d in range(4):
            np.testing.assert_allclose(arrow.inverse[d, : 14 - d], np.diag(inverse, -d), rtol=1e-9, atol=1e-14)

    def test_gathers_overlapping_blocks(self, rng: np.random.Generator) -> None:
        first = np.array([0, 2, 3])
        half = rng.standard_normal((3, 4, 4))
        blocks, rows = half @ half.swapaxes(1, 2), rng.standard_normal((3, 4, 2))
        full, side = np.zeros((7, 7)), np.zeros((7, 2))
        for at, block, row in zip(first, blocks, rows, strict=True):
            full[at : at + 4, at : at + 4] += block
            side[at : at + 4] += row
        band, border = gather(blocks, rows, overlap(first, 4, 7))
        for d in range(4):
            np.testing.assert_allclose(band[d, : 7 - d], np.diag(full, -d))
        np.testing.assert_allclose(border, side)

    def test_refuses_what_is_not_determined(self) -> None:
        with pytest.raises(ModelError, match="not determined"):
            Arrow(np.zeros((2, 5)), np.zeros((5, 1))).inner(np.ones((5, 1)))


class TestTrajectory:
    def test_agrees_with_scipy(self, rng: np.random.Generator) -> None:
        path = Trajectory(np.array([0.0, 0.1, 0.3, 0.7, 1.0]))
        t = np.sort(rng.uniform(0, 1, 50))
        local, first = path.local(t), path.first[path.interval(t)]
        for order in range(3):
            whole = np.zeros((50, path.size))
            whole[np.arange(50)[:, None], first[:, None] + np.arange(5)] = local[order]
            spline = BSpline(path.knots, np.eye(path.size), DEGREE)
            np.testing.assert_allclose(whole, spline.derivative(order)(t) if order else spline(t), atol=1e-10)

    def test_acceleration_jumps_at_a_step_only(self, rng: np.random.Generator) -> None:
        path = Trajectory(np.array([0.0, 0.2, 0.5, 0.8, 1.0]), steps=(0.5,))
        C = rng.standard_normal(path.size)

        def value(t: float, order: int) -> float:
            return float(path.local(np.array([t]))[order, 0] @ C[path.first[path.interval(np.array([t]))[0]] :][:5])

        for order, jumps in ((0, False), (1, False), (2, True)):
            gap = abs(value(0.5 + 1e-9, order) - value(0.5 - 1e-9, order))
            assert (gap > 1e-3) == jumps
        assert abs(value(0.2 + 1e-9, 2) - value(0.2 - 1e-9, 2)) < 1e-4

    def test_breaks_are_dense_after_a_step(self) -> None:
        breaks = graded(0.0, 10.0, [3.0], 0.01, 0.5, 1.3)
        assert (breaks[0], breaks[-1]) == (0.0, 10.0)
        assert 3.0 in breaks
        size = np.diff(breaks)
        assert size[breaks[:-1] < 3.0].min() > 0.4
        assert size[breaks[:-1] >= 3.0][0] <= 0.01
        assert size.max() <= 0.5 + 1e-12


def article_segment(*, rest: bool = True, stop: float = 0.5):
    scenario = SCENARIOS["stated"]
    log = scenario.record(1e-6, np.random.default_rng(0)).log.window(stop=stop)
    return plan(log, (), 20.0, np.full(2, 0.1), rest=rest)


class TestSegment:
    @pytest.mark.parametrize("rest", [True, False])
    def test_gradient_is_that_of_the_cost(self, rng: np.random.Generator, rest: bool) -> None:
        arm, one = two_link_arm(), article_segment(rest=rest)
        theta, sigma = np.asarray(arm.values), Sigma(np.full(2, 1e-3), np.full(2, 0.1))
        state = one.start(sigma.q, np.full(2, 30.0))
        found = equations(one, arm, state, theta, sigma)
        assert found.cost == pytest.approx(one.cost(arm, state, theta, sigma))
        k = found.border.shape[1] - 7
        dC, dW = 1e-7 * rng.standard_normal(state.C.size), 1e-5 * rng.standard_normal(k)
        dtheta = 1e-6 * theta * rng.standard_normal(7)
        if rest:
            dC[:2] = 0.0  # they follow the next two
        ends = []
        for sign in (1, -1):
            moved = one.moved(state, sign * dC, sign * dW)
            ends.append(one.cost(arm, moved, theta + sign * dtheta, sigma))
        along = found.by_coefficients @ dC + found.by_border @ np.concatenate([dW, dtheta])
        assert (ends[1] - ends[0]) / 2 == pytest.approx(along, rel=1e-3)

    @pytest.mark.parametrize("rest", [False, True])
    def test_positions_summed_up_lose_nothing_where_a_joint_has_turned_far(self, rest: bool) -> None:
        one = article_segment(rest=rest)
        one = replace(one, log=replace(one.log, q=one.log.q + np.array([0.0, 1e5])))
        state = one.start(np.full(2, 1e-4), np.full(2, 1e3))
        left = one.offset(state)
        share, squares = one.shares(state)
        np.testing.assert_allclose(squares, (left**2).sum(axis=0), rtol=1e-6)
        np.testing.assert_allclose(share, one.positions.T @ left, atol=1e-4 * np.abs(left).max())

    def test_bend_is_the_mixed_second_derivative(self, rng: np.random.Generator) -> None:
        """The gradient by C changes with theta by the border and the bend."""
        arm, one = two_link_arm(), article_segment()
        theta, sigma = np.asarray(arm.values), Sigma(np.full(2, 1e-3), np.full(2, 0.1))
        state = one.start(sigma.q, np.full(2, 30.0))
        here = equations(one, arm, state, theta, sigma)
        dtheta = 1e-6 * theta * rng.standard_normal(7)
        there, back = (equations(one, arm, state, theta + s * dtheta, sigma) for s in (1, -1))
        change = (there.by_coefficients - back.by_coefficients) / 2
        expected = -(here.border[:, -7:] + here.mixed_hessian) @ dtheta
        np.testing.assert_allclose(change, expected, rtol=1e-2, atol=1e-3 * np.abs(expected).max())

    def test_leverage_counts_the_coefficients(self) -> None:
        """Positions, torques and the equations between samples share the coefficients; none takes a negative part."""
        arm, one = two_link_arm(), article_segment(rest=False)
        sigma = Sigma(np.full(2, 1e-3), np.full(2, 0.1))
        state = one.start(sigma.q, np.full(2, 30.0))
        taken = leverage(one, arm, state, np.asarray(arm.values), sigma)
        assert (taken > 0).all()
        # without a step there are no equations between samples
        assert taken.sum() == pytest.approx(2 * one.trajectory.size, rel=1e-6)

    def test_few_points_stand_for_many_torques(self) -> None:
        """Cost, gradient and information are those of all samples."""
        arm, one = two_link_arm(), article_segment(stop=2.0)
        theta, sigma = np.asarray(arm.values), Sigma(np.full(2, 1e-3), np.full(2, 0.1))
        state = one.start(sigma.q, np.full(2, 30.0))
        few = one.condensed(arm, state, theta, sigma.tau)
        assert len(few.points) < 0.7 * len(one.points)
        assert few.torques.weight[:, 0].sum() == pytest.approx(len(one.log))
        a, b = (equations(segment, arm, state, theta, sigma) for segment in (one, few))
        assert a.cost == pytest.approx(b.cost, rel=1e-7)
        for name in ("band", "corner", "by_coefficients", "by_border"):
            wanted = getattr(a, name)
            np.testing.assert_allclose(getattr(b, name), wanted, rtol=1e-5, atol=1e-6 * np.abs(wanted).max())

    def test_scores_add_up_to_the_gradient(self) -> None:
        arm, one = two_link_arm(), article_segment(rest=False)
        theta, sigma = np.asarray(arm.values), Sigma(np.full(2, 1e-3), np.full(2, 0.1))
        state = one.start(sigma.q, np.full(2, 30.0))
        found = equations(one, arm, state, theta, sigma)
        follow = np.ones((len(found.band[0]), 7))
        pulls = scores(one, arm, state, theta, sigma, follow)
        np.testing.assert_allclose(pulls.sum(axis=0), found.by_border - found.by_coefficients.sum(), rtol=1e-9)

    def test_late_positions(self) -> None:
        """Positions stamped late show an earlier motion: with the time offset known the trajectory is the same."""
        log = SCENARIOS["stated"].record(1e-6, np.random.default_rng(0)).log.window(1.0, 2.0)
        late = Log(log.t, np.roll(log.q, 2, axis=0), log.tau, log.joints)
        time_offset, noise = 2 * (log.t[1] - log.t[0]), (np.full(2, 1e-3), np.full(2, 30.0))
        states = []
        for one in (
            plan(log, (), 20.0, np.full(2, 0.1), rest=False),
            plan(late, (), 20.0, np.full(2, 0.1), rest=False, time_offset=time_offset),
        ):
            basis = one.basis(np.array([1.5]))[0, 0]
            at = one.trajectory.first[one.trajectory.interval(np.array([1.5]))[0]]
            states.append(basis @ one.start(*noise).C[at : at + 5])
            assert one.raw.t[-1] <= one.trajectory.breaks[-1] + 1e-12
        np.testing.assert_allclose(states[1], states[0], atol=5e-3)

    def test_starts_from_rest(self) -> None:
        one = article_segment()
        _, dq, _ = one.motion(one.start(np.full(2, 1e-3), np.full(2, 30.0)))
        assert one.points[0] == 0.0
        np.testing.assert_allclose(dq[0], 0.0, atol=1e-12)


class TestPhysics:
    def test_the_articles_arm(self) -> None:
        arm = two_link_arm()
        log = SCENARIOS["stated"].record(1e-8, np.random.default_rng(0)).log
        barrier = Barrier(psd_constraints(arm, [log], np.asarray(arm.values)))
        assert barrier.inside(np.asarray(arm.values))
        for k, value in ((0, -1e-2), (1, -1e-3), (5, -0.1), (6, -0.1)):
            theta = np.array(arm.values)
            theta[k] = value
            assert not barrier.inside(theta), arm.names[k]


class TestPlan:
    def test_finds_steps_and_no_others(self, rng: np.random.Generator) -> None:
        t = np.arange(2000) * 0.01
        tau = np.stack([np.sin(t), np.where(t >= 7.0, 3.0, -1.0)], axis=1) + 0.1 * rng.standard_normal((2000, 2))
        log = Log(t, np.zeros_like(tau), tau, ("a", "b"))
        assert steps_of(log, np.full(2, 0.1)) == pytest.approx((7.0,))

    def test_outliers_are_no_steps(self, rng: np.random.Generator) -> None:
        t = np.arange(4000) * 0.0025
        tau = np.stack([6 * np.sin(t), np.where(t >= 7.0, 3.0, -1.0)], axis=1) + 0.1 * rng.standard_normal((4000, 2))
        tau[rng.random(tau.shape) < 0.02] += 5.0
        log = Log(t, np.zeros_like(tau), tau, ("a", "b"))
        assert steps_of(log, np.full(2, 0.1)) == pytest.approx((7.0,), abs=0.01)

    def test_torque_knots_are_as_far_apart_as_the_torque_allows(self) -> None:
        t = np.arange(400) * 0.01
        smooth, fast = (np.sin(rate * t)[:, None] for rate in (1.0, 15.0))
        gaps = []
        for tau in (smooth, fast):
            log = Log(t, np.zeros_like(tau), tau, ("a",))
            gaps.append(np.diff(plan(log, (), 20.0, np.array([0.02]), rest=True).torque_knots[0])[0])
        assert gaps[0] == pytest.approx(0.15)
        assert gaps[1] < 0.1

    def test_whiteness(self, rng: np.random.Generator) -> None:
        white = rng.standard_normal((4000, 2))
        assert whiteness(white, 0) > 1e-3
        assert whiteness(white + 0.3 * np.sin(np.arange(4000) / 50)[:, None], 0) < 1e-6


class TestFriction:
    def test_soft_signs_keep_the_parameters(self) -> None:
        joints = (Joint("a"), Joint("b"))
        terms = (Viscous(joints), Coulomb(joints, names=("x", "y")), CoupledMotor(joints, {"a": 1.0, "b": -2.0}, "m"))
        sharp = Model(terms)
        soft = with_smooth_signs(sharp, np.array([0.01, 0.02]))
        assert has_sign(sharp)
        assert not has_sign(soft)
        assert soft.names == sharp.names
        fast, slow = np.array([[1.0, -1.0]]), np.array([[0.01, -0.02]])
        zero = np.zeros((1, 2))
        np.testing.assert_allclose(soft.regressor(zero, fast, zero), sharp.regressor(zero, fast, zero))
        part = soft.regressor(zero, slow, zero)[0, :, [2, 3]]
        np.testing.assert_allclose(np.diag(part), np.tanh(1.0) * np.array([1.0, -1.0]))


class TestProfile:
    @pytest.mark.parametrize("size", [0.1, 0.4])
    def test_a_parabola_ends_where_it_should(self, size: float) -> None:
        ends = [crossing(lambda y: ((y - 1) / size, 1 / size), size, side) for side in (-1, 1)]
        assert ends == pytest.approx([1 - NORMAL_95 * size, 1 + NORMAL_95 * size], rel=1e-3)

    @pytest.mark.parametrize("size", [0.1, 0.5, 1.0])
    def test_a_parabola_in_the_logarithm(self, size: float) -> None:
        ends = [crossing(lambda y: (np.log(y) / size, 1 / (size * y)), size, side) for side in (-1, 1)]
        assert np.log(ends) / size == pytest.approx([-NORMAL_95, NORMAL_95], rel=0.02)

    def test_a_deviance_that_stays_low(self) -> None:
        """Nothing near zero tells it from the estimate: the interval goes nearly to zero."""
        assert 0 < crossing(lambda y: (y - 1, 1.0), 1.0, -1) < 0.01

    def test_what_physics_ends(self) -> None:
        """The end is not beyond where trials fail."""
        failed = []

        def root(y: float) -> tuple[float, float]:
            if 0.8 < y < 1.4:
                return (y - 1) / 0.5, 2.0
            failed.append(y)
            return np.nan, np.nan

        assert 1.3 < crossing(root, 0.5, 1) <= min(failed)
        failed.clear()
        assert max(failed, default=0.0) <= crossing(root, 0.5, -1) < 0.9

    @pytest.mark.parametrize("side", [-1, 1])
    def test_a_deviance_that_falls_again_before_it_rises(self, side: int) -> None:
        """Where it falls there is no slope to go by."""
        first = []

        def root(y: float) -> tuple[float, float]:
            first.append(y)
            return (side * 0.5, -1.0) if len(first) == 1 else (side * 3.0, 2.0)

        found = crossing(root, 0.4, side)
        assert min(first[:2]) < found < max(first[:2])

    @pytest.mark.parametrize("count", [0, 1, 2, 5])
    def test_swept_intervals_of_a_normal_likelihood_are_symmetric(self, count: int) -> None:
        covariance = np.array([[4.0, 1.5], [1.5, 1.0]])
        theta = np.array([3.0, 7.0])
        path = [(r, theta + r * covariance[:, 0] / 2) for r in np.linspace(-2, 2, count + 1)[1:]]
        found = swept(theta, path, covariance, 0)
        expected = theta[:, None] + NORMAL_95 * np.array([[-2.0, 2.0], [-1.0, 1.0]])
        np.testing.assert_allclose(found, expected, rtol=1e-3)

    def test_a_fit_as_likely_as_the_estimate_does_not_bend_the_valley(self) -> None:
        covariance = np.array([[4.0, 1.5], [1.5, 1.0]])
        found = swept(np.zeros(2), [(0.001, np.array([2.0, -1.0])), (-1.9, np.array([-3.8, -1.425]))], covariance, 0)
        np.testing.assert_allclose(found, NORMAL_95 * np.array([[-2.0, 2.0], [-1.0, 1.0]]), rtol=1e-3)

    def test_swept_intervals_bend_with_the_valley(self) -> None:
        covariance = np.array([[1.0, 1.0], [1.0, 1.0]])
        path = [(r, np.array([r, r + 0.1 * r**2])) for r in (-1.5, 2.5)]
        found = swept(np.zeros(2), path, covariance, 0)
        expected = [[-NORMAL_95, NORMAL_95], [-NORMAL_95 + 0.1 * NORMAL_95**2, NORMAL_95 + 0.1 * NORMAL_95**2]]
        np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_state_is_immutable() -> None:
    with pytest.raises(AttributeError):
        State(np.zeros((3, 1)), np.zeros((0, 1))).C = np.ones((3, 1))
