"""The entries that hold all others give back the regressor; nothing is assumed of a term that says nothing."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from dynident.models import (
    CoupledMotor,
    Model,
    Partials,
    RigidBodies,
    RotorInertia,
    Structure,
    Term,
    common_structure,
    random_states,
)
from dynident.models.friction import Coulomb, Viscous
from dynident.models.structure import select_independent
from dynident.runtime import ModelError
from tests.robots import three_joints

Array = NDArray[np.float64]
ARM = three_joints(wrist="prismatic")


@dataclass(frozen=True)
class Chosen(Term):
    """Rigid bodies that give chosen entries by taking them from the regressor; ``wrong`` spoils what they say."""

    bodies: RigidBodies
    wrong: str = ""

    @property
    def joints(self) -> Any:
        return self.bodies.joints

    @property
    def parameters(self) -> Any:
        return self.bodies.parameters

    @property
    def gravity(self) -> tuple[float, ...]:
        return self.bodies.gravity

    def with_gravity(self, gravity: tuple[float, ...]) -> Chosen:
        return replace(self, bodies=self.bodies.with_gravity(gravity))

    def regressor(self, q: Array, dq: Array, ddq: Array) -> Array:
        return self.bodies.regressor(q, dq, ddq)

    def partials(self, q: Array, dq: Array, ddq: Array, theta: Array) -> Partials:
        return self.bodies.partials(q, dq, ddq, theta)

    @property
    def support(self) -> NDArray[np.bool_]:
        if self.wrong == "support":
            return np.ones((1, 30), dtype=bool)
        return np.repeat(np.tri(3, dtype=bool).T, 10, axis=1)

    def entries(self, q: Array, dq: Array, ddq: Array, joint: NDArray[np.intp], parameter: NDArray[np.intp]) -> Array:
        rows = self.regressor(q, dq, ddq).transpose(1, 2, 0)[joint, parameter]
        return rows[:-1] if self.wrong == "entries" else rows


def arm(gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)) -> Model:
    bodies = Chosen(RigidBodies(ARM, gravity=gravity))
    joints = bodies.joints
    motor = CoupledMotor(joints, {"j2": 1.0, "j3": -6.0}, "motor")
    return Model((bodies, RotorInertia(joints), Viscous(joints), Coulomb(joints), motor))


def recovered(structure: Structure, model: Model, *states: Array) -> Array:
    entries = model.entries(*states, structure.joint, structure.parameter)
    parts = zip(structure.parts, structure.maps, strict=True)
    return np.stack([entries[part].T @ x for part, x in parts], axis=1)


@pytest.mark.parametrize("gravity", [(0.0, 0.0, -9.81), (0.3, -0.2, -9.8), (0.0, 0.0, 0.0)])
def test_the_entries_hold_the_whole_regressor(gravity: tuple[float, float, float]) -> None:
    model = arm(gravity)
    states = random_states(model.joints, np.random.default_rng(7), 50)
    Y = model.regressor(*states)
    np.testing.assert_allclose(recovered(model.structure, model, *states), Y, rtol=1e-12, atol=1e-12 * np.abs(Y).max())


def test_one_structure_under_four_gravities_holds_under_any() -> None:
    structure = common_structure([arm(gravity) for gravity in ((0, 0, 0), (9.81, 0, 0), (0, 9.81, 0), (0, 0, 9.81))])
    model = arm((1.0, -2.0, 5.0))
    states = random_states(model.joints, np.random.default_rng(3), 20)
    Y = model.regressor(*states)
    np.testing.assert_allclose(recovered(structure, model, *states), Y, rtol=1e-12, atol=1e-12 * np.abs(Y).max())


@pytest.mark.parametrize("wrong", ["support", "entries"])
def test_a_wrong_shape_is_an_error(wrong: str) -> None:
    with pytest.raises(ModelError, match=wrong):
        _ = Model((Chosen(RigidBodies(ARM), wrong),)).structure


def test_entries_that_are_not_finite_are_named() -> None:
    model = arm()
    q = np.full((2, 3), 0.1)
    q[1, 2] = np.inf
    with np.errstate(invalid="ignore"), pytest.raises(ModelError, match="at sample 1 in its entries"):
        model.entries(q, q, q, model.structure.joint, model.structure.parameter)


@pytest.mark.parametrize(("step", "kept"), [(0.0, 2), (1e-15, 2), (1e-10, 3), (1e-5, 3)])
def test_columns_are_dependent_only_to_rounding(step: float, kept: int) -> None:
    X = np.random.default_rng(1).normal(size=(200, 3))
    X[:, 2] = X[:, 0] - 2 * X[:, 1] + step * X[:, 2]
    b, K = select_independent(X)
    assert len(b) == kept
    np.testing.assert_allclose(X[:, b] @ K, X, atol=1e-13)
