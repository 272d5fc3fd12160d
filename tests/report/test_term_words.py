"""The meaning of parameters as formulas."""

from dynident.models import Model
from dynident.models.lagrangian import slider, two_link_arm
from dynident.report.equations import term_words, with_formulas
from dynident.report.page import MEANING, Column, PageSection, PageTable, render


def meanings(model):
    rows = tuple((one.name, one.expression) for one in model.parameters)
    table = PageTable((Column("parameter", numeric=False), MEANING), rows)
    return {name: str(meaning) for name, meaning in with_formulas(table, model).rows}


def test_meanings_are_formulas():
    arm = meanings(two_link_arm())
    assert arm["theta3"].startswith('<math alttext="l1*lc2*m2">')
    assert "<mi>μ</mi>" in arm["theta6"]
    assert meanings(slider())["Fc"].startswith('Coulomb friction: <math alttext="F_c * sign(dq)">')


def test_a_table_without_meanings_stays_as_it_is():
    table = PageTable((Column("parameter", numeric=False), Column("value")), (("a", "1"),))
    assert with_formulas(table, Model(slider().terms)) is table


def test_terms_in_words():
    assert [term_words(term) for term in slider().terms] == [
        "rotor inertia", "viscous friction", "Coulomb friction", "constant torque",
    ]  # fmt: skip


def test_a_page_shows_the_formulas_of_a_table():
    rows = tuple((one.name, one.expression) for one in two_link_arm().parameters)
    table = PageTable((Column("parameter", numeric=False), MEANING), rows)
    page = render("Title", "Lead", [PageSection("One", (with_formulas(table, two_link_arm()),))])
    assert page.count("<math alttext=") == 7
    plain = PageTable(
        (Column("parameter", numeric=False), Column("meaning", numeric=False)),
        with_formulas(table, two_link_arm()).rows,
    )
    assert render("Title", "Lead", [PageSection("One", (plain,))]).count("<math alttext=") == 7
