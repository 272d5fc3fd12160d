"""Gram matrices of the rows of a joint by block of time and class, and the fits of candidates from them alone."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import field
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.estimators import bodies_of, parameter_scales
from dynident.models import Parameter
from dynident.runtime import Noun
from dynident.runtime.arrays import Array

RIDGE_SHARE = 1e-9  # ridge, of a column's own square: dependent columns stay solvable
MIN_INDEPENDENT_SHARE = 1e-6  # share of a column's square that others must leave of it


class Folds(Noun):
    """T divisions of the rows of a joint: ``train`` and ``test`` (T, F, C) weigh blocks and classes of its samples.

    ``other_joints`` (T) says which rows of the other joints are fitted: an index into the normal matrices of
    these.
    """

    train: Array
    test: Array
    other_joints: NDArray[np.intp]


class SearchFolds(Noun):
    """The folds by which trials are judged.

    They are by ``blocks`` of time, the same from slow to fast samples (``faster``) and from inner to outer ones
    (``further``), by recording (``logs``, None for a single one), and ``all_samples`` for fit and test at once.
    ``train`` (S, F) are the blocks of the other joints in each of these fits.
    """

    blocks: Folds
    faster: Folds
    further: Folds
    all_samples: Folds
    logs: Folds | None
    train: Array

    @classmethod
    def of(cls, logs: NDArray[np.intp]) -> SearchFolds:
        """Return the folds for blocks whose logs (F) are given."""
        F = len(logs)
        eye, all_of, all_classes = np.eye(F), np.ones((1, F)), np.ones(4)
        # The last axis of the weights are the classes slow inner, slow outer, fast inner, fast outer.
        slow, inner = np.array([1.0, 1.0, 0.0, 0.0]), np.array([1.0, 0.0, 1.0, 0.0])
        by_log = (logs[None] == np.unique(logs)[:, None]).astype(float)
        several = len(by_log) > 1

        def divide(test: Array, start: int, fitted: Array = all_classes, judged: Array = all_classes) -> Folds:
            train = (1.0 - test)[:, :, None] * fitted
            return Folds(train, test[:, :, None] * judged, start + np.arange(len(test)))

        everything = all_of[:, :, None] * all_classes
        return cls(
            divide(eye, 0),
            divide(eye, 0, slow, 1.0 - slow),
            divide(eye, 0, inner, 1.0 - inner),
            Folds(everything, everything, np.array([F])),
            divide(by_log, F + 1) if several else None,
            np.concatenate([1.0 - eye, all_of, *([1.0 - by_log] if several else [])]),
        )


class JointGrams(Noun):
    """Gram matrices (c, c) of one joint's rows by block of time and class of samples.

    ``triangles`` (F, C, c (c + 1) / 2) holds their lower triangles, as candidates of many sizes take most of the
    memory. The c columns are b entries of the regressor of the model given, m columns of candidates, and the torque.
    ``maps`` (b, p) gives the entries from the p parameters of that model.
    """

    triangles: Array
    maps: Array

    @classmethod
    def of(cls, rows: Iterable[Array], shape: tuple[int, int], maps: Array) -> JointGrams:
        """Return the Gram matrices of ``rows`` (c, N) of each block and class, whose numbers are ``shape``."""
        triangles = np.stack([np.take(X @ X.T, _lower(len(X))) for X in rows])
        return cls(triangles.reshape(*shape, -1), maps)

    def only(self, columns: Sequence[int]) -> JointGrams:
        """Return the matrices of the entries, these columns of candidates and the torque."""
        b = len(self.maps)
        at = [*range(b), *(b + i for i in columns), -1]
        chosen = np.take(_square(self.triangles.shape[-1])[np.ix_(at, at)], _lower(len(at)))
        return JointGrams(self.triangles[..., chosen], self.maps)

    def weighted(self, weights: Array) -> Array:
        """Return the sums (T, c, c) of the matrices with ``weights`` (T, F, C)."""
        triangles = self.triangles.reshape(-1, self.triangles.shape[-1])
        return np.take(weights.reshape(len(weights), -1) @ triangles, _square(triangles.shape[1]), axis=1)

    @cached_property
    def acts(self) -> NDArray[np.intp]:
        """The k parameters of the model that act on this joint."""
        return np.flatnonzero(self.maps.any(axis=0))

    def sums(self, weights: Array) -> Array:
        """Return the sums (T, k + m + 1, k + m + 1) with ``weights`` (T, F, C), of parameters in place of entries."""
        total, maps = self.weighted(weights), self.maps[:, self.acts]
        b, k = maps.shape
        reduced = np.empty((len(total), k + total.shape[-1] - b, k + total.shape[-1] - b))
        reduced[:, :k, :k] = maps.T @ total[:, :b, :b] @ maps
        reduced[:, k:, k:] = total[:, b:, b:]
        reduced[:, :k, k:] = maps.T @ total[:, :b, b:]
        reduced[:, k:, :k] = np.swapaxes(reduced[:, :k, k:], 1, 2)
        return reduced


class CandidateGrams(Noun):
    """Gram matrices of the candidates of one joint and its torque, with the parameters of the model eliminated.

    ``joint_grams`` are those of the joint, whose rows have a ``weight``; ``other_normals`` are normal matrices
    (S, k, k) and right sides (S, k) of the parameters that act on it, from all other joints and the prior. What a
    candidate gains is then found in few columns, however many parameters the bodies have.
    """

    joint_grams: JointGrams
    other_normals: tuple[Array, Array]
    weight: float
    _sums: dict[int, tuple[Array, Array]] = field(default_factory=dict)
    _reduced: dict[Folds, tuple[Array, Array, Array]] = field(default_factory=dict)
    _tested: dict[tuple[Folds, int], Array] = field(default_factory=dict)

    def train(self, folds: Folds) -> tuple[Array, Array]:
        """Return the matrices (T, m + 1, m + 1) of the training rows, and their diagonals before (T, m + 1)."""
        if folds not in self._reduced:
            k, G = len(self.joint_grams.acts), self.joint_grams.sums(folds.train)
            M, right = G[:, :k, :k].copy(), G[:, :k, k:].copy()
            M += self.other_normals[0][folds.other_joints] / self.weight
            right[:, :, -1] += self.other_normals[1][folds.other_joints] / self.weight
            shares = np.asarray(np.linalg.solve(add_ridge(M), right), dtype=float)
            schur = G[:, k:, k:] - np.swapaxes(right, 1, 2) @ shares
            self._reduced[folds] = shares, schur, np.einsum("tii->ti", G[:, k:, k:])
        return self._reduced[folds][1:]

    def test(self, folds: Folds, weights: Array) -> Array:
        """Return the matrices (T, m + 1, m + 1) of rows with ``weights`` (T, F, C), less what the fit of the folds
        explains of them by the eliminated parameters."""
        if (folds, id(weights)) not in self._tested:
            self.train(folds)
            if id(weights) not in self._sums:  # the array is kept, so that no other has its id
                self._sums[id(weights)] = weights, self.joint_grams.sums(weights)
            k, H, shares = len(self.joint_grams.acts), self._sums[id(weights)][1], self._reduced[folds][0]
            # half of what the fit takes off, which is symmetric: one product of large matrices less
            half = np.swapaxes(shares, 1, 2) @ (H[:, :k, k:] - 0.5 * H[:, :k, :k] @ shares)
            self._tested[folds, id(weights)] = H[:, k:, k:] - half - np.swapaxes(half, 1, 2)
        return self._tested[folds, id(weights)]


class TrialFits(Noun):
    """Fits of G groups of columns in T folds: squared errors ``before`` (T) and ``after`` (T, G) on the test rows.

    ``best`` (T, G) is the size of a group that fits best, and ``values`` its coefficients (T, columns) by group.
    ``independent`` (T, G) is False where its columns are dependent on the others.
    """

    before: Array
    after: Array
    best: NDArray[np.intp]
    values: tuple[Array, ...]
    independent: NDArray[np.bool_]

    def group(self, g: int, sizes: Sequence[Sequence[int]]) -> tuple[list[Sequence[int]], Array]:
        """Return the columns of the best size of group g, which has these sizes, in each fold, and their values."""
        return [sizes[size] for size in self.best[:, g].tolist()], self.values[g]


def eliminate_columns(gram: Array, keep: int) -> tuple[Array, Array]:
    """Return normal matrix (..., keep, keep) and right side of the first columns, with all others eliminated."""
    cross = np.concatenate([gram[..., keep:-1, :keep], gram[..., keep:-1, -1:]], axis=-1)
    share = np.swapaxes(cross[..., :keep], -1, -2) @ np.linalg.solve(add_ridge(gram[..., keep:-1, keep:-1]), cross)
    return gram[..., :keep, :keep] - share[..., :keep], gram[..., :keep, -1] - share[..., keep]


@cache
def _lower(size: int) -> NDArray[np.intp]:
    """Return where the lower triangle of a flattened square matrix of this ``size`` is."""
    return np.flatnonzero(np.tri(size))


@cache
def _square(size: int) -> NDArray[np.intp]:
    """Return where each element (c, c) of a symmetric matrix is in its lower triangle of this ``size``."""
    c = int(np.sqrt(2 * size))
    row, column = np.indices((c, c))
    low, high = np.minimum(row, column), np.maximum(row, column)
    return np.asarray(high * (high + 1) // 2 + low)


def add_ridge(M: Array, diagonal: Array | None = None) -> Array:
    """Return square matrices with a small share of their ``diagonal``, or of another, added, so that they can be
    solved."""
    diagonal = np.einsum("...ii->...i", M) if diagonal is None else diagonal
    return np.asarray(M + (RIDGE_SHARE * diagonal + np.finfo(float).tiny)[..., None] * np.eye(M.shape[-1]))


def try_groups(
    candidates: CandidateGrams, folds: Folds, columns: Sequence[int], groups: Sequence[Sequence[Sequence[int]]]
) -> TrialFits:
    """Return the fit of each group of columns beside the chosen ``columns`` in each fold.

    A group is a sequence of sizes, each a sequence of as many columns; the size of least error on the training
    rows is tested.
    """
    flat, base, y = sorted({i for sizes in groups for size in sizes for i in size}), list(columns), -1
    (G, diagonal), H = candidates.train(folds), candidates.test(folds, folds.test)
    # One solve per fold for the fit and for all candidates at once: these are further right sides.
    M, right = G[:, base][:, :, base], G[:, base][:, :, [y, *flat]]
    solved = np.linalg.solve(add_ridge(M, diagonal[:, base]), right)
    x, X = solved[..., 0], np.asarray(solved[..., 1:], dtype=float)
    # the residual is y - base x; a unit of a candidate adds base X less its own column
    Hb, Hc = H[:, base][:, :, base], H[:, base][:, :, flat]
    residual_products = H[:, base, y] - np.einsum("tij,tj->ti", Hb, x)
    before = H[:, y, y] - np.einsum("ti,ti->t", x, H[:, base, y] + residual_products)
    candidate_fit = _CandidateFit(
        pull=G[:, flat, y] - np.einsum("tik,ti->tk", right[..., 1:], x),
        slope=np.einsum("tik,ti->tk", X, residual_products) - (H[:, flat, y] - np.einsum("tik,ti->tk", Hc, x)),
        before=before,
        diagonal=diagonal,
        G=G,
        H=H,
        B=right[..., 1:],
        X=X,
        Hc=Hc,
        HX=Hb @ X - Hc,
    )
    place = {i: n for n, i in enumerate(flat)}
    group_fits = [
        candidate_fit.fit_group(np.array([[place[i] for i in size] for size in sizes]), np.array(flat))
        for sizes in groups
    ]
    after, best, values, independent = zip(*group_fits, strict=True) if group_fits else ((),) * 4
    by_fold = [np.reshape(x, (len(groups), len(before))).T for x in (after, best, independent)]
    return TrialFits(before, by_fold[0], by_fold[1].astype(np.intp), tuple(values), by_fold[2].astype(bool))


class _CandidateFit(Noun):
    """The state of a fit in T folds beside which P candidates are tried.

    ``pull`` (T, P) is the product of the candidates with the residual of the training rows, ``slope`` the
    derivative of the test error ``before`` (T). ``G`` and ``H`` (T, c, c) are the Gram matrices of both, ``diagonal``
    (T, c) that of the columns themselves; ``B``
    and ``Hc`` (T, k, P) the products of the k columns of the fit with the candidates, ``X`` the regressions of
    the candidates on these columns, and ``HX`` the products with what X leaves.
    """

    pull: Array
    slope: Array
    before: Array
    diagonal: Array
    G: Array
    H: Array
    B: Array
    X: Array
    Hc: Array
    HX: Array

    def fit_group(
        self, at: NDArray[np.intp], pool: NDArray[np.intp]
    ) -> tuple[Array, NDArray[np.intp], Array, NDArray[np.bool_]]:
        """Return test error, best size, its coefficients and whether it is independent, for one group.

        The candidates ``at`` (S, w) are in the columns ``pool`` (P).
        """
        rows, columns = pool[at][:, :, None], pool[at][:, None, :]
        candidate_gram, X = self.G[:, rows, columns], self.X[:, :, at]
        diagonal = self.diagonal[:, pool[at]]
        # Schur complement of the candidate columns: their Gram matrix less what the columns of the fit explain.
        S = candidate_gram - _products(self.B[:, :, at], X)
        S += (RIDGE_SHARE * diagonal + np.finfo(float).tiny)[..., None] * np.eye(at.shape[1])
        bend = self.H[:, rows, columns] + _products(X, self.HX[:, :, at]) - _products(self.Hc[:, :, at], X)
        pull = self.pull[:, at]
        gamma = np.linalg.solve(S, pull[..., None])[..., 0]
        reduction = np.einsum("tsk,tsk->ts", gamma, pull)
        # The test error is a quadratic in the coefficients of the candidate: slope and curvature give it exactly.
        error = self.before[:, None] + 2.0 * np.einsum("tsk,tsk->ts", gamma, self.slope[:, at])
        error += np.einsum("tsk,tskl,tsl->ts", gamma, bend, gamma)
        # A column of which the others leave next to nothing has no coefficient of its own.
        independent = (np.einsum("tskk->tsk", S) > MIN_INDEPENDENT_SHARE * diagonal).all(axis=2)
        best = np.argmax(np.where(independent, reduction, -1.0), axis=1)
        fold_index = np.arange(len(best))
        return error[fold_index, best], best, gamma[fold_index, best], independent[fold_index, best]


def transfer_gains(
    candidates: CandidateGrams,
    folds: Folds,
    test: Array,
    columns: Sequence[int],
    fitted_columns: tuple[Sequence[Sequence[int]], Array],
) -> tuple[Array, Array]:
    """Return by how much columns with known coefficients lower the squared errors (T), and these errors without them.

    All else is fitted to the training rows of ``folds``, with them and without; ``test`` (T, F, C) weighs the rows that
    are judged. ``fitted_columns`` are the columns of each fold, and their coefficients (T, w), found elsewhere.
    """
    (G, diagonal), H, base = candidates.train(folds), candidates.test(folds, test), list(columns)
    M = add_ridge(G[:, base][:, :, base], diagonal[:, base])
    gains, before = np.zeros(len(G)), np.zeros(len(G))
    for t, (added, coefficients) in enumerate(zip(*fitted_columns, strict=True)):
        solved, residuals = np.linalg.solve(M[t], G[t][np.ix_(base, [-1, *added])]), np.zeros((2, len(H[t])))
        residuals[:, -1], residuals[1, list(added)] = 1.0, -coefficients
        residuals[:, base] = np.outer([0.0, 1.0], solved[:, 1:] @ coefficients) - solved[:, 0]
        before[t], after = np.sum(residuals @ H[t] * residuals, axis=1)
        gains[t] = before[t] - after
    return gains, before


def _products(A: Array, B: Array) -> Array:
    """Return products (T, S, w, w) of the columns of each size of a group, for A and B (T, k, S, w)."""
    return np.asarray(np.einsum("tksi,tksj->tsij", A, B))


Normal = tuple[Array, Array]


class Prior(Noun):
    """A prior of p parameters: ``mean`` (p), the robot file's values, and ``precision`` (p) per independent sample.

    Its standard deviation is the size of the parameter: what a body of the nominal mass and length has. Parameters
    that are not of bodies have none.
    """

    mean: Array
    precision: Array


def prior_of(parameters: Sequence[Parameter]) -> Prior:
    """Return the prior of the parameters of a model."""
    bodies = bodies_of(parameters)
    size = parameter_scales(parameters, bodies, np.ones(len(parameters)), 1.0)
    mean, precision = np.zeros(len(parameters)), np.zeros(len(parameters))
    for body in bodies:
        values = [parameters[k].value for k in body.columns]
        mean[body.columns] = [0.0 if value is None else value for value in values]
        precision[body.columns] = 1.0 / size[body.columns] ** 2
    return Prior(mean, precision)


def normal_matrices(joint_grams: JointGrams, train: Array, weight: float) -> Normal:
    """Return normal matrices (S, p, p) and right sides (S, p) of the parameters from one joint.

    Its columns are eliminated; ``train`` (S, F) weighs the blocks of the joint.
    """
    b = len(joint_grams.maps)
    total = weight * joint_grams.weighted(np.repeat(train[:, :, None], joint_grams.triangles.shape[1], axis=2))
    M, right = eliminate_columns(total, b)
    return joint_grams.maps.T @ M @ joint_grams.maps, right @ joint_grams.maps


def other_joint_normals(normals: Sequence[Normal], j: int, precision: Array, acts: NDArray[np.intp]) -> Normal:
    """Return normal matrices (S, k, k) and right sides of the parameters that act on joint j.

    They are from all other joints and the prior (p); parameters that act on other joints only are eliminated.
    """
    # Sum over all joints less the one searched; the ridge keeps directions solvable that only this joint shows.
    M = np.add.reduce([normal[0] for normal in normals])
    diagonal = np.einsum("sii->si", M).max(axis=0)
    M, right = M - normals[j][0], np.add.reduce([normal[1] for normal in normals]) - normals[j][1]
    M = M + np.diag(precision + 1e-9 * diagonal + np.finfo(float).tiny)
    if not len(eliminated := np.setdiff1d(np.arange(len(precision)), acts)):
        return M, right
    # Schur complement: eliminate the parameters without effect on this joint once, not in every trial.
    cross = M[:, eliminated][:, :, acts]
    solved = np.linalg.solve(
        add_ridge(M[:, eliminated][:, :, eliminated]), np.concatenate([cross, right[:, eliminated, None]], axis=2)
    )
    reduction = np.swapaxes(cross, 1, 2) @ solved
    return M[:, acts][:, :, acts] - reduction[..., :-1], right[:, acts] - reduction[..., -1]


def gain_share(gains: Array, before: Array) -> tuple[float, float]:
    """Return the sum of gains (T) as a share (%) of the squared errors before, and its standard error."""
    total = float(before.sum())
    if not total > 0:
        return 0.0, 0.0
    spread = float(np.sqrt(len(gains)) * gains.std(ddof=1)) if len(gains) > 1 else 0.0
    return 100.0 * float(gains.sum()) / total, 100.0 * spread / total
