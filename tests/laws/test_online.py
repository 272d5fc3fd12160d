"""A result followed on the stream of a recording ends at the fit to all of it."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from dynident.apps.online import MotionBlock, Tracker, estimate_smoothing
from dynident.estimators import LeastSquares, PhysicallyConsistent, Problem
from dynident.identification import Identification, Recipe, identify
from dynident.models import Model, RigidBodies
from dynident.models.friction import Coulomb, Dahl, Offset, Viscous
from dynident.motion.log import Log
from dynident.motion.smoothers import Spline
from dynident.regression import ParallelFilter, Regression, Selection
from tests.robots import ARM

SIGMA = 2e-5
RECIPES: dict[str, dict[str, Any]] = {
    "plain": {},
    "weighted": {"estimator": LeastSquares(weights="per_joint")},
    "filtered": {"filter": ParallelFilter(decimate=4)},
    "low-pass": {"filter": ParallelFilter(cutoff=20.0)},
    "late": {"time_offset": 0.0123},
    "early": {"time_offset": -0.0077},
    "slow ones left out": {"min_speed": 0.1},
    "all of it": {"filter": ParallelFilter(decimate=3), "time_offset": 0.004, "min_speed": {"rail": 0.05}},
    "remembering": {"memory": True, "time_offset": 0.003},
}


def model(*, memory: bool = False) -> Model:
    bodies = RigidBodies(ARM)
    terms = [term(bodies.joints) for term in (Viscous, Coulomb, Offset)]
    return Model((bodies, *terms, *([Dahl(bodies.joints, length=0.05)] if memory else [])))


@cache
def recorded(*, jitter: float = 0.0) -> Log:
    rng, n, samples = np.random.default_rng(3), 3, 1500
    t = np.arange(samples) * 0.005 + 0.005 * jitter * rng.uniform(-0.5, 0.5, samples)
    rate, phase = rng.uniform(1.0, 6.0, (3, n)), rng.uniform(0.0, 6.0, (3, n))
    wave = 0.4 * np.exp(1j * (t[:, None, None] * rate + phase))
    q, dq, ddq = ((wave * (1j * rate) ** order).imag.sum(axis=1) for order in range(3))
    arm = model()
    theta = np.where(
        [parameter.body != "" for parameter in arm.parameters],
        [parameter.value or 0.0 for parameter in arm.parameters],
        0.5,
    )
    tau = arm.torque(q, dq, ddq, theta) + 0.05 * rng.standard_normal(q.shape)
    return Log(t, q + SIGMA * rng.standard_normal(q.shape), tau, tuple(joint.name for joint in arm.joints))


def identified(given: dict[str, Any], log: Log) -> Identification:
    settings = {"smoother": Spline(sigma=SIGMA), "outliers": "keep", "rests": "keep"} | given
    memory = settings.pop("memory", False)
    return identify(model(memory=memory), {"log": log}, (), Recipe(**settings))


def offline(result: Identification, log: Log, estimator: Any) -> Any:
    """The fit to all rows, with the weights of the result."""
    arm = result.model
    motion = arm.remembering(result.recipe.motion(log))
    regression = Regression(arm, (motion,), Selection(result.recipe.filter, result.recipe.min_speeds(motion.joints)))
    factors = regression.triangular_factors
    weights = result.estimate.residual.weights
    if weights is not None:
        factors = replace(factors, factors=factors.factors * weights[:, None, None])
    return estimator(Problem(arm, (motion,), regression.with_factors(factors)))


@pytest.mark.parametrize(("name", "jitter"), [*((name, 0.0) for name in RECIPES), ("late", 0.6), ("all of it", 0.6)])
def test_the_end_is_the_offline_fit(name: str, jitter: float) -> None:
    log = recorded(jitter=jitter)
    result = identified(RECIPES[name], log)
    expected = offline(result, log, LeastSquares())
    tracker, blocks = Tracker(result, estimate_smoothing(result, log)), list[MotionBlock]()
    for start in range(0, len(log), 70):
        part = slice(start, start + 70)
        blocks += tracker.push(log.t[part], log.q[part], log.tau[part])
    blocks += tracker.finish()
    actual = tracker.estimate()
    every = [entry for block in blocks for entry in block.entries]
    assert sum(x.tau.size if x.keep is None else x.keep.sum() for x in every) == tracker.fit.rows
    assert actual.determined.rank == expected.determined.rank
    rank, least = actual.determined.directions, 1e-3 if jitter and "filter" in RECIPES[name] else 1e-9
    seen = rank.vectors[:, : rank.rank].T @ (rank.scale * (actual.value - expected.value))
    np.testing.assert_allclose(seen, 0.0, atol=least * np.abs(rank.scale * expected.value).max())
    np.testing.assert_allclose(actual.std, expected.std, rtol=least)


def test_the_consistent_projection_is_the_offline_one() -> None:
    log = recorded()
    result = identified({"estimator": PhysicallyConsistent(costs=False)}, log)
    tracker = Tracker(result, estimate_smoothing(result, log))
    tracker.push(log.t, log.q, log.tau)
    tracker.finish()
    expected = offline(result, log, PhysicallyConsistent(costs=False, fit=LeastSquares()))
    np.testing.assert_allclose(tracker.estimate(PhysicallyConsistent(costs=False)).value, expected.value, atol=1e-5)
