"""The sum of terms: inverse and forward dynamics, and its messages."""

import numpy as np
import pytest

from dynident.models import Joint, Model, RigidBodies, RotorInertia
from dynident.models.friction import Offset, Viscous
from dynident.models.lagrangian import slider, two_link_arm
from dynident.runtime import ModelError
from tests.robots import ARM

RNG = np.random.default_rng(3)
Q, DQ = RNG.normal(size=(2, 7, 2))
JOINTS = (Joint("a"), Joint("b"))


def test_mass_matrix_and_bias_of_the_article():
    """Eq. (39), with the friction in the bias."""
    arm = two_link_arm()
    theta = arm.values
    a, b, c = theta[:3]
    c2, s2 = np.cos(Q[:, 1]), np.sin(Q[:, 1])
    D = np.array([[a + b + 2 * c * c2, b + c * c2], [b + c * c2, np.full(7, b)]]).transpose(2, 0, 1)
    np.testing.assert_allclose(arm.mass_matrix(Q, theta), D, rtol=1e-13)
    C = np.array([[-2 * c * s2 * DQ[:, 1] + theta[5], -c * s2 * DQ[:, 1]], [c * s2 * DQ[:, 0], np.full(7, theta[6])]])
    g12 = 9.81 * theta[4] * np.sin(Q.sum(axis=1))
    G = np.stack([9.81 * theta[3] * np.sin(Q[:, 0]) + g12, g12], axis=1)
    bias = np.einsum("ijn,nj->ni", C, DQ) + G
    np.testing.assert_allclose(arm.bias(Q, DQ, theta), bias, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("theta", [(0.0, 8.0, 3.0, 0.5), (1e-320, 8.0, 3.0, 0.5)])
def test_forward_of_a_massless_model(theta):
    with pytest.raises(ModelError, match=r"slider: the mass matrix is singular at q = \[0.1\] for theta = \["):
        slider().forward_dynamics([[0.1]], [[0.0]], [[1.0]], theta)


def test_forward_finds_the_singular_sample_among_thetas():
    """D = [[1, 1], [1, 1]] up to rounding, at one sample of three."""
    arm = two_link_arm()
    bad = np.array([1e-17, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    with pytest.raises(ModelError, match=r"singular at q = \[0.3, 0.4\] for theta = \[1e-17, 1.0"):
        arm.forward_dynamics(
            [[0.1, 0.2], [0.3, 0.4], [0.5, 0.6]], np.ones((3, 2)), [[1.0, -1.0]] * 3, [arm.values, bad, arm.values]
        )


def test_a_mass_matrix_of_the_wrong_shape_is_named(monkeypatch):
    bodies = RigidBodies(ARM)
    monkeypatch.setattr(RigidBodies, "mass_and_bias", lambda self, q, dq, theta: (np.zeros((1, 2, 2)), q))
    with pytest.raises(ModelError, match="the mass matrix of term RigidBodies has shape"):
        Model((bodies,)).mass_and_bias(np.zeros((1, 3)), np.zeros((1, 3)), np.ones(30))


def test_mass_matrix_check():
    arm = two_link_arm()
    q = np.stack([np.zeros(5), np.linspace(0.0, np.pi, 5)], axis=1)
    good = arm.check_mass_matrix(q, arm.values)
    assert good.positive
    assert good.smallest == pytest.approx(np.linalg.eigvalsh(arm.mass_matrix(q, arm.values)).min(), rel=1e-12)
    wrong = arm.values.copy()
    wrong[2] = 0.02  # too large a coupling: negative where it is strongest, at q2 = pi
    bad = arm.check_mass_matrix(q, wrong)
    assert (bad.positive, bad.q.tolist()) == (False, [0.0, np.pi])
    assert bad.smallest < 0
    with pytest.raises(ModelError, match="0 configurations"):
        arm.check_mass_matrix(np.zeros((0, 2)), arm.values)


@pytest.mark.parametrize(
    ("terms", "message"),
    [
        ((), "needs at least one term"),
        ((Viscous(JOINTS), Viscous(JOINTS)), "two parameters are called 'Fv_a'; rename one with the field 'names'"),
        ((Viscous(JOINTS), Offset(JOINTS[::-1])), r"term Offset has joints b \(revolute\), a .*but Viscous"),
        ((Viscous(JOINTS), Offset((Joint("a"), Joint("b", "prismatic")))), r"b \(prismatic\)"),
    ],
)
def test_terms_that_do_not_fit(terms, message):
    with pytest.raises(ModelError, match=message):
        Model(terms)


def test_further_terms_join_a_model():
    """The model keeps its name and parameters; a term that does not fit is refused as in a new model."""
    model = two_link_arm()
    rich = model.with_terms(RotorInertia(model.joints), Offset(model.joints))
    assert (rich.name, rich.terms[:-2]) == (model.name, model.terms)
    assert rich.names == (
        *model.names,
        *(f"{kind}_{joint.name}" for kind in ("Ia", "offset") for joint in model.joints),
    )
    assert len(model.with_terms().terms) == len(model.terms)
    with pytest.raises(ModelError, match="give all terms the same joints"):
        model.with_terms(Offset((Joint("other"),)))
