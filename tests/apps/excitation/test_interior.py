"""The criterion with the barrier: its gradient, and that a finite value keeps to all limits."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.apps.excitation import Criterion
from dynident.apps.excitation.interior import GridReserve
from dynident.apps.excitation.search import random_motion
from tests.apps.excitation.arms import LIMITS, MODEL, THETA
from tests.apps.excitation.requests import OPEN, SPACE, interior

TIGHT = replace(LIMITS, torque=np.array([11.0, 3.5]))  # near what gravity takes


@pytest.mark.parametrize("kind", list(Criterion))
@pytest.mark.parametrize("family", ["fourier", "bspline"])
def test_the_gradient_is_that_of_the_value(kind, family):
    one = interior(criterion=kind, family=family, limits=TIGHT)
    rng = np.random.default_rng(1)
    x = random_motion(one, rng)
    assert one.gaps(one.states(x)[0]).min() < 0.3
    assert one.torque_slack(one.states(x)).min() < 0.3
    for weight in (0.0, 30.0):  # 30: of the barrier alone
        gradient = one.at(x, weight).gradient
        step = rng.normal(size=x.shape) * 1e-6
        ends = [one.at(x + side * step, weight).value for side in (1, -1)]
        assert ends[0] - ends[1] == pytest.approx(2 * float((gradient * step).sum()), rel=2e-5)


def test_the_metric_is_the_curvature_of_the_joints_own_limits():
    one = interior(space=OPEN, limits=replace(LIMITS, torque=np.full(2, np.inf)))
    x, weight = 0.7 * random_motion(one, np.random.default_rng(2)), 0.5

    def barrier(at):
        return one.at(at, weight).gradient - one.at(at, 0.0).gradient

    step = np.random.default_rng(3).normal(size=x.shape) * 1e-6
    found = (barrier(x + step) - barrier(x - step)) / 2
    expected = np.einsum("nkl,nl->nk", one.barrier_curvature(x, weight, 0.0), step)
    np.testing.assert_allclose(found, expected, rtol=2e-3, atol=1e-4 * np.abs(expected).max())


def test_a_motion_has_a_value_where_it_keeps_to_the_limits():
    one = interior()
    x = random_motion(one, np.random.default_rng(4))
    assert one.is_inside(x)
    far = x * np.linspace(1.0, 3.0, 30)[:, None, None]
    kept = [one.is_inside(each) for each in far]
    assert kept == [one.at(each, 1.0) is not None for each in far]
    assert not all(kept)


def test_each_limit_alone_is_kept():
    one = interior()
    x = random_motion(one, np.random.default_rng(5))
    room = one.range_slack(x).min(axis=0)
    rows = np.cumsum([0, *(len(rows) for rows in one.guard.rows)])
    for k, name in enumerate(("half", "velocity", "acceleration", "jerk")):
        used = one.guard.share - room[rows[k] : rows[k + 1]].min(axis=0)
        if name == "half":
            tight = {
                "lower": LIMITS.middle - 0.9 * used * LIMITS.half,
                "upper": LIMITS.middle + 0.9 * used * LIMITS.half,
            }
        else:
            tight = {name: 0.9 * used * getattr(LIMITS, name)}
        assert not interior(limits=replace(LIMITS, **tight)).is_inside(x), name
    assert not interior(limits=replace(LIMITS, torque=0.1 * LIMITS.torque)).is_inside(x)
    assert not interior(clearance=2.0).is_inside(x)


def test_limits_are_kept_between_the_points_of_the_grid():
    one = interior()
    x = random_motion(one, np.random.default_rng(6))
    t = np.linspace(0.0, one.family.duration, 5001)
    shares = np.abs(np.asarray(one.family.values(t) @ x.T) - np.stack([LIMITS.middle, *np.zeros((3, 2))])[:, None])
    assert (shares <= LIMITS.sizes[:, None]).all()
    assert one.between(x, MODEL) is None


def test_what_is_exceeded_between_the_points_is_kept_free():
    one = interior()
    x = random_motion(one, np.random.default_rng(6))
    tau = np.abs(MODEL.torque(*one.states(x)[:3], THETA)).max(axis=0)
    tight = replace(one.feasible, limits=replace(LIMITS, torque=0.95 * tau))
    free = replace(one, feasible=tight, spare=GridReserve(np.full(2, -1.0), np.full(len(SPACE.pairs), -1.0)))
    beyond = free.between(x, MODEL)
    assert (beyond.torque > -1.0 + 0.05).all()
    wider = one.with_reserve(beyond)
    np.testing.assert_array_equal(wider.spare.torque, np.maximum(beyond.torque, one.spare.torque))


def test_a_smaller_motion_keeps_what_the_larger_did_not():
    one = interior()
    x = random_motion(one, np.random.default_rng(7))
    left = one.torque_slack(one.states(x)).min(axis=(0, 1))
    wider = one.with_reserve(replace(one.spare, torque=one.spare.torque + left + 0.01))
    assert not wider.is_inside(x)
    smaller = wider.shrink(x)
    assert wider.is_inside(smaller)
    assert 0.3 < np.abs(smaller[:, 1:]).sum() / np.abs(x[:, 1:]).sum() < 1.0
    assert one.with_reserve(replace(one.spare, torque=np.full(2, 0.99))).shrink(x) is None
