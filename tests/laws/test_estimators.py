"""What every estimator promises (``dynident.testing``), for the whole family: a new one is added to ESTIMATORS."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from dynident.estimators import (
    AugmentedKalman,
    Didim,
    Estimate,
    Estimator,
    GeneralisedLeastSquares,
    InstrumentalVariables,
    LeastSquares,
    LinearEstimator,
    OutputError,
    PhysicallyConsistent,
    Problem,
    Ridge,
    RobustLeastSquares,
    TotalLeastSquares,
    WeightedLeastSquares,
)
from dynident.estimators.maximum_likelihood import MaximumLikelihood
from dynident.models import Model
from dynident.runtime.families import ESTIMATORS as FAMILY
from dynident.testing import ESTIMATOR_CHECKS, check_estimator
from dynident.testing.estimator import (
    MODELS,
    Check,
    builds_itself_from_its_settings,
    close_loops,
    is_frozen_configuration,
    make_problem,
    multisine_motion,
)

ESTIMATORS: list[Estimator] = [
    LeastSquares(),
    LeastSquares(weights="per_joint"),
    WeightedLeastSquares(),
    GeneralisedLeastSquares(),
    PhysicallyConsistent(),
    InstrumentalVariables(),
    MaximumLikelihood(),
    Ridge(),
    RobustLeastSquares(),
    RobustLeastSquares("tukey"),
    TotalLeastSquares(),
    AugmentedKalman(passes=2),
]
SIMULATING: list[Estimator] = [Didim(), OutputError(loop="closed")]  # long runs of an arm are in their own tests
every_estimator = pytest.mark.parametrize("estimator", ESTIMATORS, ids=repr)


@pytest.mark.parametrize("check", ESTIMATOR_CHECKS, ids=lambda check: check.__name__)
@pytest.mark.parametrize("make", MODELS.values(), ids=MODELS)
@every_estimator
def test_every_estimator(estimator: Estimator, make: Callable[[], Model], check: Check) -> None:
    check(estimator, make)


@every_estimator
def test_is_frozen_configuration(estimator: Estimator) -> None:
    is_frozen_configuration(estimator)


@pytest.mark.parametrize("estimator", [*ESTIMATORS, *SIMULATING], ids=repr)
def test_builds_itself_from_its_settings(estimator: Estimator) -> None:
    builds_itself_from_its_settings(FAMILY, estimator)


@pytest.mark.parametrize("check", ESTIMATOR_CHECKS, ids=lambda check: check.__name__)
@pytest.mark.parametrize("estimator", SIMULATING, ids=repr)
def test_every_estimator_that_needs_a_controller(estimator: Estimator, check: Check) -> None:
    check(estimator, MODELS["slider"])


LINEAR = [estimator for estimator in (*ESTIMATORS, *SIMULATING) if isinstance(estimator, LinearEstimator)]


@pytest.mark.parametrize("estimator", LINEAR, ids=repr)
def test_constraints_can_be_put_on_the_rows_of_every_linear_estimator(estimator: LinearEstimator) -> None:
    """They change nothing where the fit is physical as it is, and a bound holds where it is not."""
    model = MODELS["slider"]()
    problem = close_loops(make_problem(model, multisine_motion(model, noise=0.01)))
    free, held = estimator(problem), PhysicallyConsistent(fit=estimator)(problem)
    np.testing.assert_allclose(held.value, free.value, rtol=1e-5)
    np.testing.assert_allclose(held.std, free.std, rtol=1e-3)
    assert (held.needs_samples, held.residual.correlated) == (free.needs_samples, free.residual.correlated)
    bounded = PhysicallyConsistent(fit=estimator, bounds={model.names[0]: (6.0, None)})(problem)
    assert bounded.value[0] == pytest.approx(6.0, rel=1e-6)
    assert not estimator.quick().needs_samples or estimator.quick() == estimator


def test_every_kind_is_checked() -> None:
    assert {FAMILY.kind_of(estimator) for estimator in (*ESTIMATORS, *SIMULATING)} == set(FAMILY.table)


@dataclass(frozen=True)
class Bold(Estimator):
    """An estimator that thinks itself a hundred times better than it is."""

    def __call__(self, problem: Problem) -> Estimate:
        result = LeastSquares()(problem)
        return replace(result, covariance=1e-4 * result.covariance)


def test_an_estimator_that_breaks_a_promise_is_found() -> None:
    with pytest.raises(AssertionError):
        check_estimator(Bold())
