"""The terms of a model in words, and the meaning of their parameters as formulas."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from dynident.io.families import TERMS
from dynident.models import CoupledFriction, CoupledMotor, Equation, HasEquations, Lagrangian, declares
from dynident.report.mathml import formula, inline, symbol, with_symbol
from dynident.report.page import MEANING, PageTable

if TYPE_CHECKING:
    from markupsafe import Markup

    from dynident.models import Model, Term

__all__ = ["KINDS", "MASS", "equation_words", "term_words", "turning", "with_formulas"]

KINDS: Mapping[str, str] = {
    "rotor": "rotor inertia",
    "viscous": "viscous friction",
    "coulomb": "Coulomb friction",
    "wide_coulomb": "Coulomb friction of a wide sign",
    "asymmetric_coulomb": "half of what Coulomb friction differs by between the directions",
    "asymmetric_viscous": "half of what viscous friction differs by between the directions",
    "stribeck": "Stribeck friction",
    "power": "friction with a power of the speed",
    "ripple": "ripple over the position",
    "spring": "spring",
    "counterbalance": "counterbalance",
    "load_coulomb": "Coulomb friction by the load",
    "load_viscous": "viscous friction by the load",
    "dahl": "Dahl friction",
    "load_dahl": "Dahl friction by the load",
    "load_ripple": "ripple by the load",
    "drift": "drift",
    "offset": "constant torque",
}
MASS = "mass, with that of the rotor"  # of a joint that slides
MOTOR = {"I_a": KINDS["rotor"], "F_v": KINDS["viscous"], "F_c": KINDS["coulomb"], "tau_o": KINDS["offset"]}


def term_words(term: Term) -> str:
    """Return what a term is; one of the user by the name of its class."""
    kind = term.law if isinstance(term, CoupledFriction) else TERMS.kind_of(term)
    return KINDS.get(kind, type(term).__name__)


def equation_words(term: Term, one: Equation, unit: str) -> str:
    """Return what the parameters of an equation are; those of a motor are named as those of its joints are."""
    words = MOTOR[one.symbols[0]] if isinstance(term, CoupledMotor) else term_words(term)
    return MASS if words == KINDS["rotor"] and unit == "kg" else words


def with_formulas(table: PageTable, model: Model) -> PageTable:
    """Return a table whose last column tells what parameters mean, with the formulas of these."""
    if not table.columns or table.columns[-1] is not MEANING:
        return table
    meaning = dict(_meanings(model))
    return replace(table, rows=tuple((*row[:-1], meaning.get(row[0], row[-1])) for row in table.rows))


def _meanings(model: Model) -> Iterator[tuple[str, str]]:
    """Yield for each parameter its formula: of bodies in the unknowns, of others its part of the torque."""
    for term in model.terms:
        if isinstance(term, Lagrangian) or getattr(term, "expressions", None):
            yield from ((one.name, formula(one.expression)) for one in term.parameters)
        elif isinstance(term, HasEquations) and declares(term, "equations"):
            for one in term.equations:
                words = equation_words(term, one, "")
                for name, parameter in zip(one.symbols, one.parameters, strict=True):
                    yield parameter, _said(words, name, parameter, one)


def _said(words: str, name: str, parameter: str, one: Equation) -> Markup:
    from markupsafe import Markup

    known = {name: symbol(parameter if len(parameter) == 1 else name)} | turning(one)
    return Markup("{}: {}").format(words, inline(with_symbol(one.torque, name), known))


def turning(one: Equation) -> dict[str, str]:
    """Return what stands for the motion of a motor."""
    return {"q": symbol("phi"), "dq": symbol("dphi"), "ddq": symbol("ddphi")} if one.motor else {}
