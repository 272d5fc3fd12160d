"""The steps that the kernel takes are those of NumPy, on every level of this CPU."""

import numpy as np
import pytest

from dynident.models import Model, RotorInertia, recursion_kernel
from dynident.models.friction import Coulomb, Offset, Power, Viscous
from dynident.models.simulation.trace import Machine
from tests.kernel_levels import BEST, NAMES, functions_of
from tests.models.judge import random_bodies

STEPS, PIECES = 60, 7


@pytest.fixture(params=NAMES)
def level(request, monkeypatch):
    if request.param not in BEST:
        pytest.skip(f"there is no kernel for {request.param} here")
    monkeypatch.setattr(recursion_kernel, "function", functions_of(request.param))
    return request.param


def arm(seed, inertia=8.0):
    bodies, theta = random_bodies(seed, 1 + seed)
    joints, n = bodies.joints, len(bodies.joints)
    model = Model((bodies, RotorInertia(joints), Viscous(joints), Coulomb(joints), Offset(joints)))
    rng = np.random.default_rng(seed)
    friction = np.concatenate([rng.uniform(0.0, 1.0, n), rng.uniform(5.0, 60.0, n), rng.normal(size=n)])
    return model, np.concatenate([theta, np.full(n, inertia), friction])


def run(machine, q=0.5):
    rng, n = np.random.default_rng(0), len(machine.model.joints)
    states = np.full((2, STEPS + 1, PIECES, n), np.nan)
    states[:, 0] = rng.normal(scale=0.1, size=(2, PIECES, n))
    states[0, 0] += q
    ddq, h = np.zeros((PIECES, n)), rng.uniform(5e-4, 1e-3, STEPS)
    machine.take_steps(*states, ddq, rng.normal(scale=20.0, size=(PIECES, n)), h)
    return [*states, ddq]


def by_numpy(model, theta):
    machine = Machine(model, theta)
    machine._compiled = None
    return machine


@pytest.mark.parametrize("seed", range(6))
def test_steps_with_friction_that_slides_and_holds(level, seed):
    model, theta = arm(seed)
    machine = Machine(model, theta)
    assert machine._compiled is not None
    ours, theirs = run(machine), run(by_numpy(model, theta))
    held = np.abs(theirs[1]) < 1e-9
    assert held.any()
    assert not held.all()
    for compiled, expected in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(compiled, expected, rtol=1e-6, atol=1e-7)


def test_a_mass_matrix_that_is_singular(level):
    model, theta = arm(2)
    for machine in (Machine(model, 0 * theta), by_numpy(model, 0 * theta)):
        with pytest.raises(np.linalg.LinAlgError, match="Singular"):
            run(machine)


def test_other_friction_is_left_to_numpy(level):
    bodies, theta = random_bodies(2, 3)
    model = Model((bodies, Power(bodies.joints, exponent=0.5)))
    assert Machine(model, np.append(theta, np.ones(len(bodies.joints))))._compiled is None


def test_states_that_are_not_contiguous_are_refused(level):
    model, theta = arm(2)
    machine, n = Machine(model, theta), len(model.joints)
    states = np.zeros((2, 3, PIECES, 2 * n))[..., ::2]
    with pytest.raises(ValueError, match="contiguous"):
        machine.take_steps(*states, np.zeros((PIECES, n)), np.zeros((PIECES, n)), np.full(2, 1e-3))
