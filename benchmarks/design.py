"""The criterion of a motion with its gradient by all coefficients, as the search for a motion asks for it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from bodies import chain
from numpy.typing import NDArray

Array = NDArray[np.float64]
HARMONICS, PERIOD, STEP = 5, 10.0, 1e-6


def gradient(way: str, joints: int, points: int) -> Callable[[], object]:
    """-log det of the information of all base parameters, friction among them, on a Fourier series, and its gradient:
    exact, or by a step in each coefficient.
    """
    from dynident.apps.excitation.criterion import InformationCriterion
    from dynident.apps.excitation.family import Fourier
    from dynident.models import Model, RigidBodies, RotorInertia
    from dynident.models.friction import Coulomb, Offset, Viscous
    from dynident.regression import structural_base_parameters

    bodies = RigidBodies(chain(joints))
    friction = (RotorInertia, Viscous, Offset)
    model = Model((bodies, *(term(bodies.joints) for term in friction), Coulomb(bodies.joints, width=0.05)))
    family = Fourier(PERIOD, HARMONICS)
    functions = family.values(np.linspace(0.0, PERIOD, points, endpoint=False))[:3]
    x = np.random.default_rng(0).normal(scale=0.4, size=(joints, family.size))
    criterion = InformationCriterion(model, structural_base_parameters(model).independent, np.full(joints, 1e3))

    def exact() -> Array:
        _, slopes = criterion.value_and_gradients(*(functions @ x.T))
        return np.asarray(np.einsum("din,dik->nk", slopes, functions))

    def by_steps() -> Array:
        here, out = criterion.value(*(functions @ x.T)), np.empty(x.size)
        for k, step in enumerate(STEP * np.eye(x.size)):
            out[k] = (criterion.value(*(functions @ (x + step.reshape(x.shape)).T)) - here) / STEP
        return out.reshape(x.shape)

    return by_steps if way == "differences" else exact


def clearances(way: str, joints: int, points: int) -> Callable[[], object]:
    """Distances of the links of an arm as capsules to each other and to the floor, with their derivatives by the
    positions: exact, or by a step in each joint.
    """
    from dynident.apps.excitation import build_space
    from dynident.models import Floor, RigidBodies
    from dynident.models.geometry import build_geometry

    space = build_space(build_geometry(RigidBodies(chain(joints))), [Floor(-0.5)])
    q = np.random.default_rng(0).uniform(-1, 1, (points, joints))

    def by_steps() -> Array:
        here = space.distances(q)
        return np.stack([(space.distances(q + STEP * x) - here) / STEP for x in np.eye(joints)], axis=2)

    return by_steps if way == "differences" else lambda: space.gradients(q)
