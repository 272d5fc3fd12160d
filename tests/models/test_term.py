"""A term has defaults for all that it does not say, and what is no term is named."""

import inspect
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from dynident.models import Joint, Model, Parameter, Partials, RigidBodies, Term
from dynident.models.lagrangian import two_link_arm
from dynident.runtime import ModelError
from dynident.runtime.families import TERMS
from dynident.testing import check_term
from dynident.testing.term import sample_states
from tests.robots import ARM

Array = NDArray[np.float64]
JOINTS = (Joint("a"), Joint("b"))
FOLLOWING = ("torque", "support", "entries", "mass_and_bias", "equations")


@dataclass(frozen=True)
class Plain(Term):
    """Inertia and drag of both joints together."""

    joints: tuple[Joint, ...]
    parameters: tuple[Parameter, ...] = (Parameter("J", "kg m^2", "inertia"), Parameter("D", "N m s/rad", "drag"))

    def regressor(self, q: Array, dq: Array, ddq: Array) -> Array:
        return np.stack([ddq, dq], axis=2)

    def partials(self, q: Array, dq: Array, ddq: Array, theta: Array) -> Partials:
        unit = np.broadcast_to(np.eye(2), (len(q), 2, 2))
        return Partials(0.0 * unit, theta[1] * unit, theta[0] * unit)


def test_a_term_of_a_regressor_alone_has_everything() -> None:
    term = Plain(JOINTS)
    check_term(term)
    (q, dq, ddq), theta = sample_states(2), np.array([2.0, 3.0])
    np.testing.assert_allclose(term.torque(q, dq, ddq, theta), 2 * ddq + 3 * dq)
    mass, bias = term.mass_and_bias(q, dq, theta)
    np.testing.assert_allclose(mass, np.broadcast_to(2 * np.eye(2), mass.shape), atol=1e-14)
    np.testing.assert_allclose(bias, 3 * dq)
    weights = np.random.default_rng(0).normal(size=(6, 2, 2))
    expected = Model((term,)).weighted_gradient(q, dq, ddq, weights)
    np.testing.assert_allclose(term.weighted_gradient(q, dq, ddq, weights), expected, atol=1e-14)
    np.testing.assert_array_equal(term.entries(q, dq, ddq, np.array([1]), np.array([0])), [ddq[:, 1]])
    assert term.support.all()
    assert not any(map(term.has_own, (*FOLLOWING, "weighted_gradient", "with_gravity", "discontinuous")))
    assert (term.memory, term.gravity, term.file, term.limits, term.notes, term.equations) == (
        0,
        None,
        None,
        {},
        (),
        (),
    )
    assert term.with_gravity((0.0, 0.0, 1.0)) is term.with_displacement("a", (0.0,) * 9) is term
    assert term.with_smooth_sign(np.ones(2)) == (term,)
    with pytest.raises(ModelError, match=r"cannot hold the term Plain.*`numpy_source`"):
        term.numpy_source("torque", theta)


def test_what_is_no_term_is_refused() -> None:
    class Alike:
        joints, parameters = JOINTS, Plain.parameters

        def regressor(self, q: Array, dq: Array, ddq: Array) -> Array:
            return np.stack([ddq, dq], axis=2)

    class Bare(Term):
        regressor = Alike.regressor  # type: ignore[assignment]

    for term in (Alike(), Bare(), None, 3.0):
        with pytest.raises(ModelError, match=rf"a {type(term).__name__} is no term; .*`dynident\.models\.Term`"):
            Model((term,))  # type: ignore[arg-type]
    with pytest.raises(ModelError, match=r"term Underived|has no derivatives"):
        Model((type("Underived", (Term,), {**vars(Alike)})(),)).partials(*sample_states(2), np.ones(2))
    assert RigidBodies(ARM).has_own("entries")
    assert two_link_arm().terms[0].has_own("mass_and_bias")


@pytest.mark.parametrize("wrong", ["one", ("one",), 3, None, [3.0]], ids=repr)
@pytest.mark.parametrize("kind", TERMS.table)
def test_joints_that_are_none_are_named_with_what_is_right(kind: str, wrong: object) -> None:
    settings = {
        name: {"coefficients": {"one": 1.0}, "law": "viscous", "name": "motor"}.get(name, 1.0)
        for name, field in inspect.signature(TERMS.get(kind)).parameters.items()
        if field.default is field.empty and name != "joints"
    }
    with pytest.raises(ModelError, match=r"joints has .*; give the joints of a model, `model\.joints`"):
        TERMS.get(kind)(joints=wrong, **settings)


@pytest.mark.parametrize("path", ["arm.urdf", "robots/arm.xml", Path("arm.urdf"), None], ids=repr)
def test_the_path_of_a_robot_file_is_no_text_of_one(path: object) -> None:
    with pytest.raises(ModelError, match=r"RigidBodies: xml is .*`dynident\.read_robot"):
        RigidBodies(path)  # type: ignore[arg-type]
