"""Recursive least squares: what enters is as in a fit of all samples; what is forgotten, and what stays."""

import math
from dataclasses import replace

import numpy as np
import pytest

from dynident.apps.online import RecursiveLeastSquares
from dynident.estimators import LeastSquares, LinearEstimator, PhysicallyConsistent, Problem
from dynident.models import Model, RigidBodies
from dynident.models.friction import Coulomb, Offset, Viscous
from dynident.models.lagrangian import pendulum, two_link_arm
from dynident.motion.log import Motion
from dynident.regression import GroupKind, Regression
from dynident.runtime import ConfigError, InputError
from dynident.runtime.arrays import Array
from dynident.runtime.families import ESTIMATORS
from tests.robots import ARM

STEP, SIGMA = 0.01, 0.05
FRICTION = {GroupKind.FRICTION: 2.0, GroupKind.PAYLOAD: 5.0}


def arm() -> Model:
    bodies = RigidBodies(ARM)
    return Model((bodies, *(term(bodies.joints) for term in (Viscous, Coulomb, Offset))))


def rusty() -> Model:
    links = pendulum()
    return Model((*links.terms, Viscous(links.joints), Coulomb(links.joints)))


def moving(model: Model, samples: int = 400, moves: int | None = None) -> Motion:
    """A motion with noisy torques of parameters between 0.5 and 1.5; of joint ``moves`` alone, or of all."""
    rng, n = np.random.default_rng(3), len(model.joints)
    t = np.arange(samples) * STEP
    rate, phase = rng.uniform(1.0, 6.0, (3, n)), rng.uniform(0.0, 6.0, (3, n))
    wave = 0.4 * np.exp(1j * (t[:, None, None] * rate + phase))
    if moves is not None:
        wave[:, :, np.arange(n) != moves] = 0.0
    q, dq, ddq = ((wave * (1j * rate) ** order).imag.sum(axis=1) for order in range(3))
    theta = rng.uniform(0.5, 1.5, len(model.names))
    tau = model.torque(q, dq, ddq, theta) + SIGMA * rng.standard_normal(q.shape)
    names = tuple(joint.name for joint in model.joints)
    return Motion(t, q, dq, ddq, tau, names, np.ones(samples, dtype=bool))


def given(motion: Motion, rows: slice | int = slice(None)) -> tuple[Array, ...]:
    return tuple(getattr(motion, name)[rows] for name in ("t", "q", "dq", "ddq", "tau"))


def taken(fit: RecursiveLeastSquares, motion: Motion, size: int = 10**6) -> RecursiveLeastSquares:
    for start in range(0, len(motion), size):
        fit.update(*given(motion, slice(start, start + size)))
    return fit


@pytest.mark.parametrize("make", [pendulum, two_link_arm, arm])
@pytest.mark.parametrize("weighted", [False, True])
def test_the_end_is_the_fit_to_all_samples(make, weighted: bool) -> None:
    model = make()
    motion = moving(model, 200)
    weights = np.linspace(1.0, 3.0, len(model.joints)) if weighted else None
    all_of = Regression(model, (motion,), weights=() if weights is None else (np.tile(weights, (len(motion), 1)),))
    offline = LeastSquares()(Problem(model, (motion,), all_of))
    single = RecursiveLeastSquares(model, weights)
    for k in range(len(motion)):
        single.update(*given(motion, k))
    for fit in (single, taken(RecursiveLeastSquares(model, weights), motion, 57)):
        online = fit.estimate()
        assert online.determined.rank == offline.determined.rank
        np.testing.assert_allclose(online.value, offline.value, rtol=0, atol=1e-9)
        np.testing.assert_allclose(online.covariance, offline.covariance, rtol=1e-9, atol=1e-12)
        assert fit.rows == motion.q.size


def test_the_residual_is_that_of_each_joint_by_its_weight() -> None:
    model = arm()
    motion = moving(model)
    noisy = np.array([1.0, 3.0, 10.0])
    rough = motion.tau + SIGMA * np.random.default_rng(0).standard_normal(motion.q.shape) * noisy
    fit = RecursiveLeastSquares(model, 1.0 / (SIGMA * np.sqrt(1.0 + noisy**2)))
    residual = taken(fit, replace(motion, tau=rough)).estimate().residual
    np.testing.assert_allclose(residual.sigma, SIGMA * np.sqrt(1.0 + noisy**2), rtol=0.1)
    assert residual.samples == len(motion)


@pytest.mark.parametrize("size", [1, 7, 400])
def test_one_memory_is_least_squares_with_weights_that_fade(size: int) -> None:
    model, memory = rusty(), 1.5
    motion = moving(model)
    fit = taken(RecursiveLeastSquares(model, memory=memory), motion, size)
    stepped = np.floor(motion.t * (100 / memory)) * memory / 100  # forgetting is in steps of a hundredth
    fading = np.exp(-(stepped[-1] - stepped) / (2 * memory))
    X = (model.regressor(motion.q, motion.dq, motion.ddq) * fading[:, None, None]).reshape(-1, 4)
    expected = np.linalg.lstsq(X, (motion.tau * fading[:, None]).ravel())[0]
    np.testing.assert_allclose(fit.estimate().value, expected, rtol=0, atol=1e-11)
    assert fit.rows == pytest.approx((fading**2).sum(), rel=0.01)  # of the first few rows none is forgotten


