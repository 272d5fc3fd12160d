"""Base parameters: rank, groupings in words, the maps between base and standard, and what excitation is missing."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from dynident.models import Joint, Model, Parameter, RigidBodies, RotorInertia
from dynident.models.friction import Coulomb, Offset, Viscous
from dynident.models.lagrangian import two_link_arm
from dynident.motion.log import Motion
from dynident.regression import (
    BaseParameters,
    Regression,
    RegressorBlock,
    base_parameters,
    base_std,
    find_unexcited,
    informed_std,
    structural_base_parameters,
)
from dynident.runtime import ModelError
from tests.estimators.welded import Drag, single
from tests.regression.dense import triangularise

Array = NDArray[np.float64]
PANDA = Path(__file__).parents[3] / "shared" / "data" / "panda" / "panda.urdf"


def columns(*names: str, **roles: tuple[str, str]) -> list[Parameter]:
    """Parameters by name; ``roles`` gives role and body of some."""
    return [Parameter(name, "", "", None, *roles.get(name, ("", ""))) for name in names]


def read(X: Array, parameters: list[Parameter], **settings: float) -> BaseParameters:
    block = RegressorBlock(X[:, None], np.zeros((len(X), 1)))
    return base_parameters(triangularise(iter([block]), 1, X.shape[1]).stack(), parameters, **settings)


def noise(p: int, rows: int = 50, seed: int = 0) -> Array:
    return np.random.default_rng(seed).normal(size=(rows, p))


def test_groupings_read_as_in_the_literature() -> None:
    """Preference: friction, then inertia of the later body, then masses, then rotors."""
    roles = {
        "Izz1": ("Izz", "one"),
        "m2": ("mass", "two"),
        "Iyy2": ("Iyy", "two"),
        "Ia1": ("rotor", ""),
        "Fv1": ("viscous", ""),
    }
    X = noise(5)
    X[:, 1] = X[:, 0]  # Ia1 = Izz1
    X[:, 3] = 0.05185 * X[:, 0] - 2 * X[:, 2]
    result = read(X, columns("Izz1", "Ia1", "Iyy2", "m2", "Fv1", **roles))
    assert result.rank == 3
    assert result.groupings == ("Izz1 + Ia1 + 0.05185*m2", "Iyy2 - 2*m2", "Fv1")
    assert result.independent == (0, 2, 4)
    assert result.dependent == (1, 3)
    assert result.single_parameters == ("Fv1",)
    assert result.gap > 1e12
    assert result.without_effect == ()


def test_full_rank_and_no_rank() -> None:
    full, none = read(noise(3), columns("a", "b", "c")), read(np.zeros((9, 2)), columns("a", "b"))
    np.testing.assert_array_equal(full.combination, np.eye(3))
    assert full.single_parameters == ("a", "b", "c")
    assert full.gap == np.inf
    assert (none.rank, none.groupings, none.without_effect) == (0, (), ("a", "b"))
    np.testing.assert_array_equal(none.to_standard([], reference=[1.0, 2.0]), [1.0, 2.0])


@given(st.integers(0, 10**6), st.integers(1, 8), st.integers(0, 4))
@settings(max_examples=40, deadline=None, derandomize=True)
def test_base_parameters_carry_all_of_the_torque(seed: int, rank: int, extra: int) -> None:
    """X theta = X_b beta whatever theta; the maps are inverse to each other; null directions change nothing."""
    rng = np.random.default_rng(seed)
    p = rank + extra
    units = 10.0 ** rng.uniform(-4, 4, p)
    X = rng.normal(size=(40, rank)) @ rng.normal(size=(rank, p)) * units
    result = read(X, columns(*map(str, range(p))))
    theta, near = rng.normal(size=(2, p)) / units
    beta = result.to_base(theta)
    assert result.rank == rank
    size = np.linalg.norm(X, axis=0) @ np.abs(theta)
    np.testing.assert_allclose(X[:, list(result.independent)] @ beta, X @ theta, atol=1e-12 * size)
    for back in (result.to_standard(beta), result.to_standard(beta, near)):
        np.testing.assert_allclose(X @ back, X @ theta, atol=1e-12 * size)
    np.testing.assert_allclose(result.to_standard(beta, theta), theta, atol=1e-9 * np.abs(theta).max())
    assert np.abs(X @ result.null_directions).max(initial=0.0) <= 1e-8 * np.abs(X).max() * np.abs(
        result.null_directions
    ).max(initial=1.0)
    assert result.null_directions.shape == (p, extra)


def test_wrong_shapes() -> None:
    result = read(noise(2), columns("a", "b"))
    with pytest.raises(ModelError, match=r"factor has shape \(2, 2\), expected \(3, 3\) or \(4, 4\)"):
        base_parameters(np.eye(2), columns("a", "b", "c"))
    with pytest.raises(ModelError, match=r"theta has shape \(3,\), expected \(2,\)"):
        result.to_base([1, 2, 3])
    with pytest.raises(ModelError, match=r"beta has shape \(1,\)"):
        result.to_standard([1])
    result = read(noise(3), columns("a", "b", "c"))
    other = triangularise(iter([RegressorBlock(noise(2)[:, None], np.zeros((50, 1)))]), 1, 2)
    with pytest.raises(ModelError, match=r"factors have shape \(3, 3\), expected \(4, 4\)\."):
        base_std(result, other, np.ones(1))


@pytest.mark.skipif(not PANDA.exists(), reason="the Panda's robot file is not part of the project")
def test_published_rank_of_the_panda() -> None:
    """43 rigid-body base parameters and 21 of friction; rotors 1 and 2 turn with links that the joints turn alike."""
    bodies = RigidBodies(PANDA.read_text(), tuple(f"panda_joint{k}" for k in range(1, 8)))
    joints = bodies.joints
    rigid = structural_base_parameters(Model((bodies,)))
    full = structural_base_parameters(Model((bodies, Viscous(joints), Coulomb(joints), Offset(joints))))
    geared = structural_base_parameters(Model((bodies, RotorInertia(joints))))
    assert (rigid.rank, full.rank, geared.rank) == (43, 64, 48)
    assert min(basis.gap for basis in (rigid, full, geared)) > 1e6
    assert set(rigid.groupings) <= set(full.groupings)
    masses = "".join(f" + 0.0825*panda_link{k}.mass" for k in range(4, 8))
    assert f"panda_link3.mx{masses}" in rigid.groupings


def motion(model: Model, still: tuple[int, ...] = ()) -> Motion:
    """Random states, some joints at rest."""
    n = len(model.joints)
    q, dq, ddq = np.random.default_rng(0).normal(size=(3, 200, n))
    q[:, still], dq[:, still], ddq[:, still] = 0.1, 0.0, 0.0
    names = tuple(joint.name for joint in model.joints)
    return Motion(np.linspace(0, 1, 200), q, dq, ddq, np.zeros_like(q), names, np.ones(200, dtype=bool))


def on_data(model: Model, *motions: Motion) -> BaseParameters:
    return base_parameters(Regression(model, motions).triangular_factors.stack(), model.parameters)


def test_joints_that_help_only_together() -> None:
    """Two columns that differ only where both joints move: neither alone shows the difference."""
    joints = (Joint("a"), Joint("b"))
    model = Model((Drag(joints, "viscous"), Product(joints)))
    made = motion(model, still=(1,))
    (missing,) = find_unexcited(structural_base_parameters(model), on_data(model, made), model)
    assert missing.groupings == ("product",)
    assert missing.joints == ("a", "b")
    assert (missing.together, missing.still) == (True, ())


class Product(Drag):
    """A torque dq_a dq_b on the first joint."""

    def __init__(self, joints: tuple[Joint, ...]) -> None:
        super().__init__(joints, "viscous")

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter("product", ""),)

    def regressor(self, q: Array, dq: Array, ddq: Array) -> Array:
        out = np.zeros((*q.shape, 1))
        out[:, 0, 0] = dq[:, 0] * dq[:, 1]
        return out


def test_what_is_compared_must_belong_together() -> None:
    free, arm = single(), two_link_arm()
    with pytest.raises(ModelError, match="must have the same parameters"):
        find_unexcited(structural_base_parameters(free), structural_base_parameters(arm), free)


def test_standard_errors_of_base_parameters_are_those_of_least_squares_on_the_independent_columns():
    """Of two joints of unequal noise, with equal weights (X' X)^-1 X' S X (X' X)^-1, with the right ones less."""
    rng = np.random.default_rng(0)
    X = rng.standard_normal((400, 2, 3)) * [1.0, 10.0, 0.1]
    X = np.concatenate((X, 2 * X[..., :1] + X[..., 2:]), axis=2)
    noise = np.array([0.1, 1.0])
    triangular = triangularise(iter([RegressorBlock(X, noise * rng.standard_normal((400, 2)))]), 2, 4)
    basis = base_parameters(triangular.stack(), tuple(Parameter(name, "1") for name in "abcd"))
    told = base_std(basis, triangular, noise)
    kept = X[..., list(basis.independent)]
    inverse = np.linalg.inv(np.einsum("kja,kjb->ab", kept, kept))
    spread = np.einsum("kja,j,kjb->ab", kept, noise**2, kept)
    assert basis.rank == 3
    np.testing.assert_allclose(told, np.sqrt(np.diag(inverse @ spread @ inverse)), rtol=1e-9)
    weighted = base_std(basis, triangular, noise, 1 / noise)
    assert (weighted < told).all()
    information = np.einsum("kja,j,kjb->ab", X, 1 / noise**2, X)
    np.testing.assert_allclose(informed_std(basis, information), weighted, rtol=1e-8)
    assert np.isinf(informed_std(basis, np.zeros((4, 4)))).all()
