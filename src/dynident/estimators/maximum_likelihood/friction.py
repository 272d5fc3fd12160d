"""Coulomb friction with a smooth sign, because Newton's method needs a derivative."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeGuard

import numpy as np
from numpy.typing import NDArray

from dynident.models import HasSign, Model, Term

__all__ = ["has_sign", "with_smooth_signs"]

Array = NDArray[np.float64]


def has_sign(model: Model) -> bool:
    """Return whether a term of the model takes the sign of a velocity."""
    return any(map(_sharp, model.terms))


def with_smooth_signs(model: Model, width: Array) -> Model:
    """Return the model with each sign(dq) replaced by tanh(dq / width), ``width`` (n) in rad/s or m/s by joint.

    The parameters and their order do not change. Terms that have a width or a dead band are not changed.
    """
    terms: list[Term] = []
    for term in model.terms:
        terms += term.with_smooth_sign(width) if _sharp(term) else (term,)
    return replace(model, terms=tuple(terms))


def _sharp(term: object) -> TypeGuard[HasSign]:
    return isinstance(term, HasSign) and term.discontinuous
