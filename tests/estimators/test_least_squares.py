"""Least squares: rank, scaling, what its covariance promises, and its rows in other fits."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import t as student

from dynident.estimators import LeastSquares, LinearEstimator, PhysicallyConsistent, Problem
from dynident.estimators.least_squares import LeastSquaresSolution, solve_least_squares
from dynident.estimators.maximum_likelihood import MaximumLikelihood
from dynident.models import Model
from dynident.models.lagrangian import two_link_arm
from dynident.motion.log import Motion
from dynident.regression import Regression, RegressorBlock, rank_of
from dynident.runtime import ConfigError
from tests.regression.dense import triangularise

Array = NDArray[np.float64]
ROWS, COLUMNS = 60, 6


def data(seed: int = 0) -> tuple[Array, Array]:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(ROWS, COLUMNS)), rng.normal(size=ROWS)


def fitted(X: Array, y: Array, **settings: Any) -> LeastSquaresSolution:
    factor = triangularise(iter([RegressorBlock(X[:, None], y[:, None])]), 1, X.shape[1]).stack()
    return solve_least_squares(factor, rank_of(factor, **settings))


def dependent(*which: str) -> Array:
    """A matrix with the named dependences between its columns, which are of very different size."""
    X: Array = data()[0] * np.array([1.0, 1e-3, 1.0, 1e2, 1.0, 1e-1])
    made = {
        "equal": (4, X[:, 1]),
        "opposite": (4, -1e6 * X[:, 1]),
        "zero": (2, np.zeros(ROWS)),
        "three": (5, X[:, 0] - 0.02 * X[:, 3]),
        "slight": (5, X[:, 0] - 1e-5 * X[:, 2]),
    }
    for column, content in (made[name] for name in which):
        X[:, column] = content
    return X


DEPENDENT = [
    (("equal",), ((1, 4),)),
    (("opposite",), ((1, 4),)),
    (("zero",), ((2,),)),
    (("three",), ((0, 3, 5),)),
    (("slight",), ((0, 2, 5),)),
    (("equal", "three"), ((0, 3, 5), (1, 4))),
    (("equal", "zero"), ((1, 4), (2,))),
    (("opposite", "zero", "three"), ((0, 3, 5), (1, 4), (2,))),
]
every_dependence = pytest.mark.parametrize(("which", "groups"), DEPENDENT, ids=lambda x: "-".join(map(str, x)))


@every_dependence
def test_rank_deficiency_names_exactly_the_columns_tied(which: tuple[str, ...], groups: tuple[tuple[int, ...]]) -> None:
    fit = fitted(dependent(*which), data()[1])
    assert set(fit.directions.groups) == set(groups)
    assert fit.directions.rank == COLUMNS - len(groups)
    assert np.flatnonzero(fit.directions.undetermined_mask).tolist() == sorted(k for group in groups for k in group)
    assert fit.directions.condition > 1e12


@every_dependence
def test_other_columns_are_fitted_as_if_one_of_each_group_was_not_there(
    which: tuple[str, ...], groups: tuple[tuple[int, ...]]
) -> None:
    X, y = dependent(*which), data()[1]
    fit = fitted(X, y)
    kept = [k for k in range(COLUMNS) if k not in {group[-1] for group in groups}]
    clean = fitted(X[:, kept], y)
    sure = [k for k in kept if not fit.directions.undetermined_mask[k]]
    place = [kept.index(k) for k in sure]
    assert clean.directions.rank == len(kept)
    np.testing.assert_allclose(fit.value[sure], clean.value[place], rtol=1e-10)
    np.testing.assert_allclose(
        fit.directions.inverse[np.ix_(sure, sure)], clean.directions.inverse[np.ix_(place, place)], rtol=1e-9
    )
    assert fit.rss == pytest.approx(clean.rss, rel=1e-12)


@every_dependence
def test_solution_is_of_least_norm_in_scaled_columns(which: tuple[str, ...], groups: tuple[tuple[int, ...]]) -> None:
    X, y = dependent(*which), data()[1]
    scale = np.linalg.norm(X, axis=0)
    scale[scale == 0] = 1.0
    shortest = np.linalg.pinv(X / scale, rcond=1e-12) @ y
    np.testing.assert_allclose(fitted(X, y).value * scale, shortest, atol=1e-12)


def test_no_column_has_an_effect() -> None:
    fit = fitted(np.zeros((ROWS, 2)), data()[1])
    assert (fit.directions.rank, fit.directions.groups, fit.directions.condition) == (0, ((0,), (1,)), np.inf)
    np.testing.assert_array_equal(fit.value, [0, 0])
    assert fit.rss == pytest.approx(np.sum(data()[1] ** 2))


@pytest.mark.parametrize("which", [(), ("equal",), ("three", "zero")])
def test_units_of_the_columns_do_not_matter(which: tuple[str, ...]) -> None:
    X, y = dependent(*which), data()[1]
    units = 10.0 ** np.array([-6, 3, 6, -2, 5, 0])
    fit, other = fitted(X, y), fitted(X * units, y)
    assert (other.directions.rank, other.directions.groups) == (fit.directions.rank, fit.directions.groups)
    np.testing.assert_allclose(other.value * units, fit.value, rtol=1e-10)
    np.testing.assert_allclose(
        other.directions.inverse * np.outer(units, units), fit.directions.inverse, rtol=1e-9, atol=1e-12
    )
    assert other.rss == pytest.approx(fit.rss, rel=1e-12)
    if not which:
        assert other.directions.condition == pytest.approx(fit.directions.condition, rel=1e-12)


@pytest.mark.parametrize(("tolerance", "rank"), [(1e-12, COLUMNS), (1e-6, COLUMNS - 1)])
def test_tolerance_decides_on_nearly_dependent_columns(tolerance: float, rank: int) -> None:
    X, y = data()
    X[:, 3] = X[:, 2] + 1e-8 * X[:, 3]
    fit = fitted(X, y, tolerance=tolerance)
    assert fit.directions.rank == rank
    assert fit.directions.groups == (() if rank == COLUMNS else ((2, 3),))


def problem(model: Model, theta: Array, noise: Array, still: tuple[int, ...] = (), samples: int = 100) -> Problem:
    """Random states, the joints ``still`` at rest, and the given noise (samples, n) on the torque."""
    n = len(model.joints)
    q, dq, ddq = np.random.default_rng(0).normal(size=(3, samples, n)) * np.array([1.0, 2.0, 10.0])[:, None, None]
    dq[:, still] = 0.0
    tau = model.torque(q, dq, ddq, theta) + noise
    names = tuple(joint.name for joint in model.joints)
    motion = Motion(np.linspace(0, 1, samples), q, dq, ddq, tau, names, np.ones(samples, dtype=bool))
    return Problem(model, (motion,), Regression(model, (motion,)))


def test_intervals_cover_the_truth_as_often_as_they_say() -> None:
    """95 % intervals and the ellipsoid of all parameters, over many noises of the same motion."""
    model, runs, sigma = two_link_arm(), 250, 0.2
    rng = np.random.default_rng(5)
    p, freedom = len(model.names), 200 - 7
    inside, distance = np.zeros((runs, p), dtype=bool), np.zeros(runs)
    for k in range(runs):
        posed = problem(model, model.values, sigma * rng.normal(size=(100, 2)))
        result = LeastSquares()(posed)
        error = result.value - model.values
        inside[k] = np.abs(error) < student.ppf(0.975, freedom) * result.std
        distance[k] = error @ np.linalg.solve(result.covariance, error)
    assert (np.abs(inside.mean(axis=0) - 0.95) < 3 * np.sqrt(0.95 * 0.05 / runs)).all()
    expected = p * freedom / (freedom - 2)  # p times the mean of an F(p, freedom) variable
    assert abs(distance.mean() - expected) < 3 * distance.std() / np.sqrt(runs)
    (motion,) = posed.motions
    residual = motion.tau - model.torque(motion.q, motion.dq, motion.ddq, result.value)
    np.testing.assert_allclose(result.residual.sigma, np.sqrt(np.square(residual).sum(axis=0) / 99), rtol=1e-10)


def test_only_linear_estimators_have_such_rows() -> None:
    assert isinstance(LeastSquares(), LinearEstimator)
    with pytest.raises(ConfigError, match=r"fit = MaximumLikelihood\(\): is not linear in the parameters"):
        PhysicallyConsistent(fit=MaximumLikelihood())
    with pytest.raises(ConfigError, match="is not linear"):
        PhysicallyConsistent(fit=PhysicallyConsistent())
