"""The structure of a regressor: which of its entries hold all others.

A body acts on the joints below it only, friction on its own joint; and of the ten columns of a body a joint's equation
has seven at most that are independent (Gautier and Khalil 1990). Only these are computed, filtered and factorised.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dynident.models.term import Joint, Term
from dynident.runtime import ModelError, Noun
from dynident.runtime.arrays import Array

if TYPE_CHECKING:
    from dynident.models.model import Model


Indices = NDArray[np.intp]
EXTRA_SAMPLES = 30  # random states beyond the number of columns that they are to tell apart
# of the largest effect of a parameter of this unit: what a column may differ by from others
DEPENDENCE_TOLERANCE = 1e-13


class Structure(Noun):
    """Row j of the regressor is Y_j = Y_j[:, columns[j]] maps[j] in every state.

    ``columns`` holds for each of the n joints indices (b_j) of parameters, ``maps`` a matrix (b_j, p).
    """

    columns: tuple[Indices, ...]
    maps: tuple[Array, ...]

    def append_columns(self, count: int) -> Structure:
        """Return the structure with ``count`` further columns after the others, about which nothing is known."""
        p = self.maps[0].shape[1]
        # further columns count as independent of all others at every joint
        maps = [np.zeros((len(block) + count, p + count)) for block in self.maps]
        for extended, block in zip(maps, self.maps, strict=True):
            extended[: len(block), :p], extended[len(block) :, p:] = block, np.eye(count)
        columns = (np.concatenate([block, np.arange(p, p + count)]) for block in self.columns)
        return Structure(tuple(columns), tuple(maps))

    @cached_property
    def joint(self) -> Indices:
        """The joint of each entry (M), in the order of the joints."""
        return np.repeat(np.arange(len(self.columns)), [len(columns) for columns in self.columns])

    @cached_property
    def parts(self) -> tuple[slice, ...]:
        """Where the entries of each joint are."""
        ends = np.cumsum([len(columns) for columns in self.columns]).tolist()
        return tuple(map(slice, [0, *ends[:-1]], ends))

    @cached_property
    def parameter(self) -> Indices:
        """The parameter of each entry (M)."""
        return np.concatenate(self.columns)


def common_structure(models: Sequence[Model]) -> Structure:
    """Return the structure that the regressors of all ``models`` have; these differ in gravity, say, and have the same
    terms.

    Columns count as dependent only within a term with its own ``entries``, at random states; all others are kept where
    they have support.
    """
    terms = [model.terms for model in models]
    support = np.logical_or.reduce([model.support for model in models])
    maps = [np.diag(row.astype(float)) for row in support]
    keep = support.copy()
    start = 0
    for same_terms in zip(*terms, strict=True):
        part = slice(start, start := start + len(same_terms[0].parameters))
        # only terms that compute single entries gain by fewer of them, and only where several columns act on a joint
        is_selective = all(term.has_own("entries") and term.has_own("support") for term in same_terms)
        if is_selective and (support[:, part].sum(axis=1) > 1).any():
            _reduce_columns(same_terms, support[:, part], keep[:, part], [array[part, part] for array in maps])
    columns = tuple(np.flatnonzero(array) for array in keep)
    return Structure(columns, tuple(array[selected] for array, selected in zip(maps, columns, strict=True)))


def _reduce_columns(
    terms: Sequence[Term], support: NDArray[np.bool_], keep: NDArray[np.bool_], maps: list[Array]
) -> None:
    """Remove from ``keep`` (n, p) the columns that others determine, and write into ``maps`` (p, p) how they do."""
    parameters = terms[0].parameters
    # enough states to tell the columns apart by each half of them, see ``select_independent``
    rng, samples = np.random.default_rng(2), 2 * int(support.sum(axis=1).max()) + EXTRA_SAMPLES
    states: tuple[Array, ...] = random_states(terms[0].joints, rng, samples)
    if terms[0].memory:
        states = (*states, rng.uniform(-1.0, 1.0, (samples, terms[0].memory)))
    joint, parameter = np.nonzero(support)
    entries = [_entries(term, states, joint, parameter) for term in terms]
    # scale by unit: a column that is small beside others of its unit is rounding, whatever the unit
    effect = np.sqrt(np.mean([np.square(array).mean(axis=1) for array in entries], axis=0))
    unit = np.array([column.unit for column in parameters])
    largest = {name: effect[unit[parameter] == name].max(initial=0.0) or 1.0 for name in set(unit.tolist())}
    scale = np.array([largest[name] for name in unit.tolist()])
    for j in range(len(support)):
        rows = np.flatnonzero(joint == j)
        X = np.concatenate([array[rows] for array in entries], axis=1).T / scale[parameter[rows]]
        basis, K = select_independent(X)
        columns = parameter[rows]
        keep[j, columns] = False
        keep[j, columns[basis]] = True
        maps[j][:] = 0.0
        maps[j][np.ix_(columns[basis], columns)] = K * scale[columns] / scale[columns[basis], None]


def _entries(term: Term, states: tuple[Array, ...], joint: Indices, parameter: Indices) -> Array:
    q, dq, ddq, *memory = states
    rows = np.asarray(term.entries(q, dq, ddq, joint, parameter, *memory))
    if rows.shape != (len(joint), len(states[0])) or not np.isfinite(rows).all():
        raise ModelError(f"{type(term).__name__}: its entries have shape {rows.shape}, or are not finite.")
    return rows


def select_independent(X: Array) -> tuple[Indices, Array]:
    """Return independent columns b of X (S, c), whose entries are about one, and K (b, c) with X = X[:, b] K.

    They are found in one half of the rows and must hold in the other; else all columns count as independent.
    """
    from scipy.linalg import qr, solve_triangular

    fit_rows, check_rows = X[::2], X[1::2]
    # pivoted QR orders the columns by what they add to those before; K follows from the triangular factor
    R, order = qr(fit_rows, mode="r", pivoting=True, check_finite=False)
    size = np.abs(np.diag(R)) / np.sqrt(len(fit_rows))
    rank = int((size > DEPENDENCE_TOLERANCE).sum())
    K = np.zeros((rank, X.shape[1]))
    K[:, order[:rank]] = np.eye(rank)
    K[:, order[rank:]] = solve_triangular(R[:rank, :rank], R[:rank, rank:], check_finite=False)
    # a dependence by chance does not hold in the other half of the rows
    if np.abs(check_rows - check_rows[:, order[:rank]] @ K).max(initial=0.0) > 100 * DEPENDENCE_TOLERANCE:
        return np.arange(X.shape[1]), np.eye(X.shape[1])
    sort = np.argsort(order[:rank])
    return order[:rank][sort], K[sort]


def random_states(joints: Sequence[Joint], rng: np.random.Generator, samples: int) -> tuple[Array, Array, Array]:
    """Draw random positions, velocities and accelerations, each (samples, n), as large as those of common arms."""
    reach = [np.pi if joint.kind == "revolute" else 1.0 for joint in joints]
    q, dq, ddq = rng.uniform(-1.0, 1.0, (3, samples, len(reach)))
    return q * reach, dq * reach, 3.0 * ddq * reach


def term_support(term: Term) -> NDArray[np.bool_]:
    """Return where the regressor of a term (n, p) can be other than zero: everywhere, unless the term says more."""
    shape = (len(term.joints), len(term.parameters))
    support = np.asarray(term.support)
    if support.shape != shape or support.dtype != bool:
        raise ModelError(
            f"{type(term).__name__}: support has shape {support.shape}, expected booleans of shape {shape}."
        )
    return support
