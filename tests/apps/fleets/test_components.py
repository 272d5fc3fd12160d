"""Components of variance, scatter and likelihood ratios of histories whose truth is known."""

import numpy as np
import pytest

from dynident.apps.fleets.components import (
    Scatter,
    VarianceComponents,
    blocks_of,
    scatter_of,
    solve_gls,
    variance_components,
    whiten,
)
from dynident.apps.fleets.ratios import LikelihoodRatios, NullDraws
from dynident.regression import GroupKind
from dynident.runtime import InputError
from tests.apps.fleets.simulated import FRICTION_A, GROUPS, PAYLOAD, SCATTER, SIZE, B, E, fleet, group

BLOCKS = tuple(np.array(block) for block in ((0, 1), (2,)))
TRUE = np.array([[1.0, 0.8, 0.0], [0.8, 2.0, 0.0], [0.0, 0.0, 0.25]])


def drawn(rng, sets, vectors, inflation=1.0):
    """Sets of vectors of three parameters that deviate by TRUE about a mean of their own; some show more, some less."""
    result = []
    for _ in range(sets):
        X = rng.standard_normal((vectors, 30, 3)) * 10 ** rng.uniform(-1.5, 0.5, (vectors, 1, 1))
        J = X.swapaxes(1, 2) @ X
        errors = np.sqrt(inflation) * np.linalg.cholesky(np.linalg.inv(J)) @ rng.standard_normal((vectors, 3, 1))
        deviations = rng.multivariate_normal(np.zeros(3), TRUE, vectors)
        result.append((5 * rng.standard_normal(3) + deviations + errors[:, :, 0], J))
    return result


def test_restricted_likelihood_has_no_bias_by_the_means() -> None:
    """With two vectors a set, maximum likelihood would find half of the variance."""
    sets = [whiten(*x) for x in drawn(np.random.default_rng(2), 600, 2)]
    np.testing.assert_allclose(np.diag(variance_components(sets, BLOCKS).covariance), np.diag(TRUE), rtol=0.2)


def test_a_direction_that_is_not_shown_says_nothing() -> None:
    rng = np.random.default_rng(5)
    hidden, changed = [], []
    for y, J in drawn(rng, 6, 5):
        J[::2, 1, :] = J[::2, :, 1] = 0.0
        J[:, 2, :] = J[:, :, 2] = 0.0
        hidden.append(whiten(y, J))
        other = y.copy()
        other[::2, 1] += 100.0
        other[:, 2] -= 100.0
        changed.append(whiten(other, J))
    case, two = (variance_components(sets, BLOCKS, inflate=True) for sets in (hidden, changed))
    np.testing.assert_allclose(case.covariance, two.covariance, rtol=1e-3)
    assert case.covariance[2, 2] == 0.0
    run = solve_gls(hidden[0], case)
    assert np.isfinite(run.value).all()
    assert run.covariance[2, 2] == 0.0


def test_solved_is_generalised_least_squares() -> None:
    (history,) = fleet(np.random.default_rng(6), 1, 5)
    parts = VarianceComponents((np.arange(B),), np.diag(np.full(B, 1e-3)), 2.0)
    W = np.linalg.inv(2.0 * np.linalg.inv(history.information) + parts.covariance)
    run = solve_gls(whiten(history.value, history.information), parts)
    expected = np.linalg.solve(W.sum(axis=0), np.einsum("kij,kj->i", W, history.value))
    np.testing.assert_allclose(run.value, expected, rtol=1e-8)
    np.testing.assert_allclose(run.covariance, np.linalg.inv(W.sum(axis=0)), rtol=1e-6)
    left = history.value - expected
    np.testing.assert_allclose(run.distance, np.einsum("ki,kij,kj->k", left, W, left), rtol=1e-6)


def test_few_vectors_do_not_make_a_variance_zero() -> None:
    y = np.array([[1.0], [1.0], [1.0]])
    case = whiten(y, np.full((3, 1, 1), 100.0))
    block = (np.array([0]),)
    assert variance_components([case], block).covariance[0, 0] < 1e-4
    assert variance_components([case], block, avoid_zero=True).covariance[0, 0] > 1e-3


