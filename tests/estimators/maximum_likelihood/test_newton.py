"""The line search: steps conjugate, adjusted, followed and shortened; and the end of the search."""

from collections.abc import Callable

import numpy as np

from dynident.apps.article import SCENARIOS
from dynident.estimators import Barrier
from dynident.estimators.maximum_likelihood import Likelihood, Sigma, newton, plan_segment
from dynident.estimators.maximum_likelihood.equations import RegressorColumns, SearchPoint
from dynident.models.lagrangian import two_link_arm


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
    result = newton._improve(along, start, step, None)[1]
    return None if result is None else float(result.theta[0])


def test_a_step_ends_at_the_minimum_of_a_parabola() -> None:
    """Unless it gains what is expected, or the minimum is beyond the edge of what is feasible."""
    for along, slope, step, trials in (
        (Along(lambda x: (x - 4) ** 2), 8.0, 4.0, [1.0, 4.0]),
        (Along(lambda x: (x - 1) ** 2), 2.0, 1.0, [1.0]),
        (Along(lambda x: -x, edge=3.0), 1.0, 1.0, [1.0, newton.MAX_STEP_LENGTH]),
    ):
        assert improved(along, slope, slope) == step
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
    case, sigma = plan_segment(log, (), 40.0, np.full(2, 0.1), from_rest=True), Sigma(np.full(2, 1e-3), np.full(2, 0.1))
    likelihood = Likelihood(arm, (case,), sigma, Barrier(), np.eye(7), RegressorColumns.all(7))
    states = (case.initial_state(sigma.q, np.full(2, 30.0)),)
    limit, rough = (
        newton.maximise(likelihood, states, 1.05 * theta, newton.NewtonSettings(tolerance, newton=False))
        for tolerance in (1e-9, 1e-4)
    )
    assert rough.converged
    assert rough.iterations < limit.iterations
    std = np.sqrt(np.diag(np.linalg.inv(limit.information)))
    np.testing.assert_allclose((rough.theta - limit.theta) / std, 0.0, atol=1e-3)
    for a, b in zip(rough.extrapolate((case,), rough.theta), rough.states, strict=True):
        np.testing.assert_allclose(a.C, b.C, rtol=0, atol=1e-9)
