"""Trials of columns beside those of a fit, from Gram matrices alone: each is fitted to some rows and judged on others.

All candidates of a joint share one factorisation in each fold; what a candidate changes of the fit follows from a Schur
complement (Golub and Van Loan 2013, "Matrix computations", section 3.2.6).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief

__all__ = ["Fits", "Folds", "JointGrams", "eliminated", "ridged", "tried", "weighed"]

Array = NDArray[np.float64]
SMALL = 1e-9  # ridge, of a column's own square: dependent columns stay solvable
DEPENDENT = 1e-6  # share of a column's square that others must leave of it


@dataclass(frozen=True, eq=False)
class Folds:
    """T ways to divide the rows of a joint: ``train`` and ``test`` (T, F, C) weigh blocks and classes of its samples.

    ``others`` (T) says which rows of the other joints are fitted: an index of the normal matrices of these.
    """

    train: Array
    test: Array
    others: NDArray[np.intp]

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class JointGrams:
    """Gram matrices of one joint's rows: ``grams`` (F, C, c, c) by block of time and class of samples.

    The c columns are b entries of the regressor of the model given, m columns of candidates, and the torque. ``maps``
    (b, p) gives the entries from the p parameters of that model.
    """

    grams: Array
    maps: Array

    __repr__ = brief

    @cached_property
    def acts(self) -> NDArray[np.intp]:
        """The k parameters of the model that act on this joint."""
        return np.flatnonzero(self.maps.any(axis=0))

    @cached_property
    def reduced(self) -> Array:
        """The same matrices (F, C, k + m + 1, k + m + 1) with the columns of those k parameters for the entries."""
        b, k = len(self.maps), len(self.acts)
        rest, maps = self.grams.shape[-1] - b, self.maps[:, self.acts]
        found = np.empty((*self.grams.shape[:2], k + rest, k + rest))
        found[..., :k, :k] = maps.T @ self.grams[..., :b, :b] @ maps
        found[..., k:, k:] = self.grams[..., b:, b:]
        found[..., :k, k:] = maps.T @ self.grams[..., :b, b:]
        found[..., k:, :k] = np.swapaxes(found[..., :k, k:], -1, -2)
        return found

    def of(self, folds: Folds) -> tuple[Array, Array]:
        """Return the sums (T, c, c) of those matrices that each fold is fitted to, and those that it is judged by."""
        if folds not in self._sums:
            self._sums[folds] = weighed(folds.train, self.reduced), weighed(folds.test, self.reduced)
        return self._sums[folds]

    @cached_property
    def _sums(self) -> dict[Folds, tuple[Array, Array]]:
        return {}


@dataclass(frozen=True, eq=False)
class Fits:
    """What G groups of columns do in T folds: squared errors ``before`` (T) and ``after`` (T, G) on the rows judged by.

    ``best`` (T, G) is the size of a group that fits best, and ``values`` its coefficients (T, columns) by group;
    ``seen`` (T, G) is False where its columns are dependent on the others.
    """

    before: Array
    after: Array
    best: NDArray[np.intp]
    values: tuple[Array, ...]
    seen: NDArray[np.bool_]

    __repr__ = brief


def eliminated(gram: Array, keep: int, drop: Sequence[int]) -> tuple[Array, Array]:
    """Return normal matrix (..., keep, keep) and right side of the first columns, those in ``drop`` eliminated."""
    G, g = gram[..., :keep, :keep], gram[..., :keep, -1]
    index = list(drop)
    if not index:
        return G, g
    own = ridged(gram[..., index, :][..., index])
    cross = gram[..., index, :][..., [*range(keep), gram.shape[-1] - 1]]
    share = np.swapaxes(cross[..., :keep], -1, -2) @ np.linalg.solve(own, cross)
    return G - share[..., :keep], g - share[..., keep]


def weighed(weights: Array, grams: Array) -> Array:
    """Return sums (T, c, c) of Gram matrices (F, C, c, c) with weights (T, F, C)."""
    size = grams.shape[-1]
    return (weights.reshape(len(weights), -1) @ grams.reshape(-1, size * size)).reshape(-1, size, size)


def ridged(M: Array, share: float = SMALL) -> Array:
    """Return square matrices with a little of their diagonals added to these."""
    diagonal = np.einsum("...ii->...i", M)
    return np.asarray(M + (share * diagonal + np.finfo(float).tiny)[..., None] * np.eye(M.shape[-1]))


def tried(
    one: JointGrams,
    folds: Folds,
    rest: tuple[Array, Array],
    chosen: Sequence[int],
    groups: Sequence[Sequence[Sequence[int]]],
    weight: float,
) -> Fits:
    """Return what each group of columns does beside the ``chosen`` ones in each fold.

    A group is a sequence of sizes, each a sequence of as many columns; the one of least error on the rows fitted to is
    judged. ``rest`` are normal matrices (S, k, k) and right sides (S, k) of the parameters that act on this joint, from
    all other joints and the prior; ``weight`` is that of the rows of this one.
    """
    k, m = len(one.acts), one.grams.shape[-1] - len(one.maps) - 1
    flat = sorted({i for sizes in groups for size in sizes for i in size})
    base, pool, y = [*range(k), *(k + i for i in chosen)], [k + i for i in flat], k + m
    G, H = one.of(folds)
    M, right = G[:, base][:, :, base], G[:, base][:, :, [y, *pool]]
    M[:, :k, :k] += rest[0][folds.others] / weight
    right[:, :k, 0] += rest[1][folds.others] / weight
    solved = np.linalg.solve(ridged(M), right)
    x, X = solved[..., 0], np.asarray(solved[..., 1:], dtype=float)
    # the residual is y - base x; a unit of a candidate adds base X less its own column
    Hb, Hc = H[:, base][:, :, base], H[:, base][:, :, pool]
    left = H[:, base, y] - np.einsum("tij,tj->ti", Hb, x)
    before = H[:, y, y] - np.einsum("ti,ti->t", x, H[:, base, y] + left)
    beside = _Beside(
        pull=G[:, pool, y] - np.einsum("tik,ti->tk", right[..., 1:], x),
        slope=np.einsum("tik,ti->tk", X, left) - (H[:, pool, y] - np.einsum("tik,ti->tk", Hc, x)),
        before=before,
        G=G,
        H=H,
        B=right[..., 1:],
        X=X,
        Hc=Hc,
        HX=Hb @ X - Hc,
    )
    place = {i: n for n, i in enumerate(flat)}
    found = [beside.fitted(np.array([[place[i] for i in size] for size in sizes]), np.array(pool)) for sizes in groups]
    after, best, values, seen = zip(*found, strict=True) if found else ((), (), (), ())
    shape = (len(before), 0)
    return Fits(
        before,
        np.stack(after, axis=1) if found else np.zeros(shape),
        np.stack(best, axis=1) if found else np.zeros(shape, dtype=int),
        tuple(values),
        np.stack(seen, axis=1) if found else np.zeros(shape, dtype=bool),
    )


@dataclass(frozen=True, eq=False)
class _Beside:
    """What candidates are beside a fit, in T folds: their ``pull`` (T, P) on the rows fitted to, and ``slope`` of the
    error ``before`` (T) on those judged by; Gram matrices ``G`` and ``H`` (T, c, c) of both; products ``B`` and ``Hc``
    (T, k, P) of the k columns of the fit with them, their regressions ``X`` on these, and ``HX`` with what X leaves."""

    pull: Array
    slope: Array
    before: Array
    G: Array
    H: Array
    B: Array
    X: Array
    Hc: Array
    HX: Array

    __repr__ = brief

    def fitted(
        self, at: NDArray[np.intp], pool: NDArray[np.intp]
    ) -> tuple[Array, NDArray[np.intp], Array, NDArray[np.bool_]]:
        """Return error, best size, its coefficients and whether it is seen, of one group: candidates ``at`` (S, w), in
        the columns ``pool`` (P)."""
        rows, columns = pool[at][:, :, None], pool[at][:, None, :]
        own, X = self.G[:, rows, columns], self.X[:, :, at]
        diagonal = np.einsum("tskk->tsk", own)
        S = own - _products(self.B[:, :, at], X)
        S += (SMALL * diagonal + np.finfo(float).tiny)[..., None] * np.eye(at.shape[1])
        bend = self.H[:, rows, columns] + _products(X, self.HX[:, :, at]) - _products(self.Hc[:, :, at], X)
        pull = self.pull[:, at]
        gamma = np.linalg.solve(S, pull[..., None])[..., 0]
        reduction = np.einsum("tsk,tsk->ts", gamma, pull)
        error = self.before[:, None] + 2.0 * np.einsum("tsk,tsk->ts", gamma, self.slope[:, at])
        error += np.einsum("tsk,tskl,tsl->ts", gamma, bend, gamma)
        seen = (np.einsum("tskk->tsk", S) > DEPENDENT * diagonal).all(axis=2)
        best = np.argmax(np.where(seen, reduction, -1.0), axis=1)
        every = np.arange(len(best))
        return error[every, best], best, gamma[every, best], seen[every, best]


def _products(A: Array, B: Array) -> Array:
    """Return products (T, S, w, w) of the columns of each size of a group, A and B (T, k, S, w)."""
    return np.asarray(np.einsum("tksi,tksj->tsij", A, B))