def test_parameters_of_a_group_scatter_together() -> None:
    blocks = [block.tolist() for block in blocks_of(GROUPS, B)]
    assert blocks == [[0], [1], [2], [3], [4, 5], [6, 7], [8], [9], [10, 11]]
    overlapping = (*GROUPS, group(GroupKind.RIPPLE, "a", E[:, [5, 9]]))
    assert [4, 5, 9] in [block.tolist() for block in blocks_of(overlapping, B)]


@pytest.mark.parametrize(("robots", "logs"), [(10, 20), (2, 60)])
def test_scatter_is_that_of_friction_and_offsets(robots: int, logs: int) -> None:
    """Standard errors are 1.5 times too small; the parameters of bodies do not scatter."""
    rng = np.random.default_rng(1)
    result = scatter_of(fleet(rng, robots, logs), GROUPS, rng)
    assert 1.1**2 < result.inflation < 1.6**2
    relative = np.sqrt(np.diag(result.covariance)) / SIZE
    expected = np.hypot(*SCATTER[:2])
    assert (np.abs(relative[4:8] - expected) < 0.6 * expected).all()
    assert result.covariance[4, 5] > 0.4 * np.sqrt(result.covariance[4, 4] * result.covariance[5, 5])
    assert relative[:4].max() < 0.03
    assert result.dof == robots * logs - (robots if robots > 4 else robots * logs / 3)


def test_robots_of_other_parameters_are_refused() -> None:
    rng = np.random.default_rng(5)
    first, second = fleet(rng, 2, 3)
    short = type(second)(second.robot, second.logs, second.days, second.value[:, :5], second.information[:, :5, :5])
    with pytest.raises(InputError, match=r"\[5, 12\] base parameters"):
        scatter_of([first, short], GROUPS, rng)


def test_what_a_log_says_of_the_robot_is_less_than_of_the_day() -> None:
    rng = np.random.default_rng(6)
    (history, *_), result = fleet(rng, 6, 8), scatter_of(fleet(rng, 6, 8), GROUPS, rng)
    J = history.information[0]
    expected = np.linalg.inv(result.inflation * np.linalg.inv(J) + result.covariance)
    np.testing.assert_allclose(result.with_scatter(J), expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())
    assert not result.with_scatter(np.zeros_like(J)).any()


STEP, DRIFT = np.repeat([0.0, 1.0], [3, 5]), np.linspace(0.0, 1.0, 8)
PARTS = Scatter(tuple(np.arange(B)[:, None]), np.diag((0.03 * SIZE) ** 2), 1.7, 50.0)


def ratios(history):
    return LikelihoodRatios.of(history, GROUPS, PARTS, np.array([STEP, DRIFT]))


def with_step(log: int, value: np.ndarray) -> None:
    value[:4] += (log > 2) * GROUPS[PAYLOAD].directions[:4] @ np.array([0.02, 0.0, 0.05])


def weighted_squares(history, columns):
    """The least of the weighted squared residuals with the base parameters and further columns (K, b, q)."""
    K = len(history.logs)
    X = np.concatenate([np.broadcast_to(np.eye(B), (K, B, B)), *columns], axis=2)
    L = np.linalg.cholesky(np.linalg.inv(1.7 * np.linalg.inv(history.information) + PARTS.covariance))
    rows, left = L.swapaxes(1, 2) @ X, np.einsum("kji,kj->ki", L, history.value)
    rows = rows.reshape(-1, X.shape[2])
    scale = np.linalg.norm(rows, axis=0)
    result, squares, *_ = np.linalg.lstsq(rows / scale, left.ravel())
    return result / scale, squares.sum(), np.linalg.inv((rows / scale).T @ (rows / scale)) / np.outer(scale, scale)


