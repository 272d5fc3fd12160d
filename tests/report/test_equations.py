"""The section on the model: laws in symbols and with values, for any terms, with names escaped."""

import re
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from dynident.models import CoupledFriction, CoupledMotor, Joint, Model, RigidBodies, RotorInertia
from dynident.models.friction import Coulomb, Stribeck, Viscous
from dynident.models.lagrangian import pendulum, slider, two_link_arm
from dynident.report.equations import SUMMAND_ORDER, model_section, parameter_meanings, term_words
from dynident.report.page import MEANING, PageSection, PageTable, render
from dynident.runtime.families import TERMS
from tests.robots import ARM

JOINTS = Joint("base"), Joint("rail", "prismatic")
EVIL = '<img src=x onerror="alert(1)">'


def found(model, values=None, std=None, provenance=()):
    count = len(model.names)
    values = np.arange(1.0, count + 1) if values is None else np.array(values)
    errors = SimpleNamespace(std=np.full(count, 0.1) if std is None else np.array(std))
    estimate = SimpleNamespace(names=model.names, value=values, provenance=provenance)
    return SimpleNamespace(model=model, estimate=estimate, errors=errors)


def seen(identification):
    """The text of the section as a reader sees it."""
    page = render("Title", "Lead", list(model_section(identification)))
    plain = re.sub("<[^>]*>", " ", page[page.index("<main>") : page.index("</main>")].replace("\u2062", ""))
    return re.sub(r"\s+", " ", plain.replace("\u2061", ""))


def test_a_law_that_all_joints_have_stands_once():
    model = Model((Viscous(JOINTS), Coulomb(JOINTS, width=0.02)))
    text = seen(found(model, [0.5, -2.0, 3.0, 1e-7]))
    assert "each joint τ = F v q ˙ + F c tanh ( q ˙ / w c )" in text
    assert "F v viscous friction (N m s/rad); " in text.replace(", N s/m)", ")")
    assert "w c = 0.02" in text
    assert "base τ = 0.500 q ˙ + 3.00 tanh ( q ˙ / 0.02 ) N m" in text
    assert "rail τ = − 2.00 q ˙ + 1.00 × 10 − 7 tanh ( q ˙ / 0.02 ) N" in text
    assert "the sign, 0 up to" not in text
    assert "the sign, 0 up to d c" in seen(found(Model((Coulomb(JOINTS, dead_band=0.02),))))


def test_bodies_motors_and_terms_of_the_user():
    @dataclass(frozen=True)
    class Damped(Viscous):
        def shapes(self, q, dq, ddq):
            return 2 * dq

    bodies = RigidBodies(ARM)
    names = [joint.name for joint in bodies.joints]
    motor = CoupledMotor(bodies.joints, {names[0]: 1.0, names[1]: -6.0}, "m2")
    more = CoupledFriction(bodies.joints, {names[0]: 1.0, names[1]: -6.0}, "m2", "power", {"exponent": 0.5})
    text = seen(found(Model((bodies, Damped(bodies.joints), motor, more))))
    assert "τ = M ( q ) q ¨ + C ( q , q ˙ ) q ˙ + g ( q ) + τ f" in text
    assert f"φ = q {names[0]} − 6 q {names[1]}" in text
    assert "τ m2 = I a φ ¨ + F v φ ˙ + F c sgn ( φ ˙ ) + F p | φ ˙ | p sgn ( φ ˙ )" in text
    assert "+ τ Damped" in text.replace("= τ Damped", "+ τ Damped")
    assert "− 6 τ m2" in text
    assert "friction with a power of the speed" in text


def test_energies_are_written_out_where_they_are_short():
    text = seen(found(two_link_arm()))
    assert "joint2 τ b = θ 2 ( q ¨ 1 + q ¨ 2 ) + θ 3 (" in text
    assert "sin 2 ( q" not in text
    assert "pivot τ = J q ¨ + h 9.81 sin ( q )" in seen(found(pendulum()))


def test_what_is_zero_is_left_out_of_the_numbers():
    text = seen(found(Model((Coulomb(JOINTS), Viscous(JOINTS), RotorInertia(JOINTS))), [0.0, 0.0, 2.0, 0.0, 1.5, 0.0]))
    assert "base τ = 1.50 q ¨ + 2.00 q ˙ N m" in text
    assert "rail τ = 0 N" in text


def test_names_of_joints_are_escaped():
    joints = Joint(EVIL), Joint("b")
    model = Model((RotorInertia(joints), CoupledMotor(joints, {EVIL: 1.0, "b": 2.0}, EVIL + "m")))
    page = render("Title", "Lead", list(model_section(found(model))))
    assert "<img" not in page
    assert "&lt;img" in page


def test_constants_that_differ_by_joint_are_said_to():
    term = Stribeck(JOINTS, velocity={"base": 0.05, "rail": 0.2})
    text = seen(found(Model((term,))))
    assert "v s differs by joint" in text
    assert "e − ( q ˙ / 0.05 ) 2" in text


SETTINGS = {
    "wide_coulomb": {"width": 0.1}, "asymmetric_coulomb": {"width": 0.1}, "stribeck": {"velocity": 0.1},
    "power": {"exponent": 0.5}, "ripple": {"cycles": 7}, "load_ripple": {"cycles": 7},
    "counterbalance": {"base_arm": 0.5, "link_arm": 0.2, "angle": 3.1, "free_length": 0.4},
    "coupled_friction": {"coefficients": {"one": 1.0}, "name": "m", "law": "coulomb"},
}  # fmt: skip


@pytest.mark.parametrize("kind", TERMS.table)
def test_every_kind_of_term_has_an_equation_and_words(kind):
    term = TERMS.get(kind)(joints=(Joint("one"),), **SETTINGS.get(kind, {}))
    assert {name for equation in term.equations for name in equation.parameters} == {
        parameter.name for parameter in term.parameters
    }
    assert term_words(term) in seen(found(Model((term,))))
    assert term_words(term) in SUMMAND_ORDER


def test_meanings_of_parameters_are_formulas():
    arm = dict(parameter_meanings(two_link_arm()))
    assert arm["theta3"].startswith('<math alttext="l1*lc2*m2">')
    assert "<mi>μ</mi>" in arm["theta6"]
    coulomb = [*parameter_meanings(slider())][2][1]
    assert str(coulomb).startswith('Coulomb friction: <math alttext="F_c * sign(dq)">')
    ((_, viscous),) = parameter_meanings(Model((Viscous(JOINTS, on=("base",), names=("b",)),)))
    assert "<mi>b</mi>" in viscous
    table = PageTable.of(("parameter",), (MEANING,), arm.items())
    assert render("Title", "Lead", [PageSection("One", (table,))]).count("<math alttext=") == 7
