"""Dry friction with a smooth sign, as wide as the velocity is known: a jump has no derivative to search by."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dynident.model import Model
from dynident.terms import Coulomb, Coupling
from dynident.terms.term import Term

__all__ = ["has_sign", "softened"]

Array = NDArray[np.float64]


def has_sign(model: Model) -> bool:
    """Return whether a term of the model takes the sign of a velocity."""
    return any(_sharp(term) for term in model.terms)


def softened(model: Model, width: Array) -> Model:
    """Return the model with each sign(dq) replaced by tanh(dq / width), ``width`` (n) in rad/s or m/s by joint.

    The parameters stay the same, in the same order. Terms with a width or a dead band of their own are left as they
    are.
    """
    terms: list[Term] = []
    for term in model.terms:
        if isinstance(term, Coulomb) and _sharp(term):
            terms += _by_joint(term, width)
        elif isinstance(term, Coupling) and _sharp(term):
            factors = np.array([dict(term.coefficients).get(joint.name, 0.0) for joint in term.joints])
            terms.append(replace(term, width=float(np.linalg.norm(factors * width))))
        else:
            terms.append(term)
    return replace(model, terms=tuple(terms))


def _sharp(term: object) -> bool:
    sign = isinstance(term, Coulomb) or (isinstance(term, Coupling) and term.coulomb)
    return sign and not (term.width or term.dead_band)  # type: ignore[attr-defined]


def _by_joint(term: Coulomb, width: Array) -> list[Coulomb]:
    """Return a Coulomb friction as one for each joint, because each has its own width."""
    known = [joint.name for joint in term.joints]
    out = []
    for k, (name, parameter) in enumerate(zip(term.on or known, term.parameters, strict=True)):
        value = None if term.values is None else (term.values[k],)
        one = replace(term, on=(name,), names=(parameter.name,), expressions=None, values=value)
        out.append(replace(one, width=float(width[known.index(name)])))
    return out
