"""Friction that remembers is identified: hysteresis, and friction by a load that a first fit finds."""

from dataclasses import replace

import numpy as np
import pytest

import dynident as dy
from dynident.models.friction import Dahl, LoadCoulomb
from dynident.models.lagrangian import two_link_arm
from dynident.motion.log import Log, Motion
from dynident.runtime import ModelError
from dynident.validation import free_run
from tests.identification.motions import sines

ARM = two_link_arm()
(BODIES, FRICTION) = ARM.terms
THETA = np.array([*ARM.values[:-2], 0.03, 0.02, 0.05, 0.04, 0.15, 0.1])
MODEL = dy.Model(
    (BODIES, dy.Viscous(BODIES.joints), Dahl(BODIES.joints, length=0.02), LoadCoulomb(BODIES.joints, width=0.05))
)


@pytest.fixture(scope="module")
def truth():
    t = np.arange(6000) * 0.002
    w = np.array([[1.3, 1.7], [2.9, 3.7], [0.7, 0.4]])
    size = np.array([[0.5, 0.4], [0.2, 0.25], [0.3, 0.3]])
    sums = sines(t, size, w, w**2)
    names = tuple(joint.name for joint in MODEL.joints)
    model = MODEL.with_load(THETA)
    motion = model.remembering(Motion(t, *sums, 0 * sums[0], names, np.ones(len(t), bool), "arm"))
    return replace(motion, tau=model.torque(**motion.states(), theta=THETA))


@pytest.fixture(scope="module")
def log(truth):
    rng = np.random.default_rng(0)
    noise = rng.standard_normal((2, *truth.q.shape))
    return Log(truth.t, truth.q + 1e-6 * noise[0], truth.tau + 0.001 * noise[1], truth.joints, "arm")


@pytest.fixture(scope="module")
def load_result(log):
    return dy.identify(MODEL, [log.window(0.0, 8.0)], [replace(log.window(8.0), source="later")])


def test_the_parameters_are_found(load_result, truth):
    own = slice(len(THETA) - 6, None)
    np.testing.assert_allclose(load_result.estimate.value[own], THETA[own], rtol=0.1)
    assert load_result.validations[0].errors.relative_error < 1.0
    load, own = truth.memory[:, 2:], load_result.model.remembering(truth).memory[:, 2:]
    assert np.linalg.norm(own - load) < 0.1 * np.linalg.norm(load), "the first fit takes other friction for load"


def test_the_memory_goes_on_in_a_free_simulation(load_result, truth):
    motion = load_result.validations[0].motion
    run = free_run(load_result.model, load_result.estimate.value, motion.select_between(2.0, 3.0), restart=0.5)
    assert run.failure is None
    assert max(run.motion_error.values()) < 10.0
    exact = free_run(MODEL.with_load(THETA), THETA, truth.select_between(2.0, 3.0), restart=0.5)
    without = free_run(ARM.with_gravity(lambda g: g), ARM.values, truth.select_between(2.0, 3.0), restart=0.5)
    assert max(exact.motion_error.values()) < 1.0 < min(without.motion_error.values())


def test_maximum_likelihood_takes_the_memory_of_the_smoothed_motion(log, load_result):
    recipe = dy.Recipe(estimator=dy.MaximumLikelihood())
    likely = dy.identify(MODEL, [log.window(0.0, 4.0)], recipe=recipe)
    np.testing.assert_allclose(likely.estimate.value[-6:], THETA[-6:], rtol=0.2)


def test_bounds_of_friction_by_the_load_wait_for_it(log):
    (name, *_) = LoadCoulomb(BODIES.joints, width=0.05).parameters
    bounded = dy.PhysicallyConsistent(bounds={name.name: (None, 0.1)}, prior={name.name: 0.05})
    result = dy.identify(MODEL, [log.window(0.0, 4.0)], estimator=bounded)
    assert result.estimate.value[MODEL.names.index(name.name)] == pytest.approx(0.1)
    assert result.recipe.estimator.named == (name.name,)


def test_a_model_without_bodies_has_no_load(log):
    friction = dy.Model((dy.Viscous(BODIES.joints), LoadCoulomb(BODIES.joints)))
    with pytest.raises(ModelError, match="no term is of bodies"):
        dy.identify(friction, [log])