def test_ratios_are_those_of_least_squares() -> None:
    (history,) = fleet(np.random.default_rng(1), 1, 8, {0: with_step})
    friction, payload = (
        [course[:, None, None] * GROUPS[g].directions] for g, course in ((FRICTION_A, DRIFT), (PAYLOAD, STEP))
    )
    case = ratios(history)
    taken = [(PAYLOAD, 0), (FRICTION_A, 1)]
    (_, nothing, _), (_, single, _) = weighted_squares(history, []), weighted_squares(history, payload)
    value, both, covariance = weighted_squares(history, payload + friction)
    assert case.profile(taken[:1], 0)[0] == pytest.approx(nothing - single, rel=1e-6)
    assert case.profile(taken, 1)[1] == pytest.approx(single - both, rel=1e-6)
    (size, std), (rubbing, _) = case.fit(taken)
    np.testing.assert_allclose(size, value[B : B + 3], rtol=1e-6)
    np.testing.assert_allclose(rubbing, value[B + 3 :], rtol=1e-6)
    np.testing.assert_allclose(std, np.sqrt(np.diag(covariance)[B : B + 3]), rtol=1e-6)


def test_the_clearest_change_is_found_and_then_no_other() -> None:
    rng = np.random.default_rng(2)
    (history,) = fleet(rng, 1, 8, {0: with_step})
    best, chance = ratios(history).clearest_change([], NullDraws(rng, 400))
    assert best == (PAYLOAD, 0)
    assert chance == 1 / 401
    _, further = ratios(history).clearest_change([(PAYLOAD, 0)], NullDraws(rng, 400))
    assert further > 0.01
    assert ratios(history).refine([(PAYLOAD, 1)]) == [(PAYLOAD, 0)]


def test_chunks_of_draws_are_all_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    (history,) = fleet(np.random.default_rng(3), 1, 8)
    _, full = ratios(history).clearest_change([], NullDraws(np.random.default_rng(4), 999))
    monkeypatch.setattr("dynident.apps.fleets.ratios.CHUNK", 7 * history.value.size)
    _, parts = ratios(history).clearest_change([], NullDraws(np.random.default_rng(5), 999))
    assert (1000 * parts) == pytest.approx(round(1000 * parts))
    assert abs(parts - full) < 0.1


def test_errors_drawn_from_a_pool_are_those_of_logs() -> None:
    """Standardised errors have a variance of one, and rows made of them the spread of the logs they are drawn for."""
    rng = np.random.default_rng(9)
    many = [ratios(history) for history in fleet(rng, 30, 8)]
    pool = np.concatenate([x.standardised_errors([]) for x in many])
    assert pool.shape == (240, B)
    drawn = many[0]._draw_rows(NullDraws(rng, 400, pool), 400)
    rows = np.concatenate([x.value - _fitted(x) for x in many]).ravel()
    assert np.std(drawn) == pytest.approx(np.std(rows) * np.sqrt(8 / 7), rel=0.1)
    value = many[0].rows[0].T @ many[0].rotations[0]  # the symmetric root of the log's information
    scale = np.linalg.norm(many[0].rows[0], axis=0)
    root = value / scale[:, None]
    np.testing.assert_allclose(root, root.T, atol=1e-9)


def _fitted(likelihood_ratios: LikelihoodRatios) -> np.ndarray:
    X = likelihood_ratios.rows.reshape(-1, B)
    return ((X * SIZE) @ np.linalg.lstsq(X * SIZE, likelihood_ratios.value.ravel())[0]).reshape(
        likelihood_ratios.value.shape
    )


def test_what_no_log_shows_has_an_infinite_error() -> None:
    (history,) = fleet(np.random.default_rng(6), 1, 8)
    history.information[:, 5, :] = history.information[:, :, 5] = 0.0
    (size, std), *_ = ratios(history).fit([(FRICTION_A, 0)])
    assert np.isfinite(size).all()
    assert np.isfinite(std[0])
    assert np.isinf(std[1])


def test_nothing_can_change_where_nothing_is_tried() -> None:
    (history,) = fleet(np.random.default_rng(7), 1, 8)
    none = LikelihoodRatios.of(history, (), PARTS, np.array([STEP]))
    assert none.clearest_change([], NullDraws(np.random.default_rng(8), 200)) == (None, 1.0)
