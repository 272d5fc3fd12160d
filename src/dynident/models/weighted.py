"""Weighted sums of the regressor: of its columns, and of all entries with the derivatives by the motion.

The derivatives are one reverse pass for each term. A criterion of a motion's information M = sum_i Y_i' W Y_i changes
by such a sum: d log det M = 2 sum_i <G_i, dY_i> with G_i = W Y_i M^-1.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ModelError
from dynident.models.checked import called, checked
from dynident.models.structure import support_of
from dynident.models.term import HasWeightedGradient, Term, declares

if TYPE_CHECKING:
    from dynident.models.model import Model

__all__ = ["times", "weighted_gradient"]

Array = NDArray[np.float64]
Integers = NDArray[np.intp]


def times(Y: Array, theta: Array) -> Array:
    """Return Y theta for Y (N, n, p) and theta (p) or (N, p)."""
    return Y @ theta if theta.ndim == 1 else np.einsum("nij,nj->ni", Y, theta)


def weighted_gradient(model: Model, states: tuple[Array, ...], weights: Array) -> Array:
    """Return the derivatives (3, N, n) by q, dq and ddq of the sums <G_i, Y_i> for weights G (N, n, p)."""
    shape = (*states[0].shape, len(model.parameters))
    if weights.shape != shape:
        raise ModelError(f"{model.name}: the weights have shape {weights.shape}, expected {shape}: those of Y.")
    total, first = np.zeros((3, *states[0].shape)), 0
    for k, term in enumerate(model.terms):
        part = slice(first, first := first + len(term.parameters))
        own = (states[3][:, model.remembered[k]],) if k in model.remembered else ()
        if isinstance(term, HasWeightedGradient) and declares(term, "weighted_gradient", "partials"):
            found = called(model, term, "weighted_gradient", *states[:3], weights[..., part], *own)
            total += checked(model, term, "weighted gradient", found, total.shape, states)
        else:
            total += _from_partials(model, term, (*states[:3], *own), weights[..., part])
    return total


def _from_partials(model: Model, term: Term, states: tuple[Array, ...], weights: Array) -> Array:
    """Return the same from the derivatives of a term: those of parameters that share no joint come together."""
    q, dq, ddq, *memory = states
    total = np.zeros((3, *q.shape))
    for joints, columns in _apart(support_of(term)):
        theta = np.zeros(len(term.parameters))
        theta[columns] = 1.0
        slopes = called(model, term, "partials", q, dq, ddq, theta, *memory)
        own = weights[:, joints, columns]
        for found, wrt in zip(total, ("q", "dq", "ddq"), strict=True):
            slope = getattr(slopes, wrt, None)
            slope = checked(model, term, f"derivative by {wrt}", slope, (*q.shape, q.shape[1]), states)
            found += np.einsum("ij,ijk->ik", own, slope[:, joints])
    return total


def _apart(support: NDArray[np.bool_]) -> Iterator[tuple[Integers, Integers]]:
    """Yield sets of the entries where a regressor can be other than zero: joints and columns, each joint once a set."""
    left = list(range(support.shape[1]))
    while left:
        taken, together = np.zeros(len(support), dtype=bool), list[int]()
        for column in left:
            if not (taken & support[:, column]).any():
                taken |= support[:, column]
                together.append(column)
        left = [column for column in left if column not in together]
        joints, which = np.nonzero(support[:, together])
        yield joints, np.array(together)[which]
