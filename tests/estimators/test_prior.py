"""The prior touches only what the data leave free."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dynident.estimators import PhysicallyConsistent
from dynident.estimators.notes import DecidedByPrior, NotIdentifiable, RankDeficient
from dynident.models import Model, change_frame, to_pseudo
from tests.estimators.welded import Welded, cloud, pair, problem, random_body, single, turned

Array = NDArray[np.float64]
ROD = cloud(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.4]]), np.array([1.0, 1.0]))
BODY = random_body(np.random.default_rng(1))


def smallest(theta: Array) -> float:
    return float(np.linalg.eigvalsh(to_pseudo(theta[:10]))[0])


def named(model: Model, values: Array) -> dict[str, float]:
    return dict(zip(model.names, map(float, values), strict=True))


@pytest.mark.parametrize("distance", ["euclidean", "entropic"])
@pytest.mark.parametrize("truth", [BODY, 0.5 * ROD], ids=["inside", "boundary"])
def test_prior_decides_only_what_the_data_leave_free(distance: Any, truth: Array) -> None:
    rng = np.random.default_rng(5)
    model, X = pair()
    posed = problem(model, np.concatenate((truth, change_frame(truth, np.linalg.inv(X)))), 0.02)
    priors = [np.concatenate((random_body(rng), random_body(rng))) for _ in range(3)]
    found = [PhysicallyConsistent(prior=named(model, values), distance=distance)(posed) for values in priors]
    sums = [x.value[:10] + change_frame(x.value[10:], X) for x in found]
    for total in sums[1:]:
        np.testing.assert_allclose(total, sums[0], atol=1e-9)
    assert np.abs(found[1].value - found[0].value).max() > 1e-4
    for x in found:
        assert set(x.provenance) == {"prior"}
        assert np.isinf(x.std).all()
        assert x.determined.rank == 10
        assert x.notes == (RankDeficient(10, 20), DecidedByPrior(20))
        assert min(x.consistency.eigenvalues.values()) > 1e-6


def test_distances_are_least_where_they_should_be() -> None:
    """Neither distance can be lessened by moving along the free directions."""
    rng = np.random.default_rng(8)
    both = np.concatenate((BODY, random_body(rng)))
    aims = np.concatenate((random_body(rng), random_body(rng)))
    model, X = pair()
    posed = problem(model, both, 0.1)
    scale = np.tile(0.1 ** np.array([0, 1, 1, 1, 2, 2, 2, 2, 2, 2]), 2)

    def divergence(theta: Array) -> float:
        Q = np.linalg.solve(to_pseudo(aims.reshape(2, 10)), to_pseudo(theta.reshape(2, 10)))
        sign, logs = np.linalg.slogdet(Q)
        return float(np.trace(Q, axis1=1, axis2=2).sum() - logs.sum()) if (sign > 0).all() else np.inf

    def euclidean(theta: Array) -> float:
        return float(np.sum(((theta - aims) / scale) ** 2))

    for name, distance in (("entropic", divergence), ("euclidean", euclidean)):
        found = PhysicallyConsistent(prior=named(model, aims), distance=name)(posed).value  # type: ignore[arg-type]
        for _ in range(50):
            step = 1e-3 * random_body(rng) * rng.choice([-1, 1])
            other = found + np.concatenate((step, -change_frame(step, np.linalg.inv(X))))
            possible = min(smallest(other[:10]), smallest(other[10:])) > 1e-6
            assert not possible or distance(other) > distance(found)


def test_entropic_prior_depends_on_no_frame_and_no_unit() -> None:
    """The same bodies described in other frames, and in centimetres, are the same answer."""
    rng = np.random.default_rng(4)
    truth, prior = [np.concatenate((random_body(rng), random_body(rng))) for _ in range(2)]
    model, X = pair()
    found = PhysicallyConsistent(prior=named(model, prior))(problem(model, truth, 0.05)).value
    A, B = turned(rng), turned(rng)
    B[:3, :3] *= 100.0
    frames: tuple[Array, ...] = (np.linalg.inv(A).astype(float), X @ np.linalg.inv(B))
    other = Model((Welded(frames, (None, None)),))
    told = [np.concatenate((change_frame(v[:10], A), change_frame(v[10:], B))) for v in (truth, prior, found)]
    again = PhysicallyConsistent(prior=named(other, told[1]))(problem(other, told[0], 0.05)).value
    np.testing.assert_allclose(again, told[2], rtol=1e-5, atol=1e-7 * np.abs(told[2]).max())


def test_without_a_prior_the_free_is_unidentifiable_and_small() -> None:
    """Without forces the mass makes no torque: the least one that the rest allows is taken."""
    model = single(None, moments_only=True)
    found = PhysicallyConsistent(prior="none")(problem(model, BODY, 0.01))
    assert found.provenance[0] == "unidentifiable"
    assert set(found.provenance[1:]) <= {"data", "bound"}
    assert np.isinf(found.std[0])
    assert np.isfinite(found.std[1:]).all()
    np.testing.assert_allclose(found.value[1:], BODY[1:], atol=5 * found.std[1:].max())
    assert 0 < found.value[0] < BODY[0]
    assert NotIdentifiable(1) in found.notes


def test_log_that_says_nothing_leaves_all_to_the_prior() -> None:
    """No motion, no torque: no warning, no error, and the nominal values."""
    posed = problem(single(BODY), np.zeros(10), spread=(0,) * 9)
    for distance in ("entropic", "euclidean"):
        found = PhysicallyConsistent(distance=distance)(posed)
        np.testing.assert_allclose(found.value, BODY, atol=1e-6)
        assert (found.determined.rank, set(found.provenance), set(found.consistency.costs.values())) == (
            0,
            {"prior"},
            {0.0},
        )
