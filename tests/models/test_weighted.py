"""The derivatives of weighted sums of the regressor, which ``dynident.testing`` compares with the partials."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from dynident.models import Joint, Model, RigidBodies, RotorInertia
from dynident.models.friction import Dahl, Viscous
from dynident.runtime import ModelError
from dynident.testing.term import sample_states
from tests.robots import ARM

BODIES = RigidBodies(ARM)
JOINTS = BODIES.joints


def test_a_term_that_remembers_is_at_constant_memory():
    model = Model((Viscous(JOINTS), Dahl(JOINTS, length=0.1)))
    state, memory = sample_states(3), np.random.default_rng(2).uniform(-1, 1, (6, 3))
    weights = np.random.default_rng(3).normal(size=(6, 3, 6))
    slopes = [model.partials(*state, x, memory) for x in np.eye(6)]
    expected = sum(np.einsum("ij,ijk->ik", weights[..., c], x.dq) for c, x in enumerate(slopes))
    result = model.weighted_gradient(*state, weights, memory)
    np.testing.assert_allclose(result[1], expected, atol=1e-13)
    with pytest.raises(ModelError, match="memory"):
        model.weighted_gradient(*state, weights)


def test_weights_of_another_shape_are_an_error():
    model, state = Model((BODIES, RotorInertia(JOINTS))), sample_states(3)
    for shape in ((6, 3, 32), (5, 3, 33), (6, 33), (6, 3, 33, 1)):
        with pytest.raises(ModelError, match=r"weights have shape .*, expected \(6, 3, 33\)"):
            model.weighted_gradient(*state, np.ones(shape))
        with pytest.raises(ModelError, match="weights have the shape"):
            BODIES.weighted_gradient(*state, np.ones(shape))


@dataclass(frozen=True)
class Own(Viscous):
    """Viscous friction with a gradient of its own."""

    gives: float = 0.0

    def weighted_gradient(self, q, dq, ddq, weights):
        out = np.zeros((3, *q.shape))
        out[1, 2, 1] = self.gives
        return out[: 2 if self.gives == 2.0 else 3]


@dataclass(frozen=True)
class Doubled(Own):
    """A subclass with other derivatives."""

    def partials(self, q, dq, ddq, theta):
        return super().partials(q, dq, ddq, 2 * theta)


def test_other_derivatives_come_with_another_gradient():
    state, weights = sample_states(2), np.ones((6, 2, 2))
    result = Model((Doubled((Joint("a"), Joint("b"))),)).weighted_gradient(*state, weights)
    np.testing.assert_array_equal(result, [np.zeros((6, 2)), np.full((6, 2), 2.0), np.zeros((6, 2))])


def test_a_term_may_have_its_own():
    term = Own((Joint("a"), Joint("b")), gives=5.0)
    state, weights = sample_states(2), np.ones((6, 2, 2))
    result = Model((term,)).weighted_gradient(*state, weights)
    assert result.sum() == result[1, 2, 1] == 5.0
    with pytest.raises(ModelError, match=r"weighted gradient of term Own has shape \(2, 6, 2\)"):
        Model((replace(term, gives=2.0),)).weighted_gradient(*state, weights)
    with pytest.raises(ModelError, match="returned nan at sample 2 in its weighted gradient, joint 'b'"):
        Model((replace(term, gives=np.nan),)).weighted_gradient(*state, weights)
