"""The line search: steps followed, doubled and shortened."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest

from dynident.estimators.constraints import Barrier
from dynident.estimators.maximum_likelihood import Likelihood, Sigma, newton, plan
from dynident.estimators.maximum_likelihood.columns import Columns
from dynident.models import Model
from dynident.models.gallery import two_link_arm
from dynident.studies import SCENARIOS


class Along:
    """A cost of theta (1) alone, infeasible from ``edge`` on; ``trials`` are the values of theta tried."""

    segments = ()

    def __init__(self, cost: Callable[[float], float], edge: float = np.inf) -> None:
        self.cost, self.edge, self.trials = cost, edge, list[float]()

    def point(self, states: tuple[()], theta: np.ndarray) -> newton._Point | None:
        self.trials.append(float(theta[0]))
        return None if theta[0] >= self.edge else newton._Point(states, theta, self.cost(float(theta[0])))

    def trajectory_step(self, *_: object) -> tuple[()]:
        return ()


def descended(along: Along, decrement: float) -> float | None:
    """Return where a step of one from zero leads."""
    start = newton._Point((), np.zeros(1), along.cost(0.0))
    found = newton._descend(along, start, SimpleNamespace(theta=np.ones(1), moves=(), decrement=decrement))
    return None if found is None else float(found.theta[0])


def test_a_step_that_gains_more_than_expected_is_doubled() -> None:
    along = Along(lambda x: (x - 4) ** 2)
    assert descended(along, 8.0) == 4.0
    assert along.trials == [1.0, 2.0, 4.0, 8.0]


def test_a_step_that_gains_what_is_expected_is_not_tried_longer() -> None:
    along = Along(lambda x: (x - 1) ** 2)
    assert descended(along, 2.0) == 1.0
    assert along.trials == [1.0]


def test_doubling_ends_at_the_edge_of_what_is_feasible() -> None:
    assert descended(Along(lambda x: -x, edge=3.0), 1.0) == 2.0


def test_no_trajectory_is_sought_where_the_step_leaves_the_feasible_set() -> None:
    along = Along(lambda x: -x, edge=0.3)
    assert descended(along, 1.0) == pytest.approx(0.16)
    assert along.trials == pytest.approx([1.0, 0.4, 0.16])


def test_a_step_of_the_trajectory_needs_no_regressor(monkeypatch: pytest.MonkeyPatch) -> None:
    """It lowers the cost, and goes where the step of all unknowns goes with theta held."""
    arm, theta = two_link_arm(), np.asarray(two_link_arm().values)
    log = SCENARIOS["stated"].record(1e-6, np.random.default_rng(0)).log.window(stop=0.5)
    one, sigma = plan(log, (), 20.0, np.full(2, 0.1), rest=True), Sigma(np.full(2, 1e-3), np.full(2, 0.1))
    likelihood = Likelihood(arm, (one,), sigma, Barrier(), np.eye(7), Columns.all(7))
    states = (one.start(sigma.q, np.full(2, 30.0)),)
    whole = newton._step(
        likelihood.equations(states, theta, mixed_hessian=False), theta, likelihood, newton.NewtonSettings(newton=False)
    )
    expected = whole.segments[0].step(np.zeros(7))

    def refused(*_: object) -> None:
        pytest.fail("the regressor was asked for")

    monkeypatch.setattr(Model, "regressor", refused)
    moves = likelihood.trajectory_step(states, theta)
    for a, b in zip(moves[0], expected, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-6, atol=1e-9 * np.abs(b).max())
    assert likelihood.cost((one.moved(states[0], *moves[0]),), theta) < likelihood.cost(states, theta)
