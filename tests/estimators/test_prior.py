"""The prior touches only what the data leave free."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dynident.estimators import PhysicallyConsistent
from dynident.estimators.notes import DecidedByPrior, RankDeficient
from dynident.models import Model, change_frame
from tests.estimators.welded import cloud, pair, problem, random_body

Array = NDArray[np.float64]
ROD = cloud(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.4]]), np.array([1.0, 1.0]))
BODY = random_body(np.random.default_rng(1))


def named(model: Model, values: Array) -> dict[str, float]:
    return dict(zip(model.names, map(float, values), strict=True))


@pytest.mark.parametrize("distance", ["euclidean", "entropic"])
@pytest.mark.parametrize("truth", [BODY, 0.5 * ROD], ids=["inside", "boundary"])
def test_prior_decides_only_what_the_data_leave_free(distance: Any, truth: Array) -> None:
    rng = np.random.default_rng(5)
    model, X = pair()
    posed = problem(model, np.concatenate((truth, change_frame(truth, np.linalg.inv(X)))), 0.02)
    priors = [np.concatenate((random_body(rng), random_body(rng))) for _ in range(3)]
    result = [PhysicallyConsistent(prior=named(model, values), distance=distance)(posed) for values in priors]
    sums = [x.value[:10] + change_frame(x.value[10:], X) for x in result]
    for total in sums[1:]:
        np.testing.assert_allclose(total, sums[0], atol=1e-9)
    assert np.abs(result[1].value - result[0].value).max() > 1e-4
    for x in result:
        assert set(x.provenance) == {"prior"}
        assert np.isinf(x.std).all()
        assert x.determined.rank == 10
        assert x.notes == (RankDeficient(10, 20), DecidedByPrior(20))
        assert min(x.consistency.eigenvalues.values()) > 1e-6


@pytest.mark.parametrize("distance", ["euclidean", "entropic"])
def test_prior_that_agrees_with_the_data_is_the_answer(distance: Any) -> None:
    both = np.concatenate((BODY, random_body(np.random.default_rng(2))))
    model, _ = pair(BODY, both[10:])
    result = PhysicallyConsistent(distance=distance)(problem(model, both))
    np.testing.assert_allclose(result.value, both, atol=1e-8)
