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
        rest = self.grams.shape[-1] - b
        T = np.zeros((b + rest, k + rest))
        T[:b, :k], T[b:, k:] = self.maps[:, self.acts], np.eye(rest)
        return np.asarray(T.T @ self.grams @ T)


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
    G, H = (weight * weighed(part, one.reduced) for part in (folds.train, folds.test))
    M, right = G[:, base][:, :, base], G[:, base][:, :, [y, *pool]]
    M[:, :k, :k] += rest[0][folds.others]
    right[:, :k, 0] += rest[1][folds.others]
    solved = np.linalg.solve(ridged(M), right)
    x, X = solved[..., 0], solved[..., 1:]
    B = right[..., 1:]
    own = G[:, pool][:, :, pool]
    schur = own - np.swapaxes(B, 1, 2) @ X
    pull = G[:, pool, y] - np.einsum("tik,ti->tk", B, x)
    # the residual is y - base x; a unit of a candidate adds base X less its own column
    Hb, Hc = H[:, base][:, :, base], H[:, base][:, :, pool]
    left = H[:, base, y] - np.einsum("tij,tj->ti", Hb, x)
    before = H[:, y, y] - np.einsum("ti,ti->t", x, H[:, base, y] + left)
    slope = np.einsum("tik,ti->tk", X, left) - (H[:, pool, y] - np.einsum("tik,ti->tk", Hc, x))
    XH = np.swapaxes(X, 1, 2) @ Hc
    bend = np.swapaxes(X, 1, 2) @ Hb @ X - XH - np.swapaxes(XH, 1, 2) + H[:, pool][:, :, pool]
    place = {i: n for n, i in enumerate(flat)}
    found = [
        _fitted(np.array([[place[i] for i in size] for size in sizes]), schur, pull, own, before, slope, bend)
        for sizes in groups
    ]
    after, best, values, seen = zip(*found, strict=True) if found else ((), (), (), ())
    shape = (len(before), 0)
    return Fits(
        before / weight,
        np.stack(after, axis=1) / weight if found else np.zeros(shape),
        np.stack(best, axis=1) if found else np.zeros(shape, dtype=int),
        tuple(values),
        np.stack(seen, axis=1) if found else np.zeros(shape, dtype=bool),
    )


def _fitted(
    at: NDArray[np.intp], schur: Array, pull: Array, own: Array, before: Array, slope: Array, bend: Array
) -> tuple[Array, NDArray[np.intp], Array, NDArray[np.bool_]]:
    """Return error, best size, its coefficients and whether it is seen, of one group with columns ``at`` (S, w)."""
    rows, columns = at[:, :, None], at[:, None, :]
    diagonal = np.einsum("tkk->tk", own)[:, at]  # (T, S, w)
    S = schur[:, rows, columns] + (SMALL * diagonal + np.finfo(float).tiny)[..., None] * np.eye(at.shape[1])
    gamma = np.linalg.solve(S, pull[:, at][..., None])[..., 0]
    reduction = np.einsum("tsk,tsk->ts", gamma, pull[:, at])
    error = before[:, None] + 2.0 * np.einsum("tsk,tsk->ts", gamma, slope[:, at])
    error += np.einsum("tsk,tskl,tsl->ts", gamma, bend[:, rows, columns], gamma)
    seen = (np.einsum("tskk->tsk", S) > DEPENDENT * diagonal).all(axis=2)
    best = np.argmax(np.where(seen, reduction, -1.0), axis=1)
    every = np.arange(len(best))
    return error[every, best], best, gamma[every, best], seen[every, best]
