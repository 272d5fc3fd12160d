"""What the terms of a model remember of a motion, side by side in one array; and the load that some of them see."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.errors import ModelError
from dynident.models.checked import called, checked, kind_of
from dynident.models.term import HasMemory, Loads, NeedsLoad, Past, Term

if TYPE_CHECKING:
    from dynident.models.model import Model

__all__ = ["kinds_that_remember", "loading", "loads", "memory_of", "needs_load", "parts_of", "remembered", "unloaded"]

Array = NDArray[np.float64]


def parts_of(terms: Sequence[Term]) -> dict[int, slice]:
    """Return where the states of each term that remembers are in the memory of all, by the place of the term."""
    found, end = {}, 0
    for k, term in enumerate(terms):
        if isinstance(term, HasMemory):
            found[k], end = slice(end, end + term.memory), end + term.memory
    return found


def kinds_that_remember(terms: Sequence[Term]) -> tuple[str, ...]:
    """Return the kinds of the terms that remember."""
    return tuple(kind_of(term) for term in terms if isinstance(term, HasMemory))


def needs_load(term: Term) -> bool:
    """Return whether a term remembers the load."""
    return isinstance(term, NeedsLoad) and term.needs_load


def loads(terms: Sequence[Term]) -> tuple[Term, ...]:
    """Return the terms whose torque is the load."""
    return tuple(term for term in terms if isinstance(term, Loads) and term.loads)


def loading(terms: Sequence[Term]) -> NDArray[np.bool_]:
    """Return which parameters (p) are of these."""
    own = [any(term is one for one in loads(terms)) for term in terms]
    return np.repeat(np.array(own, dtype=bool), [len(term.parameters) for term in terms])


def unloaded(model: Model) -> Model:
    """Return the model without the terms that remember the load, which is to be found first; itself if it is known."""
    if model.load is not None or not model.needs_load:
        return model
    if not loading(model.terms).any():
        raise ModelError(f"{model.name}: no term is of bodies, so there is no load; leave out what depends on it.")
    return replace(model, terms=tuple(term for term in model.terms if not needs_load(term)))


def memory_of(model: Model, memory: ArrayLike | None, rows: int) -> tuple[Array, ...]:
    """Return the memory (rows, m) as floats where the model has one; ModelError where it is missing or misshapen."""
    if not model.memory:
        return ()
    kinds = ", ".join(kinds_that_remember(model.terms))
    if memory is None:
        raise ModelError(
            f"{model.name}: its torque depends on the motion before ({kinds}), and no memory of it is given; "
            "use a motion that `Model.remembering` returns, or the argument 'memory'."
        )
    array = np.asarray(memory, dtype=float)
    if array.shape != (rows, model.memory):
        raise ModelError(
            f"{model.name}: memory has shape {array.shape}, expected ({rows}, {model.memory}) of its terms {kinds}; "
            "use a motion that `Model.remembering` of this model returns."
        )
    return (array,)


def remembered(model: Model, t: Array, q: Array, dq: Array, ddq: Array, start: Array | None = None) -> Array:
    """Return the memory (N, m) of a motion at t (N), s; ``start`` (m) is that at the first sample, if not the first of
    a recording."""
    load, out = _load(model, (q, dq, ddq)), np.empty((len(t), model.memory))
    for k, part in model.remembered.items():
        past = Past(t, q, dq, ddq, load, None if start is None else start[part])
        found = called(model, model.terms[k], "remember", past)
        out[:, part] = checked(model, model.terms[k], "memory", found, out[:, part].shape, (q, dq, ddq))
    return out


def _load(model: Model, states: tuple[Array, Array, Array]) -> Array:
    """Return the torque of the bodies (N, n) with the parameters of the load, zero where there are none."""
    if model.load is None or not model.needs_load:
        return np.zeros_like(states[0])
    return model.bodies.torque(*states, model.load)
