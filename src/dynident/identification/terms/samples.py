"""The samples for the choice of terms: thinned, divided into blocks of time, with the columns of a term on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dynident.models import Model, Past, Term
from dynident.motion.log import Motion
from dynident.regression import EVERYTHING, Selection, fitted_mask
from dynident.runtime import brief

Array = NDArray[np.float64]
RIDGE_SHARE = 1e-9  # ridge, of a column's own square: dependent columns stay solvable
MIN_INDEPENDENT_SHARE = 1e-6  # share of a column's square that others must leave of it


@dataclass(frozen=True, eq=False)
class Folds:
    """T divisions of the rows of a joint: ``train`` and ``test`` (T, F, C) weigh blocks and classes of its samples.

    ``other_joints`` (T) says which rows of the other joints are fitted: an index into the normal matrices of
    these.
    """

    train: Array
    test: Array
    other_joints: NDArray[np.intp]

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
    def parameter_grams(self) -> Array:
        """The same matrices (F, C, k + m + 1, k + m + 1), with the k parameters in place of the entries."""
        b, k = len(self.maps), len(self.acts)
        n_other, maps = self.grams.shape[-1] - b, self.maps[:, self.acts]
        reduced_grams = np.empty((*self.grams.shape[:2], k + n_other, k + n_other))
        reduced_grams[..., :k, :k] = maps.T @ self.grams[..., :b, :b] @ maps
        reduced_grams[..., k:, k:] = self.grams[..., b:, b:]
        reduced_grams[..., :k, k:] = maps.T @ self.grams[..., :b, b:]
        reduced_grams[..., k:, :k] = np.swapaxes(reduced_grams[..., :k, k:], -1, -2)
        return reduced_grams

    def fold_sums(self, folds: Folds) -> tuple[Array, Array]:
        """Return the sums (T, c, c) of these matrices over the training rows and over the test rows of each fold."""
        if folds not in self._sums:
            self._sums[folds] = (
                weighted_sums(folds.train, self.parameter_grams),
                weighted_sums(folds.test, self.parameter_grams),
            )
        return self._sums[folds]

    @cached_property
    def _sums(self) -> dict[Folds, tuple[Array, Array]]:
        return {}


@dataclass(frozen=True, eq=False)
class TrialFits:
    """Fits of G groups of columns in T folds: squared errors ``before`` (T) and ``after`` (T, G) on the test rows.

    ``best`` (T, G) is the size of a group that fits best, and ``values`` its coefficients (T, columns) by group.
    ``independent`` (T, G) is False where its columns are dependent on the others.
    """

    before: Array
    after: Array
    best: NDArray[np.intp]
    values: tuple[Array, ...]
    independent: NDArray[np.bool_]

    __repr__ = brief


def eliminate_columns(gram: Array, keep: int, drop: Sequence[int]) -> tuple[Array, Array]:
    """Return normal matrix (..., keep, keep) and right side of the first columns, with those in ``drop`` eliminated."""
    G, g = gram[..., :keep, :keep], gram[..., :keep, -1]
    index = list(drop)
    if not index:
        return G, g
    dropped_gram = add_ridge(gram[..., index, :][..., index])
    cross = gram[..., index, :][..., [*range(keep), gram.shape[-1] - 1]]
    share = np.swapaxes(cross[..., :keep], -1, -2) @ np.linalg.solve(dropped_gram, cross)
    return G - share[..., :keep], g - share[..., keep]


def weighted_sums(weights: Array, grams: Array) -> Array:
    """Return weighted sums (T, c, c) of Gram matrices (F, C, c, c), with weights (T, F, C)."""
    size = grams.shape[-1]
    return (weights.reshape(len(weights), -1) @ grams.reshape(-1, size * size)).reshape(-1, size, size)


def add_ridge(M: Array, share: float = RIDGE_SHARE) -> Array:
    """Return square matrices with a small share of their diagonals added, so that they can be solved."""
    diagonal = np.einsum("...ii->...i", M)
    return np.asarray(M + (share * diagonal + np.finfo(float).tiny)[..., None] * np.eye(M.shape[-1]))


def try_groups(
    joint_grams: JointGrams,
    folds: Folds,
    other_normals: tuple[Array, Array],
    columns: Sequence[int],
    groups: Sequence[Sequence[Sequence[int]]],
    weight: float,
) -> TrialFits:
    """Return the fit of each group of columns beside the chosen ``columns`` in each fold.

    A group is a sequence of sizes, each a sequence of as many columns; the size of least error on the training
    rows is tested. ``other_normals`` are normal matrices (S, k, k) and right sides (S, k) of the parameters that
    act on this joint, from all other joints and the prior; ``weight`` is that of the rows of this one.
    """
    k, m = len(joint_grams.acts), joint_grams.grams.shape[-1] - len(joint_grams.maps) - 1
    flat = sorted({i for sizes in groups for size in sizes for i in size})
    base, pool, y = [*range(k), *(k + i for i in columns)], [k + i for i in flat], k + m
    G, H = joint_grams.fold_sums(folds)
    # One solve per fold for the fit and for all candidates at once: these are further right sides.
    M, right = G[:, base][:, :, base], G[:, base][:, :, [y, *pool]]
    M[:, :k, :k] += other_normals[0][folds.other_joints] / weight
    right[:, :k, 0] += other_normals[1][folds.other_joints] / weight
    solved = np.linalg.solve(add_ridge(M), right)
    x, X = solved[..., 0], np.asarray(solved[..., 1:], dtype=float)
    # the residual is y - base x; a unit of a candidate adds base X less its own column
    Hb, Hc = H[:, base][:, :, base], H[:, base][:, :, pool]
    residual_products = H[:, base, y] - np.einsum("tij,tj->ti", Hb, x)
    before = H[:, y, y] - np.einsum("ti,ti->t", x, H[:, base, y] + residual_products)
    candidate_fit = _CandidateFit(
        pull=G[:, pool, y] - np.einsum("tik,ti->tk", right[..., 1:], x),
        slope=np.einsum("tik,ti->tk", X, residual_products) - (H[:, pool, y] - np.einsum("tik,ti->tk", Hc, x)),
        before=before,
        G=G,
        H=H,
        B=right[..., 1:],
        X=X,
        Hc=Hc,
        HX=Hb @ X - Hc,
    )
    place = {i: n for n, i in enumerate(flat)}
    group_fits = [
        candidate_fit.fit_group(np.array([[place[i] for i in size] for size in sizes]), np.array(pool))
        for sizes in groups
    ]
    after, best, values, independent = zip(*group_fits, strict=True) if group_fits else ((), (), (), ())
    shape = (len(before), 0)
    return TrialFits(
        before,
        np.stack(after, axis=1) if group_fits else np.zeros(shape),
        np.stack(best, axis=1) if group_fits else np.zeros(shape, dtype=int),
        tuple(values),
        np.stack(independent, axis=1) if group_fits else np.zeros(shape, dtype=bool),
    )


@dataclass(frozen=True, eq=False)
class _CandidateFit:
    """The state of a fit in T folds beside which P candidates are tried.

    ``pull`` (T, P) is the product of the candidates with the residual of the training rows, ``slope`` the
    derivative of the test error ``before`` (T). ``G`` and ``H`` (T, c, c) are the Gram matrices of both; ``B``
    and ``Hc`` (T, k, P) the products of the k columns of the fit with the candidates, ``X`` the regressions of
    the candidates on these columns, and ``HX`` the products with what X leaves.
    """

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

    def fit_group(
        self, at: NDArray[np.intp], pool: NDArray[np.intp]
    ) -> tuple[Array, NDArray[np.intp], Array, NDArray[np.bool_]]:
        """Return test error, best size, its coefficients and whether it is independent, for one group.

        The candidates ``at`` (S, w) are in the columns ``pool`` (P).
        """
        rows, columns = pool[at][:, :, None], pool[at][:, None, :]
        candidate_gram, X = self.G[:, rows, columns], self.X[:, :, at]
        diagonal = np.einsum("tskk->tsk", candidate_gram)
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


def _products(A: Array, B: Array) -> Array:
    """Return products (T, S, w, w) of the columns of each size of a group, for A and B (T, k, S, w)."""
    return np.asarray(np.einsum("tksi,tksj->tsij", A, B))


MAX_SAMPLES = 20_000  # of all motions together: the choice needs no more
BLOCKS = 16  # of time, of all motions together; at least one of each motion
# quantiles of speed and of the distance from the middle that divide the samples of a joint
FAST_QUANTILE, OUTER_QUANTILE = 0.6, 0.7
N_CLASSES = 4  # slow inner, slow outer, fast inner, fast outer
MAX_GAP_SHARE = 1 / 8  # of a block at most


@dataclass(frozen=True, eq=False)
class TermSamples:
    """Samples of the ``motions`` of a ``model``, thinned evenly, N in all.

    ``rows`` are the usable ones of each motion, ``block`` (N) is the block of each sample, and ``of_block`` (F)
    the motion of each block.
    """

    model: Model
    motions: tuple[Motion, ...]
    rows: tuple[NDArray[np.intp], ...]
    block: NDArray[np.intp]
    of_block: NDArray[np.intp]
    selection: Selection = EVERYTHING

    __repr__ = brief

    def __len__(self) -> int:
        return len(self.block)

    @property
    def blocks(self) -> int:
        """Number F of blocks."""
        return len(self.of_block)

    @cached_property
    def states(self) -> dict[str, Array]:
        """The states (N, n) by name, with the memory of the model where it has one."""
        motion_states = [motion.states(rows) for motion, rows in zip(self.motions, self.rows, strict=True)]
        return {name: np.concatenate([state[name] for state in motion_states]) for name in motion_states[0]}

    @cached_property
    def usable_states(self) -> tuple[tuple[Array, Array, Array], ...]:
        """The q, dq, ddq of each motion at its usable samples."""
        pairs = zip(self.motions, self.rows, strict=True)
        return tuple((motion.q[rows], motion.dq[rows], motion.ddq[rows]) for motion, rows in pairs)

    @cached_property
    def tau(self) -> Array:
        """The measured torque (N, n)."""
        return np.concatenate([motion.tau[rows] for motion, rows in zip(self.motions, self.rows, strict=True)])

    @cached_property
    def keep(self) -> NDArray[np.bool_]:
        """Which torque equations (N, n) are fitted."""
        pairs = zip(self.motions, self.rows, strict=True)
        return np.concatenate([fitted_mask(motion, self.selection.min_speed, rows) for motion, rows in pairs])

    def loads(self, load: tuple[float, ...] | None) -> tuple[Array, ...]:
        """Return the torque of the bodies (N, n) with the parameters ``load`` on each motion, zero for None."""
        if load is None:
            return tuple(np.zeros_like(motion.q) for motion in self.motions)
        bodies = Model(tuple(term for term in self.model.terms if term.loads))
        return tuple(bodies.torque(motion.q, motion.dq, motion.ddq, load) for motion in self.motions)

    def is_inside(self, gap: int) -> NDArray[np.bool_]:
        """Return which samples (N) are more than ``gap`` samples away from another block of their motion."""
        gap = min(gap, int(MAX_GAP_SHARE * len(self) / self.blocks))
        is_inner = np.ones(len(self), dtype=bool)
        for border in np.flatnonzero(np.diff(self.block)) + 1:
            if self.of_block[self.block[border]] == self.of_block[self.block[border - 1]]:
                is_inner[max(border - gap, 0) : border + gap] = False
        return is_inner

    def classes(self, j: int) -> NDArray[np.intp]:
        """Return the class (N) of each sample of a joint, by speed and distance from the middle."""
        return self.classes_of(self.states["q"][:, j], self.states["dq"][:, j])

    @staticmethod
    def classes_of(q: Array, dq: Array) -> NDArray[np.intp]:
        """Return the class (N) of each sample of a coordinate q (N) with velocity dq (N)."""
        speed = np.abs(dq)
        away = np.abs(q - 0.5 * (q.min() + q.max()))
        return np.asarray(
            2 * (speed >= np.quantile(speed, FAST_QUANTILE)) + (away >= np.quantile(away, OUTER_QUANTILE))
        )


def select_samples(
    model: Model, motions: Sequence[Motion], selection: Selection = EVERYTHING, max_samples: int = MAX_SAMPLES
) -> TermSamples:
    """Return at most ``max_samples`` of the motions, every k-th; motions without two usable ones are left out."""
    usable = [motion for motion in motions if motion.mask.sum() > 1]
    step = -(-sum(int(motion.mask.sum()) for motion in usable) // max_samples)
    thinned = tuple(model.remembering(motion.shift(0.0, np.arange(0, len(motion), step))) for motion in usable)
    thinned = tuple(motion for motion in thinned if motion.mask.sum() > 1)
    rows = tuple(np.flatnonzero(motion.mask) for motion in thinned)
    # Blocks in proportion to the samples of a motion, at least one each.
    total = sum(map(len, rows))
    counts = [max(1, round(BLOCKS * len(indices) / total)) for indices in rows]
    if len(counts) == 1:
        counts = [BLOCKS]
    first_block = np.concatenate([[0], np.cumsum(counts)[:-1]])
    parts = zip(first_block, counts, map(len, rows), strict=True)
    block = [start + np.arange(size) * count // size for start, count, size in parts]
    return TermSamples(
        model, thinned, rows, np.concatenate(block), np.repeat(np.arange(len(counts)), counts), selection
    )


def columns_of(samples: TermSamples, term: Term, j: int, loads: Sequence[Array]) -> Array:
    """Return the columns (w, N) of a term in the equation of joint j; ``loads`` (N, n) are those of each motion."""
    columns, w = [], len(term.parameters)
    for motion, rows, usable, load in zip(samples.motions, samples.rows, samples.usable_states, loads, strict=True):
        states = motion.q, motion.dq, motion.ddq
        memory = (term.remember(Past(motion.t, *states, load))[rows],) if term.memory else ()
        q, dq, ddq = usable
        if term.has_own("entries"):
            columns.append(np.asarray(term.entries(q, dq, ddq, np.full(w, j), np.arange(w), *memory)))
        else:
            columns.append(np.asarray(term.regressor(q, dq, ddq, *memory))[:, j].T)
    return np.concatenate(columns, axis=1)


@dataclass(frozen=True, eq=False)
class JointEquations:
    """The equation of joint ``j`` in all samples.

    ``entries`` (b, N) are those of the model with their ``maps`` (b, p), ``tau`` (N) is the torque less that of
    the prior, and ``usable`` (N) says which samples are fitted.
    """

    j: int
    entries: Array
    maps: Array
    tau: Array
    usable: NDArray[np.bool_]

    __repr__ = brief

    @classmethod
    def of(cls, samples: TermSamples, j: int, prior: Array) -> JointEquations:
        """Return the rows of a joint, with the torque less that of the prior (p)."""
        structure = samples.model.structure
        columns, maps = structure.columns[j], structure.maps[j]
        entries = samples.model.entries(**samples.states, joint=np.full(len(columns), j), parameter=columns)
        return cls(j, entries, maps, samples.tau[:, j] - (maps @ prior) @ entries, samples.keep[:, j])

    def residual(self, theta: Array, columns: Array, values: Array) -> Array:
        """Return the residual torque (N) for theta (p) and columns (m, N) with their values (m)."""
        return np.asarray(self.tau - (self.maps @ theta) @ self.entries - values @ columns)

    def grams(
        self, columns: Array, block: NDArray[np.intp], label: NDArray[np.intp], shape: tuple[int, int]
    ) -> JointGrams:
        """Return the Gram matrices with columns (m, N) by block and label (N), whose numbers are ``shape``."""
        # Sort samples by block and class, so that each Gram matrix is one product of contiguous columns.
        key = np.where(self.usable & (block >= 0) & (label >= 0), block * shape[1] + label, -1)
        order = np.argsort(key, kind="stable")
        ends = np.searchsorted(key[order], np.arange(shape[0] * shape[1] + 1))
        X = np.concatenate([self.entries, columns, self.tau[None]])
        parts = (X[:, order[start:stop]] for start, stop in pairwise(ends))
        return JointGrams(np.stack([rows @ rows.T for rows in parts]).reshape(*shape, len(X), len(X)), self.maps)


def correlation_length(residual: Array, max_lag: int) -> int:
    """Return the lag (samples) at which the autocorrelation of a residual (N) falls below 1/e, at most ``max_lag``."""
    size = len(residual)
    # Padding to twice the length avoids the wrap-around of the circular correlation.
    spectrum = np.fft.rfft(residual - residual.mean(), 2 * size)
    auto = np.fft.irfft(np.square(np.abs(spectrum)))[: max(max_lag // 2, 2)]
    below = np.flatnonzero(auto < np.exp(-1) * auto[0])
    return int(below[0]) if len(below) else len(auto)
