"""The line search, the choice of knots by white positions, else by the torque, and intervals from the likelihood."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from dynident.apps.article import SCENARIOS
from dynident.estimators import Barrier
from dynident.estimators.maximum_likelihood import (
    Likelihood,
    LikelihoodSearch,
    NewtonSettings,
    Recordings,
    Sigma,
    newton,
    plan_segment,
)
from dynident.estimators.maximum_likelihood.equations import Hypothesis, RegressorColumns, SearchPoint, scores
from dynident.estimators.maximum_likelihood.plan import crossing, sweep_intervals
from dynident.models.lagrangian import slider, two_link_arm
from dynident.motion.log import Log
from dynident.motion.splines import NORMAL_95


class Along:
    """A cost of theta (1) alone, infeasible from ``edge`` on; ``trials`` are the values of theta tried."""

    segments = ()

    def __init__(self, cost: Callable[[float], float], edge: float = np.inf) -> None:
        self.cost, self.edge, self.trials = cost, edge, list[float]()

    def point(self, states: tuple[()], theta: np.ndarray) -> SearchPoint | None:
        self.trials.append(float(theta[0]))
        return None if theta[0] >= self.edge else SearchPoint(states, theta, self.cost(float(theta[0])))

    def trajectory_equations(self, *_: object) -> tuple[()]:
        return ()


def step_of(theta: list[float], pull: list[float], decrement: float) -> newton._NewtonStep:
    """Return a step of theta alone, whose gradient is minus ``pull``."""
    none = np.zeros((0, 0))
    return newton._NewtonStep(np.array(theta), (), (), decrement, none, none, np.array(pull))


def improved(along: Along, slope: float, decrement: float) -> float | None:
    """Return where a step of one from zero leads, at which the cost falls by ``slope``."""
    start, step = SearchPoint((), np.zeros(1), along.cost(0.0)), step_of([1.0], [slope], decrement)
    found = newton._improve(along, start, step, None)[1]
    return None if found is None else float(found.theta[0])


@pytest.mark.parametrize(
    ("cost", "edge", "slope", "end", "trials"),
    [
        (lambda x: (x - 4) ** 2, np.inf, 8.0, 4.0, [1.0, 4.0]),
        (lambda x: (x - 1) ** 2, np.inf, 2.0, 1.0, [1.0]),  # it gains what is expected
        (lambda x: -x, 3.0, 1.0, 1.0, [1.0, newton.MAX_STEP_LENGTH]),  # beyond is not feasible
    ],
)
def test_a_step_ends_at_the_minimum_of_a_parabola(
    cost: Callable[[float], float], edge: float, slope: float, end: float, trials: list[float]
) -> None:
    along = Along(cost, edge)
    assert improved(along, slope, slope) == end
    assert along.trials == trials


def test_conjugate_steps_find_the_minimum_of_a_quadratic_in_as_many_as_it_has_unknowns() -> None:
    H, x, before = np.array([[3.0, 1.0, 0.2], [1.0, 2.0, 0.5], [0.2, 0.5, 0.7]]), np.array([3.0, -2.0, 5.0]), None
    for _ in range(3):
        pull = (-H @ x).tolist()
        before = step_of(pull, pull, float(x @ H @ H @ x)).conjugate(before)
        x = x + before.theta * (before.descent @ before.theta) / (before.theta @ H @ before.theta)
    np.testing.assert_allclose(x, 0.0, atol=1e-12)


def test_the_end_is_near_the_limit_and_does_not_depend_on_the_tolerance() -> None:
    arm, theta = two_link_arm(), np.asarray(two_link_arm().values)
    log = SCENARIOS["stated"].record(1e-6, np.random.default_rng(0)).log.window(stop=2.0)
    one, sigma = plan_segment(log, (), 40.0, np.full(2, 0.1), from_rest=True), Sigma(np.full(2, 1e-3), np.full(2, 0.1))
    likelihood = Likelihood(arm, (one,), sigma, Barrier(), np.eye(7), RegressorColumns.all(7))
    states = (one.initial_state(sigma.q, np.full(2, 30.0)),)
    limit, rough = (
        newton.maximise(likelihood, states, 1.05 * theta, newton.NewtonSettings(tolerance, newton=False))
        for tolerance in (1e-9, 1e-4)
    )
    assert rough.converged
    assert rough.iterations < limit.iterations
    std = np.sqrt(np.diag(np.linalg.inv(limit.information)))
    np.testing.assert_allclose((rough.theta - limit.theta) / std, 0.0, atol=1e-3)
    for a, b in zip(rough.extrapolate((one,), rough.theta), rough.states, strict=True):
        np.testing.assert_allclose(a.C, b.C, rtol=0, atol=1e-9)


THETA = np.array([2.0, 1.0, 0.5, 0.1])


def search(*, coloured: bool, used: bool = True) -> LikelihoodSearch:
    """A slider at 200 Hz; its position noise is white, or nearly the same from sample to sample."""
    rng, t, model = np.random.default_rng(0), np.arange(2000) / 200, slider()
    q, dq, ddq = (a * np.sin(2 * t + phase)[:, None] for a, phase in ((1, 0), (2, np.pi / 2), (-4, 0)))
    noise = rng.standard_normal(q.shape)
    if coloured:
        for k in range(1, len(noise)):
            noise[k] = 0.9 * noise[k - 1] + 0.44 * noise[k]
    tau = model.torque(q, dq, ddq, THETA) + 0.05 * rng.standard_normal(q.shape)
    log = Log(t, q + 1e-4 * noise, tau, ("slider",))
    given = Recordings((log,), ((),), (np.full(q.shape, used),), 0.0, np.array([28.0]))
    sigma = Sigma(np.array([1e-4]), np.array([0.05]))
    return LikelihoodSearch(model, given, Barrier(), NewtonSettings(), np.eye(4), THETA, sigma)


def intervals(found: LikelihoodSearch) -> int:
    found.choose_knots(None, from_rest=False, condense=False)
    (segment,) = found.segments
    return len(segment.trajectory.first_coefficient)


def test_white_positions_decide() -> None:
    """The widest spacing that follows the motion, whatever narrower ones would do."""
    found = search(coloured=False)
    assert intervals(found) == 2000 / 40
    assert found.sigma.q[0] == pytest.approx(1e-4, rel=0.05)


def test_the_torque_decides_where_positions_are_never_white() -> None:
    """Narrow knots follow the noise, wide ones not the motion: both leave more of the torque."""
    narrow = intervals(search(coloured=True))
    assert 2000 / 80 < narrow < 2000 / 5


def test_without_any_torque_there_are_knots_all_the_same() -> None:
    assert intervals(search(coloured=True, used=False)) > 2000 / 80


def test_the_scatter_is_that_of_the_scores_of_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of two halves, which contribute the same, as their sum is zero at the optimum."""
    monkeypatch.setattr("dynident.estimators.maximum_likelihood.search.SCORE_CLUSTERS", 2)
    found = search(coloured=False)
    found.choose_knots(None, from_rest=False, condense=False)
    fit, (segment,) = found.run(), found.segments
    inverse, hypothesis = np.linalg.inv(fit.information), Hypothesis(found.model, fit.theta, found.sigma)
    pulls = scores(segment, hypothesis, fit.states[0], fit.segments[0].sensitivity @ fit.columns.combination)
    std, count = found.sandwich_std(fit, inverse)
    np.testing.assert_allclose(std, np.sqrt(2) * np.abs(pulls[: len(pulls) // 2].sum(axis=0) @ inverse), rtol=1e-6)
    np.testing.assert_allclose(count, 2.0, rtol=1e-6)


class TestProfile:
    @pytest.mark.parametrize("size", [0.1, 0.4])
    def test_a_parabola_ends_where_it_should(self, size: float) -> None:
        ends = [crossing(lambda y: ((y - 1) / size, 1 / size), size, side) for side in (-1, 1)]
        assert ends == pytest.approx([1 - NORMAL_95 * size, 1 + NORMAL_95 * size], rel=1e-3)

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

    def test_swept_intervals_bend_with_the_valley(self) -> None:
        covariance = np.array([[1.0, 1.0], [1.0, 1.0]])
        path = [(r, np.array([r, r + 0.1 * r**2])) for r in (-1.5, 2.5)]
        found = sweep_intervals(np.zeros(2), path, covariance, 0)
        expected = [[-NORMAL_95, NORMAL_95], [-NORMAL_95 + 0.1 * NORMAL_95**2, NORMAL_95 + 0.1 * NORMAL_95**2]]
        np.testing.assert_allclose(found, expected, rtol=1e-9)
