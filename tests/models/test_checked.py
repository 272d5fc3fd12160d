"""What goes into a model and comes out of its terms is checked, and messages say what is wrong where."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from dynident.models import Joint, Model, Parameter, Partials, Term
from dynident.models.friction import Viscous
from dynident.models.lagrangian import two_link_arm
from dynident.runtime import ModelError

RNG = np.random.default_rng(3)
Q, DQ, DDQ = RNG.normal(size=(3, 7, 2))
JOINTS = (Joint("a"), Joint("b"))


@dataclass(frozen=True)
class Broken(Term):
    """A user's term that returns what it is told to."""

    answer: object
    joints: tuple = JOINTS
    parameters: tuple = field(default=(Parameter("k", "N m"),))

    def regressor(self, q, dq, ddq):
        return self.answer(q)

    def partials(self, q, dq, ddq, theta):
        return Partials(*[self.answer(q)] * 3)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda m: m.regressor(Q[:, :1], DQ, DDQ), r"q has shape \(7, 1\), expected \(7, 2\)"),
        (lambda m: m.regressor(Q, DQ[:3], DDQ), r"dq has shape \(3, 2\), expected \(7, 2\)"),
        (lambda m: m.torque(Q, DQ, DDQ[0], m.values), r"ddq has shape \(2,\), expected \(7, 2\): one row per sample"),
        (lambda m: m.regressor(0.0, DQ, DDQ), r"q has shape \(\), expected \(N, 2\)"),
        (lambda m: m.forward_dynamics(Q, DQ, Q.T, m.values), r"tau has shape \(2, 7\)"),
        (lambda m: m.torque(Q, DQ, DDQ, [1.0]), r"theta has shape \(1,\), expected \(7,\) or \(7, 7\): theta1, theta2"),
        (lambda m: m.mass_matrix(Q, np.ones((3, 7))), r"theta has shape \(3, 7\)"),
        (lambda m: m.partials(Q, DQ, DDQ, np.ones((7, 7))), r"expected \(7,\): theta1"),
    ],
)
def test_wrong_shapes(call, message):
    with pytest.raises(ModelError, match=message):
        call(two_link_arm())


def spoiled(q, value):
    Y = np.zeros((*q.shape, 1))
    Y[3, 1, 0] = value
    return Y


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (
            lambda q: spoiled(q, np.nan),
            r"term Broken returned nan at sample 3 in its regressor, joint 'b', where q = \[",
        ),
        (lambda q: spoiled(q, -np.inf), "term Broken returned -inf at sample 3"),
        (
            lambda q: np.zeros((len(q), 2)),
            r"regressor of term Broken has shape \(7, 2\).*expected floats of shape \(7, 2, 1\)",
        ),
        (lambda q: None, r"has shape \(\) and type object"),
        (lambda q: {}["mass"], "regressor of term Broken failed with KeyError: 'mass'"),
    ],
)
def test_a_term_that_misbehaves(answer, message):
    model = Model((Viscous(JOINTS), Broken(answer)))
    with pytest.raises(ModelError, match=message) as caught:
        model.regressor(Q, DQ, DDQ)
    assert "failed" not in message or isinstance(caught.value.__cause__, KeyError)


def test_errors_of_the_project_pass_unchanged():
    def refuse(q):
        raise ModelError("as it is")

    with pytest.raises(ModelError, match=r"^as it is$"):
        Model((Broken(refuse),)).regressor(Q, DQ, DDQ)
