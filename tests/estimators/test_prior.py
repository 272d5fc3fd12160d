"""The prior touches only what the data leave free."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dynident.estimators import Constraints, PhysicallyConsistent, bodies_of, estimate_sizes, parameter_scales
from dynident.estimators.cone import minimise
from dynident.estimators.notes import DecidedByPrior, NotIdentifiable, RankDeficient
from dynident.models import Model, change_frame, to_pseudo
from tests.estimators.welded import Drag, Welded, cloud, pair, problem, random_body, single, turned

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
        value = PhysicallyConsistent(prior=named(model, aims), distance=name)(posed).value  # type: ignore[arg-type]
        for _ in range(50):
            step = 1e-3 * random_body(rng) * rng.choice([-1, 1])
            other = value + np.concatenate((step, -change_frame(step, np.linalg.inv(X))))
            possible = min(smallest(other[:10]), smallest(other[10:])) > 1e-6
            assert not possible or distance(other) > distance(value)


def test_entropic_prior_depends_on_no_frame_and_no_unit() -> None:
    """The same bodies described in other frames, and in centimetres, are the same answer."""
    rng = np.random.default_rng(4)
    truth, prior = [np.concatenate((random_body(rng), random_body(rng))) for _ in range(2)]
    model, X = pair()
    value = PhysicallyConsistent(prior=named(model, prior))(problem(model, truth, 0.05)).value
    A, B = turned(rng), turned(rng)
    B[:3, :3] *= 100.0
    frames: tuple[Array, ...] = (np.linalg.inv(A).astype(float), X @ np.linalg.inv(B))
    other = Model((Welded(frames, (None, None)),))
    told = [np.concatenate((change_frame(v[:10], A), change_frame(v[10:], B))) for v in (truth, prior, value)]
    again = PhysicallyConsistent(prior=named(other, told[1]))(problem(other, told[0], 0.05)).value
    np.testing.assert_allclose(again, told[2], rtol=1e-5, atol=1e-7 * np.abs(told[2]).max())


def test_without_a_prior_the_free_is_unidentifiable_and_small() -> None:
    """Without forces the mass makes no torque: the least one that the rest allows is taken."""
    model = single(None, moments_only=True)
    result = PhysicallyConsistent(prior="none")(problem(model, BODY, 0.01))
    assert result.provenance[0] == "unidentifiable"
    assert set(result.provenance[1:]) <= {"data", "bound"}
    assert np.isinf(result.std[0])
    assert np.isfinite(result.std[1:]).all()
    np.testing.assert_allclose(result.value[1:], BODY[1:], atol=5 * result.std[1:].max())
    assert 0 < result.value[0] < BODY[0]
    assert NotIdentifiable(1) in result.notes


def test_log_that_says_nothing_leaves_all_to_the_prior() -> None:
    """No motion, no torque: no warning, no error, and the nominal values."""
    posed = problem(single(BODY), np.zeros(10), spread=(0,) * 9)
    for distance in ("entropic", "euclidean"):
        result = PhysicallyConsistent(distance=distance)(posed)
        np.testing.assert_allclose(result.value, BODY, atol=1e-6)
        assert (result.determined.rank, set(result.provenance), set(result.consistency.costs.values())) == (
            0,
            {"prior"},
            {0.0},
        )


def test_towards_an_impossible_prior_the_bodies_go_as_far_as_they_may() -> None:
    """The second body's mass should lie far outside of it: its constraints act. The conic solver finds nothing nearer.

    A bound against the data lets the first program begin from no prior.
    """
    rng = np.random.default_rng(8)
    both = np.concatenate((BODY, random_body(rng)))
    aims = np.concatenate((random_body(rng), random_body(rng)))
    aims[11:14] *= 10
    bodies, X = pair()
    model = Model((*bodies.terms, Drag(bodies.joints, "viscous")))
    friction, posed = model.names[-1], problem(model, np.append(both, 0.5), 0.1)
    setting = {"bounds": {friction: (0.6, None)}, "prior": named(model, np.append(aims, 0.5))}
    result = PhysicallyConsistent(distance="euclidean", **setting)(posed).value[:20]  # type: ignore[arg-type]
    held_bodies = estimate_sizes(bodies_of(model.parameters), model.parameters, posed.regression.triangular_factors)
    scale = parameter_scales(model.parameters, held_bodies, np.ones(len(model.parameters)), 1.0)[:20]

    def distance(theta: Array) -> float:
        return float(np.sum(((theta - aims) / scale) ** 2))

    assert 0 < smallest(result[10:]) < 1e-4
    free = np.array([np.concatenate((step, -change_frame(step, np.linalg.inv(X)))) for step in np.eye(10)]).T
    near, aside = free / scale[:, None], (result - aims) / scale
    held = Constraints(bodies=held_bodies, margin=1e-5)
    best = minimise(near.T @ near, near.T @ aside, held, np.append(result, 0.6), np.vstack([free, np.zeros(10)]))
    assert best.is_optimal
    assert distance(result) == pytest.approx(distance(result + free @ best.point), rel=1e-4)
