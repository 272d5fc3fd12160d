"""The meaning of parameters as formulas."""

from dynident.models import Model
from dynident.models.gallery import slider, two_link_arm
from dynident.report.page import MEANING, Column, PageTable
from dynident.report.term_words import term_words, with_formulas


def meanings(model):
    rows = tuple((one.name, one.expression) for one in model.parameters)
    table = PageTable((Column("parameter", numeric=False), MEANING), rows)
    return {name: str(meaning) for name, meaning in with_formulas(table, model).rows}


def test_meanings_are_formulas():
    arm = meanings(two_link_arm())
    assert arm["theta3"].startswith("<math>")
    assert "<mi>μ</mi>" in arm["theta6"]
    assert meanings(slider())["Fc"].startswith("Coulomb friction: <math>")


def test_a_table_without_meanings_stays_as_it_is():
    table = PageTable((Column("parameter", numeric=False), Column("value")), (("a", "1"),))
    assert with_formulas(table, Model(slider().terms)) is table


def test_terms_in_words():
    assert [term_words(term) for term in slider().terms] == [
        "rotor inertia", "viscous friction", "Coulomb friction", "constant torque",
    ]  # fmt: skip
