"""The columns of the regressor that are multiplied, and a segment without its trajectory, as dense matrices have it."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.apps.demo import demo_truth
from dynident.estimators import Barrier, PsdConstraint
from dynident.estimators.maximum_likelihood import Equations, Likelihood, Sigma
from dynident.estimators.maximum_likelihood.equations import RegressorColumns
from dynident.estimators.maximum_likelihood.newton import Elimination
from dynident.estimators.maximum_likelihood.trajectory import Arrow
from dynident.models.lagrangian import two_link_arm


def test_columns_of_bodies_follow_from_the_independent_ones(rng: np.random.Generator) -> None:
    """At states that were not used to find them."""
    model = demo_truth().model
    found = RegressorColumns.independent(model)
    Y = model.regressor(*(5.0 * one for one in rng.standard_normal((3, 20, len(model.joints)))))
    assert len(found.indices) < Y.shape[2]
    np.testing.assert_allclose(found.select(Y) @ found.combination, Y, rtol=0, atol=1e-11 * np.abs(Y).max())
    friction = [k for k, one in enumerate(model.parameters) if not one.body]
    assert set(friction) <= set(found.indices)


@pytest.mark.parametrize(
    ("centred", "theta", "fixed", "moving"),
    [
        ((), (0.0, 0.0, 0.0), None, [0, 1]),
        ((), (0.0, 1e6, 0.0), 0, [1]),
        ((2,), (0.0, 0.0, 0.0), None, [0, 1, 2]),  # a prior keeps it
        ((2,), (0.0, 0.0, 0.0), 2, [0, 1]),
    ],
)
def test_directions_that_nothing_determines_stay(
    centred: tuple[int, ...], theta: tuple[float, ...], fixed: int | None, moving: list[int]
) -> None:
    slopes = np.zeros((1, 1, 1, 3))
    slopes[..., centred] = 1.0
    constraint = PsdConstraint(np.ones((1, 1, 1)), slopes, np.ones((1, 1, 1)))
    barrier, sigma = Barrier((constraint,) if centred else ()), Sigma(np.ones(2), np.ones(2))
    likelihood = Likelihood(two_link_arm(), (), sigma, barrier, np.eye(3), RegressorColumns.all(3))
    found = likelihood.open_directions(np.diag([1.0, 1.0, 0.0]), np.array(theta), fixed)
    np.testing.assert_array_equal(found, np.eye(3)[:, moving])


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
