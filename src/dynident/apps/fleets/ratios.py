"""Likelihood ratios of all changes that one robot may have, and of draws in which nothing changes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dynident.apps.fleets.components import MIN_INFORMATION, History, Scatter, whiten
from dynident.regression import ParameterGroup, evidence, rank_of_information
from dynident.runtime import Noun
from dynident.runtime.arrays import Array

Candidate = tuple[int, int]  # the number of a group, and that of a course in time
CHUNK = 10_000_000  # numbers that are drawn at once
MIN_COLUMN_SHARE = 1e-7  # of a direction that no log shows, from the square root of its information
MIN_OWN_INFORMATION = 1e-8  # a direction with less information of its own, as a share, is that of what is already known


class NullDraws(Noun):
    """How logs without a change are drawn: ``count`` times by ``rng``.

    Their errors are those of a ``pool`` (L, b) of standardised errors of logs, where there is one, else normal.
    """

    rng: np.random.Generator
    count: int
    pool: Array | None = None


class LikelihoodRatios(Noun):
    """The logs of a robot as rows with independent errors of variance one, and the changes that are tried on them.

    ``rows`` (K, b, b) are the columns of the base parameters, ``value`` (K, b) the left side; ``columns`` (K, b,
    M) those of the groups' directions, of which ``group_slices`` say whose they are; ``courses`` (S, K): how much
    of a change each log has. ``rotations`` (K, b, b) turn errors that are standardised in the order of the
    parameters, as those of other logs are, into rows. ``dof``: degrees of freedom of the scatter that has made
    variances one.
    """

    rows: Array
    value: Array
    columns: Array
    group_slices: tuple[slice, ...]
    courses: Array
    rotations: Array
    dof: float

    @classmethod
    def of(
        cls, history: History, groups: Sequence[ParameterGroup], scatter: Scatter, courses: Array
    ) -> LikelihoodRatios:
        """Return those of a robot's logs with the scatter of its fleet."""
        vectors = whiten(history.value, history.information)
        b = history.value.shape[1]
        # whiten the rows by the scatter of the fleet and the inflated errors
        L = np.linalg.cholesky(
            scatter.inflation * np.eye(b) + vectors.factor @ scatter.covariance @ vectors.factor.swapaxes(1, 2)
        )
        rows, value = np.linalg.solve(L, vectors.factor), np.linalg.solve(L, vectors.value[:, :, None])[:, :, 0]
        ends = np.cumsum([0, *(group.directions.shape[1] for group in groups)])
        directions = np.hstack([np.zeros((b, 0)), *(group.directions for group in groups)])
        group_slices = tuple(slice(*ends[k : k + 2]) for k in range(len(groups)))
        # columns that consist of rounding errors would be fitted as directions
        columns, magnitudes = rows @ directions, np.abs(rows) @ np.abs(directions)
        size, largest = (np.linalg.norm(x, axis=(0, 1)) for x in (columns, magnitudes))
        columns[:, :, size <= MIN_COLUMN_SHARE * largest] = 0.0
        return cls(rows, value, columns, group_slices, courses, _row_rotations(rows), scatter.dof)

    def clearest_change(self, selected: Sequence[Candidate], draws: NullDraws) -> tuple[Candidate | None, float]:
        """Return the change with the least tail probability beside the selected ones, and its p-value among all
        candidates.

        None where no candidate is left. The p-value is the share of draws without a further change whose least tail
        probability is no larger, counting the data as one of them.
        """
        basis, chunk = self._known_basis(selected), max(1, CHUNK // self.value.size)
        observed, best = self._clearest_evidence(basis, self.value[None], np.ones((1, len(self.group_slices))))
        drawn = []
        # draws come in chunks, to bound the memory
        for start in range(0, draws.count, chunk):
            count = min(chunk, draws.count - start)
            noise = self._draw_rows(draws, count)
            # variances that were estimated: F instead of chi-square
            dof = self._variance_dof()
            factors = dof / draws.rng.chisquare(dof, (count, len(dof)))
            drawn.append(self._clearest_evidence(basis, noise, factors)[0])
        p_value = float((1 + (np.concatenate(drawn) >= observed[0]).sum()) / (draws.count + 1))
        return (best, p_value) if best else (None, 1.0)

    def standardised_errors(self, selected: Sequence[Candidate]) -> Array:
        """Return the standardised errors (K, b) of the logs beside the selected changes, of variance one on average."""
        Q = self._known_basis(selected).reshape(self.value.size, -1)
        flat = self.value.ravel()
        rows = (flat - Q @ (Q.T @ flat)).reshape(self.value.shape)
        # make up for the degrees of freedom that the fit has taken
        shown_logs = int(np.count_nonzero(self.rows.any(axis=2)))
        correction = np.sqrt(shown_logs / max(shown_logs - Q.shape[1], 1))
        return np.asarray(np.einsum("kij,ki->kj", self.rotations, rows) * correction)

    def _draw_rows(self, draws: NullDraws, count: int) -> Array:
        """Return rows of errors (N, K, b), each log's those of one of the pool, with a sign by chance."""
        rng, pool, logs = draws.rng, draws.pool, len(self.value)
        if pool is None:
            return rng.standard_normal((count, *self.value.shape))
        errors = pool[rng.integers(len(pool), size=(logs, count))] * rng.choice([-1.0, 1.0], size=(logs, count, 1))
        return np.asarray((errors @ self.rotations.swapaxes(1, 2)).swapaxes(0, 1))

    def _variance_dof(self) -> Array:
        """Return the degrees of freedom (groups) that the scatter has in the directions of each group.

        As of Hotelling's T^2: an estimated covariance leaves dof - k + 1 of them in k directions.
        """
        sizes = np.array([part.stop - part.start for part in self.group_slices])
        return np.asarray(np.maximum(self.dof - sizes + 1, 1.0))

    def _clearest_evidence(
        self, basis: Array, values: Array, variance_factors: Array
    ) -> tuple[Array, Candidate | None]:
        """Return the evidence (N) of the clearest change in values (N, K, b), and which it is in the first of them."""
        scores, best = self._scores(basis, values), None
        top = np.full(len(values), -np.inf)
        for g, (part, dof) in enumerate(zip(self.group_slices, self._variance_dof(), strict=True)):
            gains, rank = self._gains(basis, scores, part)
            for r in np.unique(rank[rank > 0]).tolist():
                courses = np.flatnonzero(rank == r)
                clearest = evidence(gains[courses].max(axis=0) * variance_factors[:, g], r, dof)
                if clearest[0] > top[0]:
                    best = g, int(courses[np.argmax(gains[courses, 0])])
                top = np.maximum(top, clearest)
        return top, best

    def refine(self, selected: Sequence[Candidate]) -> list[Candidate]:
        """Return the same changes, each with the course that fits best beside the others."""
        current = list(selected)
        for k, (g, _) in enumerate(selected):
            current[k] = g, int(np.argmax(self.profile(current, k)))
        return current

    def profile(self, selected: Sequence[Candidate], k: int) -> Array:
        """Return twice the log-likelihood (S) of the k-th change by its course, beside the others.

        It is minus infinity where the logs then show less of the change than with another course.
        """
        basis = self._known_basis([candidate for j, candidate in enumerate(selected) if j != k])
        gains, rank = self._gains(basis, self._scores(basis, self.value[None]), self.group_slices[selected[k][0]])
        return np.where(rank == rank.max(), gains[:, 0], -np.inf)

    def fit(self, selected: Sequence[Candidate]) -> list[tuple[Array, Array]]:
        """Return for each change its size (k) and standard error (k), infinite where the logs do not show it."""
        X = self._design(selected)
        scale = np.linalg.norm(X, axis=0)
        X, scale = X / np.where(scale > 0, scale, 1.0), np.where(scale > 0, scale, 1.0)
        information = X.T @ X
        covariance = rank_of_information(information, tolerance=MIN_INFORMATION).inverse
        # the pseudo-inverse times the information has ones on its diagonal only for sizes that the logs show
        is_shown = np.abs(np.diag(covariance @ information) - 1) < 1e-6
        size = covariance @ (X.T @ self.value.ravel()) / scale
        std = np.where(is_shown, np.sqrt(np.diag(covariance)) / scale, np.inf)
        estimates, end = [], self.value.shape[1]
        for g, _ in selected:
            start, end = end, end + self.group_slices[g].stop - self.group_slices[g].start
            estimates.append((size[start:end], std[start:end]))
        return estimates

    def _design(self, selected: Sequence[Candidate]) -> Array:
        """Return the columns (K b, q) of the base parameters and of the changes taken."""
        changes = (self.courses[s][:, None, None] * self.columns[:, :, self.group_slices[g]] for g, s in selected)
        return np.concatenate([self.rows, *changes], axis=2).reshape(self.value.size, -1)

    def _known_basis(self, selected: Sequence[Candidate]) -> Array:
        """Return an orthonormal basis (K, b, q) of what is known: the base parameters and the changes taken."""
        X = self._design(selected)
        scale = np.linalg.norm(X, axis=0)
        U, s, _ = np.linalg.svd(X / np.where(scale > 0, scale, 1.0), full_matrices=False)
        return np.asarray(U[:, s > 1e-6 * s[0]].reshape(*self.value.shape, -1))

    def _scores(self, basis: Array, values: Array) -> Array:
        """Return (S, N, M) the products of the groups' columns with what the known leaves of values (N, K, b)."""
        flat, Q = values.reshape(len(values), -1), basis.reshape(-1, basis.shape[2])
        residual = (flat - (flat @ Q) @ Q.T).reshape(values.shape)
        return np.tensordot(self.courses, residual.swapaxes(0, 1) @ self.columns, axes=1)

    def _gains(self, basis: Array, scores: Array, part: slice) -> tuple[Array, NDArray[np.intp]]:
        """Return twice the log-likelihood ratios (S, N) of one group by course, and their ranks (S)."""
        # by Schur complement, the information on a change that the basis leaves: X' X - (Q' X)' (Q' X)
        X = self.columns[:, :, part]
        overlap = np.tensordot(self.courses, basis.swapaxes(1, 2) @ X, axes=1)
        information = np.tensordot(self.courses**2, X.swapaxes(1, 2) @ X, axes=1)
        scale = np.sqrt(np.einsum("sii->si", information))
        scale = np.where(scale > 0, scale, 1.0)
        roots, vectors = np.linalg.eigh(
            (information - overlap.swapaxes(1, 2) @ overlap) / (scale[:, :, None] * scale[:, None, :])
        )
        # directions that the basis already holds have only rounding left
        is_own = roots > MIN_OWN_INFORMATION
        half = vectors * np.where(is_own, 1 / np.sqrt(np.where(is_own, roots, 1.0)), 0.0)[:, None, :]
        gains = ((scores[:, :, part] @ (half / scale[:, :, None])) ** 2).sum(axis=2)
        return gains, is_own.sum(axis=1)


def _row_rotations(rows: Array) -> Array:
    """Return the isometries (K, b, b) from standardised errors to rows: these are R W^-1/2 of W = R' R, in scaled
    parameters, with the symmetric root, which mixes parameters least."""
    scale = np.linalg.norm(rows, axis=1)
    R = rows / np.where(scale > 0, scale, 1.0)[:, None, :]
    U, s, Vt = np.linalg.svd(R)
    is_shown = s > 1e-6 * s[:, :1]
    return np.asarray(U @ (is_shown[:, :, None] * Vt))
