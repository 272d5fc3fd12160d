import numpy as np
import pytest

from dynident.apps.fleets.components import (
    VarianceComponents,
    pseudo_inverse,
    robust_weights,
    solve_gls,
    variance_components,
    whiten,
)
from tests.apps.fleets.simulated import B, E, fleet

BLOCKS = tuple(np.array(block) for block in ((0, 1), (2,)))
TRUE = np.array([[1.0, 0.8, 0.0], [0.8, 2.0, 0.0], [0.0, 0.0, 0.25]])


def drawn(rng, sets, vectors, inflation=1.0):
    """Sets of vectors of three parameters that deviate by TRUE about a mean of their own; some show more, some less."""
    found = []
    for _ in range(sets):
        X = rng.standard_normal((vectors, 30, 3)) * 10 ** rng.uniform(-1.5, 0.5, (vectors, 1, 1))
        J = X.swapaxes(1, 2) @ X
        errors = np.sqrt(inflation) * np.linalg.cholesky(np.linalg.inv(J)) @ rng.standard_normal((vectors, 3, 1))
        deviations = rng.multivariate_normal(np.zeros(3), TRUE, vectors)
        found.append((5 * rng.standard_normal(3) + deviations + errors[:, :, 0], J))
    return found


def test_components_are_those_of_the_draws() -> None:
    sets = [whiten(*one) for one in drawn(np.random.default_rng(1), 40, 12, inflation=4.0)]
    found = variance_components(sets, BLOCKS, inflate=True)
    assert found.inflation == pytest.approx(4.0, rel=0.15)
    np.testing.assert_allclose(found.covariance, TRUE, atol=0.25)
    assert found.covariance[0, 2] == 0.0


def test_restricted_likelihood_has_no_bias_by_the_means() -> None:
    """With two vectors a set, maximum likelihood would find half of the variance."""
    sets = [whiten(*one) for one in drawn(np.random.default_rng(2), 600, 2)]
    np.testing.assert_allclose(np.diag(variance_components(sets, BLOCKS).covariance), np.diag(TRUE), rtol=0.2)


def test_units_do_not_matter() -> None:
    pairs, units = drawn(np.random.default_rng(3), 8, 6), np.array([1e-3, 10.0, 1e4])
    plain = variance_components([whiten(*one) for one in pairs], BLOCKS, inflate=True)
    scaled = variance_components(
        [whiten(y * units, J / np.outer(units, units)) for y, J in pairs], BLOCKS, inflate=True
    )
    np.testing.assert_allclose(scaled.covariance / np.outer(units, units), plain.covariance, rtol=1e-6, atol=1e-12)
    assert scaled.inflation == pytest.approx(plain.inflation)


def test_few_odd_sets_hardly_count() -> None:
    rng = np.random.default_rng(4)
    pairs = drawn(rng, 10, 10)
    plain = variance_components([whiten(*one) for one in pairs], BLOCKS, inflate=True)
    for k in (2, 7):
        pairs[k][0][5:] += 30.0
    odd = variance_components([whiten(*one) for one in pairs], BLOCKS, inflate=True)
    assert (np.diag(odd.covariance) < 5.0 * np.diag(plain.covariance)).all()
    assert odd.inflation < 1.5 * plain.inflation


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
    one, two = (variance_components(sets, BLOCKS, inflate=True) for sets in (hidden, changed))
    np.testing.assert_allclose(one.covariance, two.covariance, rtol=1e-3)
    assert one.covariance[2, 2] == 0.0
    run = solve_gls(hidden[0], one)
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


def test_an_odd_vector_weighs_less() -> None:
    (history,) = fleet(np.random.default_rng(7), 1, 12)
    value = history.value.copy()
    value[3] += 3.0 * np.abs(value[3])
    parts = variance_components([whiten(value, history.information)], tuple(E.nonzero()[1][:, None]), inflate=True)
    weights = robust_weights(whiten(value, history.information), parts)
    assert weights[3] < 0.5
    assert np.delete(weights, 3).min() > weights[3] + 0.3


def test_few_vectors_do_not_make_a_variance_zero() -> None:
    y = np.array([[1.0], [1.0], [1.0]])
    one = whiten(y, np.full((3, 1, 1), 100.0))
    block = (np.array([0]),)
    assert variance_components([one], block).covariance[0, 0] < 1e-4
    assert variance_components([one], block, avoid_zero=True).covariance[0, 0] > 1e-3


def test_pseudo_inverse_of_nothing_is_zero() -> None:
    assert not pseudo_inverse(np.zeros((2, 2))).any()
    np.testing.assert_allclose(pseudo_inverse(np.diag([4.0, 0.0])), np.diag([0.25, 0.0]))