def test_forgetting_a_group_is_process_noise_in_what_the_others_leave_of_it() -> None:
    model = rusty()
    motion, memory = moving(model, 300), {GroupKind.FRICTION: 2.0}
    fit = taken(RecursiveLeastSquares(model, memory=memory), motion)
    before = fit.factors.factors[0]
    P = np.linalg.inv(before[:4, :4].T @ before[:4, :4])
    fit.forget(1.0)
    after = fit.factors.factors[0]
    bodies, rub = slice(0, 2), slice(2, 4)
    given_bodies = P[rub, rub] - P[rub, bodies] @ np.linalg.solve(P[bodies, bodies], P[bodies, rub])
    P[rub, rub] += (math.exp(1.0 / 2.0) - 1.0) * given_bodies
    np.testing.assert_allclose(np.linalg.inv(after[:4, :4].T @ after[:4, :4]), P, rtol=1e-9)


@pytest.mark.parametrize("memory", [3.0, FRICTION])
@pytest.mark.parametrize("moves", [None, 1])
def test_forgetting_keeps_what_the_data_determine(memory, moves: int | None) -> None:
    model = arm()
    motion = moving(model, 400, moves)
    fit = taken(RecursiveLeastSquares(model, memory=memory), motion)
    fit.forget(1e-6)  # the rows that only rounding makes are gone from here on
    before, Y = fit.estimate(), model.regressor(motion.q, motion.dq, motion.ddq)
    most = 1e-8 if moves is None else 1e-3 * SIGMA  # a joint alone shows some too little for the rank, but more than 0
    for seconds in (0.3, 3.0, 1e4):
        fit.forget(seconds)
        after = fit.estimate()
        assert after.determined.rank == before.determined.rank
        np.testing.assert_allclose(Y @ after.value, Y @ before.value, rtol=0, atol=most)


def test_without_data_the_values_near_are_kept() -> None:
    model = arm()
    near = np.linspace(0.5, 1.5, len(model.names))
    fit = RecursiveLeastSquares(model, near=near)
    np.testing.assert_array_equal(fit.estimate().value, near)
    with pytest.raises(InputError, match="PhysicallyConsistent needs samples, and none was taken yet"):
        fit.estimate(PhysicallyConsistent())
    taken(fit, moving(model, 400, moves=2))
    result = fit.estimate()
    rank = result.determined.directions
    assert 0 < rank.rank < len(near) - 20
    moved = (result.value - near) * rank.scale
    np.testing.assert_allclose(moved @ rank.vectors[:, rank.rank :], 0.0, atol=1e-9)
    assert np.linalg.norm(moved) > 1.0


@pytest.mark.parametrize("kind", ESTIMATORS.table)
def test_an_estimator_that_needs_the_samples_is_named_and_any_other_fits(kind: str) -> None:
    model = two_link_arm()
    fit = RecursiveLeastSquares(model)
    fit.update(*given(moving(model), slice(0, 100)))
    chosen = ESTIMATORS.get(kind)()
    for case in (chosen, *([PhysicallyConsistent(fit=chosen)] if isinstance(chosen, LinearEstimator) else [])):
        if kind in ("least_squares", "consistent", "ridge"):
            assert np.isfinite(fit.estimate(case).value).all()
        else:
            with pytest.raises(ConfigError, match=f"{type(case).__name__} needs all samples"):
                fit.estimate(case)


def test_bad_input_is_named() -> None:
    model = two_link_arm()
    motion = moving(model)
    t, q, dq, ddq, tau = given(motion, slice(0, 10))
    with pytest.raises(ConfigError, match=r"memory = 0: give a positive number of seconds"):
        RecursiveLeastSquares(model, memory={GroupKind.FRICTION: 0})
    with pytest.raises(ConfigError, match="a positive number for each of the 2 joints"):
        RecursiveLeastSquares(model, weights=[1.0, 0.0])
    with pytest.raises(ConfigError, match=f"each of the {len(model.names)} parameters"):
        RecursiveLeastSquares(model, near=[1.0])
    fit = RecursiveLeastSquares(model, memory=1.0)
    with pytest.raises(InputError, match=r"dq has shape \(10, 1\); 10 samples of 2 joints are \(10, 2\)"):
        fit.update(t, q, dq[:, :1], ddq, tau)
    with pytest.raises(InputError, match="tau has values that are not finite"):
        fit.update(t, q, dq, ddq, np.where(tau == tau[3], np.nan, tau))
    fit.update(t, q, dq, ddq, tau)
    with pytest.raises(InputError, match=r"t = 0.0 s is before the sample before it"):
        fit.update(t, q, dq, ddq, tau)
    with pytest.raises(InputError, match=r"the saved factor has shape .*; start anew"):
        RecursiveLeastSquares(pendulum()).restore(fit.state)
    turned, state = RecursiveLeastSquares(arm(), memory=FRICTION), RecursiveLeastSquares(arm()).state
    with pytest.raises(InputError, match="the saved factor is of another memory"):
        turned.restore(state)
    assert fit.rows == pytest.approx(20.0, rel=0.2)
