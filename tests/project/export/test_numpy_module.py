"""The module of an identified model stands on its own, whatever its terms; or says why it cannot."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass

import numpy as np
import pytest
import sympy as sp

from dynident.models import Joint, Lagrangian, Model, Parameter, Term, Unknown
from dynident.models.friction import Dahl, LoadCoulomb, PerJoint, Viscous
from dynident.models.lagrangian import MODELS, pendulum
from dynident.project.export import IdentifiedModel, Numpy, Yaml, export, identified_module, random_states
from dynident.runtime import ModelError
from dynident.testing.term import is_the_same_in_numpy
from tests.project.export.arms import arm


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


def test_it_needs_only_numpy(tmp_path):
    (tmp_path / "model.py").write_text(identified_module(arm()).text)
    code = (
        "import sys, numpy as np; sys.path.insert(0, '.'); import model\n"
        "print(model.inverse_dynamics(np.zeros(3), np.zeros(3), np.zeros(3)).shape, 'dynident' in sys.modules)\n"
        "try: model.gravity([1.0, 2.0])\nexcept ValueError as error: print(error)"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["(3,) False", "expected arrays (3,) or (N, 3), alike, got (2,)"]


@dataclass(frozen=True)
class Cubic(PerJoint):
    symbol = "F3"
    law = "dq**3"
    words = "torque per dq^3"


@dataclass(frozen=True)
class Sway(Term):
    """A mass that hangs on the last joint: ddq cos(q)."""

    joints: tuple[Joint, ...]
    parameters = (Parameter("sway", "kg m^2", "torque per cos(q) ddq"),)

    def regressor(self, q, dq, ddq):
        out = np.zeros((*q.shape, 1))
        out[:, -1, 0] = np.cos(q[:, -1]) * ddq[:, -1]
        return out

    def partials(self, q, dq, ddq, theta):
        raise NotImplementedError

    def numpy_source(self, name, theta):
        mask = [0.0] * (len(self.joints) - 1) + [float(theta[0])]
        return f"def {name}(q, dq, ddq):\n    return np.array({mask}) * np.cos(q) * ddq\n"


def test_terms_of_the_user_give_their_formula():
    joints = (Joint("a"), Joint("b"), Joint("c"))
    model = Model((Viscous(joints), Cubic(joints, on=("c", "a")), Sway(joints)))
    rng = np.random.default_rng(0)
    identified_model = IdentifiedModel(model, rng.normal(size=6))
    states = random_states(3, rng, 50)
    assert export(identified_model, Numpy(), states).ready
    namespace = {}
    exec(identified_module(identified_model).text, namespace)
    expected = np.zeros((50, 3, 3))
    expected[:, 2, 2] = identified_model.value[-1] * np.cos(states[0][:, 2])
    np.testing.assert_allclose(namespace["mass_matrix"](states[0]), expected, atol=1e-12)
    np.testing.assert_allclose(namespace["mass_matrix"](states[0][0]), expected[0], atol=1e-12)


def test_a_wrong_formula_is_not_proven():
    class Wrong(Cubic):
        def formula(self):
            return "dq**2"

    term = Wrong((Joint("a"),))
    made = export(IdentifiedModel(Model((term,)), np.ones(1)), Numpy(), random_states(1, np.random.default_rng(0)))
    assert not made.ready
    with pytest.raises(AssertionError, match="Not equal"):
        is_the_same_in_numpy(term)


def test_a_term_of_unknown_formula_is_refused():
    class Mine(Viscous):
        def shapes(self, q, dq, ddq):
            return dq**3

    with pytest.raises(ModelError, match=r"model\.py cannot hold the term Mine"):
        identified_module(IdentifiedModel(Model((Mine((Joint("a"),)),)), np.ones(1)))


def test_a_function_that_numpy_lacks_is_refused():
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
