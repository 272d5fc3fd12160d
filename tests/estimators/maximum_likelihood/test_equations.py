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
    result = RegressorColumns.independent(model)
    Y = model.regressor(*(5.0 * x for x in rng.standard_normal((3, 20, len(model.joints)))))
    assert len(result.indices) < Y.shape[2]
    np.testing.assert_allclose(result.select(Y) @ result.combination, Y, rtol=0, atol=1e-11 * np.abs(Y).max())
    friction = [k for k, x in enumerate(model.parameters) if not x.body]
    assert set(friction) <= set(result.indices)


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
    result = likelihood.open_directions(np.diag([1.0, 1.0, 0.0]), np.array(theta), fixed)
    np.testing.assert_array_equal(result, np.eye(3)[:, moving])


M, K, R, W = 12, 2, 3, 4  # unknowns of the trajectory, torques, parameters, width of the band


def random_equations(rng: np.random.Generator) -> tuple[np.ndarray, Equations]:
    """Return the dense matrix of trajectory, torques and parameters, and its equations."""
    A = rng.standard_normal((40, M + K + R))
    full = A.T @ A + np.eye(M + K + R)
    apart = np.abs(np.subtract.outer(np.arange(M), np.arange(M))) >= W
    full[:M, :M] = np.where(apart, 0.0, full[:M, :M]) + 40 * np.eye(M)
    band = np.zeros((W, M))
    for d in range(W):
        band[d, : M - d] = np.diag(full[:M, :M], -d)
    side = np.concatenate([full[:M, M:], rng.standard_normal((M, 1 + R))], axis=1)
    return full, Equations(band, side, full[M:, M:], rng.standard_normal(K + R), 0.0)


@pytest.mark.parametrize("mixed", [False, True])
def test_it_is_the_schur_complement_and_leads_back(rng: np.random.Generator, mixed: bool) -> None:
    """With second derivatives, the border of the parameters has them in addition."""
    full, case = random_equations(rng)
    if mixed:
        full[:M, M + K :] += case.mixed_hessian
        full[M + K :, :M] = full[:M, M + K :].T
    pull = np.concatenate([case.by_coefficients, case.by_border])
    result = Elimination.of(case, Arrow(case.band, case.side), R, mixed_hessian=mixed)
    inner, away = full[: M + K, : M + K], np.linalg.solve(full[: M + K, : M + K], full[: M + K, M + K :])
    rest = np.linalg.solve(inner, pull[: M + K])
    np.testing.assert_allclose(result.information, full[M + K :, M + K :] - full[M + K :, : M + K] @ away, rtol=1e-10)
    np.testing.assert_allclose(result.gradient, pull[M + K :] - full[M + K :, : M + K] @ rest, rtol=1e-10)
    assert result.decrement == pytest.approx(pull[: M + K] @ rest)
    change = rng.standard_normal(R)
    np.testing.assert_allclose(np.concatenate(result.step(change)), rest - away @ change, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(result.sensitivity, away, rtol=1e-9, atol=1e-12)
