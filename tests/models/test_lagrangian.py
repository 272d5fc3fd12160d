"""Lumping of symbolic energies into the article's parameters."""

import numpy as np
import pytest
import sympy as sp

from dynident.models import Joint, Lagrangian, Unknown
from dynident.models.lagrangian import two_link_arm
from dynident.runtime import ModelError

q1, q2, dq1, dq2 = sp.symbols("q1 q2 dq1 dq2")
m, m1, m2, l1, lc1, lc2, I1, I2, g, k, b = sp.symbols("m m1 m2 l1 lc1 lc2 I1 I2 g k b")
UNKNOWNS = (
    *(Unknown(s, "kg") for s in (m1, m2)),
    *(Unknown(s, "m") for s in (l1, lc1, lc2)),
    *(Unknown(s, "kg m^2") for s in (I1, I2)),
)
MASS = (Unknown(m, "kg"),)
JOINT = (Joint("a"),)
SLIDE = (Joint("a", "prismatic"),)


def rate(expression):
    return sp.diff(expression, q1) * dq1 + sp.diff(expression, q2) * dq2


def article_arm(**changes):
    """The energies as one writes them down: from the positions of the two mass points, not simplified."""
    first = (lc1 * sp.sin(q1), -lc1 * sp.cos(q1))
    second = (l1 * sp.sin(q1) + lc2 * sp.sin(q1 + q2), -l1 * sp.cos(q1) - lc2 * sp.cos(q1 + q2))
    kinetic = sum(mass * rate(x) ** 2 / 2 for mass, point in ((m1, first), (m2, second)) for x in point)
    fields = {
        "joints": (Joint("joint1"), Joint("joint2")),
        "q": (q1, q2),
        "dq": (dq1, dq2),
        "kinetic": kinetic + I1 * dq1**2 / 2 + I2 * (dq1 + dq2) ** 2 / 2,
        "potential": g * (m1 * first[1] + m2 * second[1]),
        "unknowns": UNKNOWNS,
        "constants": {g: 9.81},
    }
    return Lagrangian(**fields | changes)


def one_joint(kinetic, potential=0, unknowns=MASS, **changes):
    return Lagrangian(SLIDE, (q1,), (dq1,), kinetic, potential, unknowns, **changes)


@pytest.mark.parametrize("arm", [article_arm, two_link_arm.__wrapped__], ids=["as written", "gallery"])
def test_groups_of_the_article(arm):
    """Eq. (40), theta1 to theta5, in this order."""
    groups = arm().parameters[:5]
    result = [(p.name, sp.sympify(p.expression, locals={"I1": I1, "I2": I2}), p.unit) for p in groups]
    assert result == [
        ("theta1", m1 * lc1**2 + I1 + m2 * l1**2, "kg m^2"),
        ("theta2", m2 * lc2**2 + I2, "kg m^2"),
        ("theta3", m2 * l1 * lc2, "kg m^2"),
        ("theta4", m1 * lc1 + m2 * l1, "kg m"),
        ("theta5", m2 * lc2, "kg m"),
    ]


def test_value_is_computed_where_all_unknowns_have_one():
    unknowns = (Unknown(m, "kg", 3.0), Unknown(lc1, "m", 0.5), Unknown(k, "N m/rad"))
    arm = Lagrangian(JOINT, (q1,), (dq1,), m * lc1**2 * dq1**2 / 2, k * q1**2 / 2, unknowns)
    assert [(p.value, p.unit) for p in arm.parameters] == [(0.75, "kg m^2"), (None, "N m/rad")]


def test_names_are_taken_and_counted():
    names = ("a", "b", "c", "d", "e")
    assert tuple(p.name for p in article_arm(names=names).parameters) == names
    with pytest.raises(ModelError, match=r"2 names for 5 lumped parameters: I1 \+ l1\*\*2\*m2"):
        article_arm(names=("a", "b"))


