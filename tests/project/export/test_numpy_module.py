"""The module of an identified model stands on its own, whatever its terms; or says why it cannot."""

from dataclasses import dataclass

import numpy as np
import pytest
import sympy as sp

from dynident.models import Joint, Lagrangian, Model, Unknown
from dynident.models.friction import Dahl, LoadCoulomb, PerJoint, Viscous
from dynident.models.lagrangian import MODELS, pendulum
from dynident.project.export import IdentifiedModel, Numpy, Yaml, export, identified_module, random_states
from dynident.runtime import ModelError
from dynident.testing.term import is_the_same_in_numpy


@pytest.mark.parametrize("name", MODELS)
def test_symbolic_models_are_printed(name):
    model, rng = MODELS[name](), np.random.default_rng(0)
    identified_model = IdentifiedModel(model, rng.normal(size=len(model.parameters)))
    states = random_states(len(model.joints), rng, 50)
    made = export(identified_model, Numpy(), states)
    assert made.ready, made.refusal
    assert made.proof.agreement < 1e-12
    namespace = {}
    exec(made.written.text, namespace)
    mass = namespace["mass_matrix"](states[0])
    np.testing.assert_allclose(mass, model.mass_matrix(states[0], identified_model.value), rtol=1e-10, atol=1e-10)


@dataclass(frozen=True)
class Cubic(PerJoint):
    symbol = "F3"
    law = "dq**3"
    words = "torque per dq^3"


def test_a_wrong_formula_is_not_proven():
    class Wrong(Cubic):
        def formula(self):
            return "dq**2"

    term = Wrong((Joint("a"),))
    made = export(IdentifiedModel(Model((term,)), np.ones(1)), Numpy(), random_states(1, np.random.default_rng(0)))
    assert not made.ready
    with pytest.raises(AssertionError, match="Not equal"):
        is_the_same_in_numpy(term)


def test_a_term_of_unknown_formula_or_function_is_refused():
    class Mine(Viscous):
        def shapes(self, q, dq, ddq):
            return dq**3

    with pytest.raises(ModelError, match=r"model\.py cannot hold the term Mine"):
        identified_module(IdentifiedModel(Model((Mine((Joint("a"),)),)), np.ones(1)))
    q, dq, m = sp.symbols("q dq m")
    term = Lagrangian((Joint("a"),), (q,), (dq,), m * dq**2 / 2, m * sp.besselj(0, q), (Unknown(m, "kg"),))
    with pytest.raises(ModelError, match="NumPy has no function"):
        identified_module(IdentifiedModel(Model((term,)), np.ones(1)))


def test_terms_that_remember_more_than_the_load_are_left_out():
    arm = pendulum()
    terms = Dahl(arm.joints, length=0.01), Viscous(arm.joints), LoadCoulomb(arm.joints, width=0.1)
    value, states = np.array([0.1, 0.2, 0.3, 0.4, 0.5]), random_states(1, np.random.default_rng(0))
    model = arm.with_terms(*terms).with_load(value)
    made = export(IdentifiedModel(model, value), Numpy(), states)
    assert made.ready
    assert made.written.left_out == ("Fd_pivot = 0.3 N m (Dahl friction over 0.01 rad)",)
    assert export(IdentifiedModel(model, value), Yaml(), states).ready
    namespace = {"__name__": "model"}
    exec(made.written.text, namespace)
    load = arm.torque(*states, value[:2])
    expected = load + 0.4 * states[1] + 0.5 * np.abs(load) * np.tanh(states[1] / 0.1)
    np.testing.assert_allclose(namespace["inverse_dynamics"](*states), expected, rtol=1e-9)
    np.testing.assert_allclose(namespace["mass_matrix"](states[0])[:, 0, 0], 0.1)
