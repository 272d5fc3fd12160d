"""Expressions as MathML: what they hold, what is escaped, and that the result is well-formed."""

import re
from xml.etree import ElementTree

import pytest

from dynident.models import FUNCTIONS
from dynident.report.mathml import formula, inline, named_symbol, number_markup, symbol
from tests.kept import check_kept

EVIL = '<script>alert("1")</script>&'


def text(markup):
    """The signs that a reader sees."""
    return re.sub("[\u2061\u2062\\s]", "", "".join(ElementTree.fromstring(str(markup)).itertext()))


EXPRESSIONS = (
    "F_c * sign(dq)", "F_s * exp(-(dq / v_s)**2) * tanh(dq / w)", "f_c * abs(load) * sign(dq, d_c)",
    "a - (b - c) - -d", "-a * b + -2 * c", "a * (b + c)", "a * -b", "(dq - abs(dq) * z) / s_d", "tanh(x)**2",
    "(x + 1)**0.5", "2 * 3 * theta1", "1.5e-7 * ddq_2", "sqrt(a**2 + b**2)", "C(q, dq) * dq", "_ddq1",
    "lc1**2 * m2 + Ixx", "rho_a * psi",
)  # fmt: skip


def test_an_expression_is_typeset():
    check_kept("expressions", "\n".join(f"{x}: {text(inline(x))}" for x in EXPRESSIONS))
    for name in FUNCTIONS:  # of equations, all are known
        assert text(inline(f"{name}(q)"))


@pytest.mark.parametrize(
    "bad", ["viscous friction: torque", "__import__('os').system('x')", "[a]", "f'{a}'", "a if b else c", ""]
)
def test_what_is_no_formula_is_refused_or_stays_text(bad):
    with pytest.raises((SyntaxError, ValueError)):
        inline(bad)
    assert formula(bad) == bad
    assert not hasattr(formula(bad), "__html__")


def test_too_deep_an_expression_stays_text():
    assert formula("-" * 5000 + "a") == "-" * 5000 + "a"


def test_numbers_have_powers_of_ten_and_no_sign():
    assert text(number_markup(1.2345e-6)) == "1.23×10−6"
    assert text(number_markup(-2.5e8)) == "2.50×108"
    assert text(number_markup(12.0)) == "12.0"


def test_names_of_the_user_are_escaped():
    assert "<script" not in named_symbol("q", EVIL)
    assert text(named_symbol("q", EVIL)) == "q" + EVIL.replace(" ", "")
    for name in (EVIL, f"F_{EVIL}", f"dq{EVIL}"):
        assert "<script" not in symbol(name)
        ElementTree.fromstring(symbol(name))