def test_factors_of_a_lump_are_exact_fractions():
    """A rod about its end; the parameter of lowest degree leads, wherever it is declared."""
    unknowns = (Unknown(m, "kg"), Unknown(l1, "m"), Unknown(I1, "kg m^2"))
    arm = Lagrangian(JOINT, (q1,), (dq1,), m * l1**2 * dq1**2 / 6 + I1 * dq1**2 / 2, 0, unknowns)
    (parameter,) = arm.parameters
    assert (parameter.expression, parameter.unit) == ("I1 + l1**2*m/3", "kg m^2")
    np.testing.assert_array_equal(arm.regressor(*np.full((3, 2, 1), 2.0)), np.full((2, 1, 1), 2.0))


def test_almost_proportional_functions_stay_apart():
    """Gravity of two masses, one hanging 1e-9 rad off: a fit cannot separate them, an exact comparison must."""
    lean = m1 * sp.cos(q1) + m2 * sp.cos(q1 + sp.Rational(1, 10**9))
    arm = one_joint(I1 * dq1**2 / 2, lean, (Unknown(I1, "kg m^2"), Unknown(m1, "kg"), Unknown(m2, "kg")))
    assert [p.expression for p in arm.parameters] == ["I1", "m1", "m2"]


def test_trigonometric_identities_are_seen_through():
    """m (cos^2 + sin^2) is constant inertia, and one parameter with I1."""
    kinetic = (m * (sp.cos(q1) ** 2 + sp.sin(q1) ** 2) + I1) * dq1**2 / 2
    arm = one_joint(kinetic + b * q1 * dq1**2, 0, (Unknown(b, "kg/m"), Unknown(m, "kg"), Unknown(I1, "kg")))
    assert [p.expression for p in arm.parameters] == ["I1 + m", "b"]


@pytest.mark.parametrize(
    ("units", "product"),
    [
        (("N s/m", "m"), "N s"),
        (("1", "1/m"), "1/m"),
        (("kg m^2", "m^-2"), "kg"),
        (("kg/m^2", "s"), "kg s/m^2"),
    ],
)
def test_units_multiply(units, product):
    unknowns = tuple(map(Unknown, (m, b), units))
    assert one_joint(m * b * dq1**2, 0, unknowns).parameters[0].unit == product


@pytest.mark.parametrize("unit", ["kg.m2", "kg*m", "N/m/s", "", " kg", "m^x"])
def test_unreadable_unit(unit):
    with pytest.raises(ModelError, match="unknown m: cannot read the unit"):
        Unknown(m, unit)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"kinetic": m * dq1**2 + I1 * dq1**2}, r"kinetic energy holds undeclared I1; .*Declared: dq1, m, q1"),
        ({"kinetic": sp.Symbol("m", positive=True) * dq1**2}, "same SymPy assumptions"),
        ({"kinetic": m * dq1**2, "potential": m * g * q1}, "potential energy holds undeclared g"),
        ({"kinetic": m * dq1}, r"must be quadratic in dq \(eq. 3\), but holds dq1\*m"),
        ({"kinetic": m * dq1**2 + m * dq1**4}, r"holds dq1\*\*4\*m"),
        ({"kinetic": m * (dq1**2 + 1)}, "must be quadratic in dq"),
        ({"kinetic": m * sp.sqrt(1 + dq1**2)}, "kinetic energy is not polynomial in dq1"),
        ({"kinetic": sp.cos(m) * dq1**2}, "kinetic energy is not polynomial in m; declare another unknown"),
        ({"kinetic": m * dq1**2, "potential": q1 / m}, "potential energy is not polynomial in m"),
        ({"kinetic": m * dq1**2, "potential": m * dq1}, "potential energy depends on dq1"),
        ({"kinetic": m * dq1**2, "potential": q1**2}, "part of the energies holds no unknown"),
        ({"kinetic": 3 * dq1**2, "unknowns": ()}, "part of the energies holds no unknown"),
        ({"kinetic": m * dq1**2, "constants": {m: 1.0}}, "m is declared twice"),
        ({"kinetic": m * dq1**2, "names": ("a", "b")}, "2 names for 1 lumped parameters: m"),
    ],
)
def test_energies_that_make_no_model(arguments, message):
    with pytest.raises(ModelError, match=message):
        one_joint(**arguments)


@pytest.mark.parametrize("changes", [{"q": (q1,)}, {"dq": (dq1, dq2, m)}, {"joints": ()}])
def test_numbers_of_symbols_must_match(changes):
    with pytest.raises(ModelError, match="give one of each per joint"):
        article_arm(**changes)
