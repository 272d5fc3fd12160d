"""The structure of a regressor: which of its entries hold all others.

A body acts on the joints below it only, friction on its own joint; and of the ten columns of a body a joint's equation
has seven at most that are independent (Gautier and Khalil 1990). Only these are computed, filtered and factorised.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ModelError, brief
from dynident.models.term import HasMemory, HasSupport, Joint, Parameter, Selective, Term, declares

if TYPE_CHECKING:
    from dynident.models.model import Model

__all__ = ["Structure", "independent", "is_selective", "random_states", "structure_of", "support_of"]

Array = NDArray[np.float64]
Indices = NDArray[np.intp]
SPARE = 30  # random states beyond the number of columns that they are to tell apart
DEPENDENT = 1e-13  # of the largest effect of a parameter of this unit: what a column may differ by from others


@dataclass(frozen=True, eq=False)
class Structure:
    """Row j of the regressor is Y_j = Y_j[:, columns[j]] maps[j] in every state.

    ``columns`` holds for each of the n joints indices (b_j) of parameters, ``maps`` a matrix (b_j, p).
    """

    columns: tuple[Indices, ...]
    maps: tuple[Array, ...]

    __repr__ = brief

    @classmethod
    def whole(cls, joints: int, parameters: int) -> Structure:
        """Return the structure of a regressor of which nothing is known."""
        return cls((np.arange(parameters),) * joints, (np.eye(parameters),) * joints)

    def beside(self, more: int) -> Structure:
        """Return the structure with ``more`` columns, after the others, of which nothing is known."""
        p = self.maps[0].shape[1]
        maps = [np.zeros((len(one) + more, p + more)) for one in self.maps]
        for wide, one in zip(maps, self.maps, strict=True):
            wide[: len(one), :p], wide[len(one) :, p:] = one, np.eye(more)
        columns = (np.concatenate([one, np.arange(p, p + more)]) for one in self.columns)
        return Structure(tuple(columns), tuple(maps))

    @cached_property
    def joint(self) -> Indices:
        """The joint of each entry (M), in the order of the joints."""
        return np.repeat(np.arange(len(self.columns)), [len(one) for one in self.columns])

    @cached_property
    def parts(self) -> tuple[slice, ...]:
        """Where the entries of each joint are."""
        ends = np.cumsum([len(one) for one in self.columns]).tolist()
        return tuple(map(slice, [0, *ends[:-1]], ends))

    @cached_property
    def parameter(self) -> Indices:
        """The parameter of each entry (M)."""
        return np.concatenate(self.columns)


def structure_of(models: Sequence[Model]) -> Structure:
    """Return the structure that the regressors of all ``models`` have; these differ in gravity, say, and have the same
    terms.

    Columns count as dependent only within a ``Selective`` term, at random states; all others are kept where they have
    support.
    """
    terms = [model.terms for model in models]
    support = np.logical_or.reduce([model.support for model in models])
    maps = [np.diag(row.astype(float)) for row in support]
    kept = support.copy()
    first = 0
    for alike in zip(*terms, strict=True):
        part = slice(first, first := first + len(alike[0].parameters))
        if all(map(is_selective, alike)) and (support[:, part].sum(axis=1) > 1).any():
            _reduce(alike, support[:, part], kept[:, part], [one[part, part] for one in maps])
    columns = tuple(np.flatnonzero(one) for one in kept)
    return Structure(columns, tuple(one[used] for one, used in zip(maps, columns, strict=True)))


def _reduce(terms: Sequence[Term], support: NDArray[np.bool_], kept: NDArray[np.bool_], maps: list[Array]) -> None:
    """Leave out of ``kept`` (n, p) the columns that others determine, and write into ``maps`` (p, p) how."""
    parameters = terms[0].parameters
    rng, samples = np.random.default_rng(2), 2 * int(support.sum(axis=1).max()) + SPARE
    states: tuple[Array, ...] = random_states(terms[0].joints, rng, samples)
    if isinstance(terms[0], HasMemory):
        states = (*states, rng.uniform(-1.0, 1.0, (samples, terms[0].memory)))
    joint, parameter = np.nonzero(support)
    found = [_entries(term, states, joint, parameter) for term in terms]
    scale = _scale(np.sqrt(np.mean([np.square(one).mean(axis=1) for one in found], axis=0)), parameter, parameters)
    for j in range(len(support)):
        own = np.flatnonzero(joint == j)
        X = np.concatenate([one[own] for one in found], axis=1).T / scale[parameter[own]]
        some, K = independent(X)
        which = parameter[own]
        kept[j, which] = False
        kept[j, which[some]] = True
        maps[j][:] = 0.0
        maps[j][np.ix_(which[some], which)] = K * scale[which] / scale[which[some], None]


def _entries(term: Term, states: tuple[Array, ...], joint: Indices, parameter: Indices) -> Array:
    q, dq, ddq, *memory = states
    rows = (
        np.asarray(term.entries(q, dq, ddq, joint, parameter, *memory)) if isinstance(term, Selective) else np.zeros(0)
    )
    if rows.shape != (len(joint), len(states[0])) or not np.isfinite(rows).all():
        raise ModelError(f"{type(term).__name__}: its entries have shape {rows.shape}, or are not finite.")
    return rows


def _scale(effect: Array, parameter: Indices, parameters: Sequence[Parameter]) -> Array:
    """Return the largest effect (p) on any joint of a parameter of the same unit; entries have ``effect`` (M)."""
    unit = np.array([one.unit for one in parameters])
    largest = {name: effect[unit[parameter] == name].max(initial=0.0) or 1.0 for name in set(unit.tolist())}
    return np.array([largest[name] for name in unit.tolist()])


def independent(X: Array) -> tuple[Indices, Array]:
    """Return independent columns b of X (S, c), whose entries are about one, and K (b, c) with X = X[:, b] K.

    They are found in one half of the rows and must hold in the other; else all columns count as independent.
    """
    from scipy.linalg import qr, solve_triangular

    seen, other = X[::2], X[1::2]
    R, order = qr(seen, mode="r", pivoting=True, check_finite=False)
    size = np.abs(np.diag(R)) / np.sqrt(len(seen))
    rank = int((size > DEPENDENT).sum())
    K = np.zeros((rank, X.shape[1]))
    K[:, order[:rank]] = np.eye(rank)
    K[:, order[rank:]] = solve_triangular(R[:rank, :rank], R[:rank, rank:], check_finite=False)
    if np.abs(other - other[:, order[:rank]] @ K).max(initial=0.0) > 100 * DEPENDENT:
        return np.arange(X.shape[1]), np.eye(X.shape[1])
    sort = np.argsort(order[:rank])
    return order[:rank][sort], K[sort]


def random_states(joints: Sequence[Joint], rng: np.random.Generator, samples: int) -> tuple[Array, Array, Array]:
    """Draw random positions, velocities and accelerations, each (samples, n), as large as those of common arms."""
    reach = [np.pi if joint.kind == "revolute" else 1.0 for joint in joints]
    q, dq, ddq = rng.uniform(-1.0, 1.0, (3, samples, len(reach)))
    return q * reach, dq * reach, 3.0 * ddq * reach


def support_of(term: Term) -> NDArray[np.bool_]:
    """Return where the regressor of a term (n, p) can be other than zero: everywhere, unless the term says more."""
    shape = (len(term.joints), len(term.parameters))
    if not (isinstance(term, HasSupport) and declares(term, "support")):
        return np.ones(shape, dtype=bool)
    found = np.asarray(term.support)
    if found.shape != shape or found.dtype != bool:
        raise ModelError(f"{type(term).__name__}: support has shape {found.shape}, expected booleans of shape {shape}.")
    return found


def is_selective(term: Term) -> bool:
    """Return whether a term computes chosen entries of the regressor that it has."""
    return isinstance(term, Selective) and declares(term, "entries") and declares(term, "support")
