"""Likelihood ratios of all changes that one robot may have, and of draws in which nothing changes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.fleets.components import Components, measured, pseudo_inverse
from dynident.fleets.history import History
from dynident.regression import Group

__all__ = ["Ratios", "evidence"]

Array = NDArray[np.float64]
Candidate = tuple[int, int]  # the number of a group, and that of a course in time
CHUNK = 10_000_000  # numbers that are drawn at once
ROUNDING = 1e-7  # of a direction that no log shows, from the square root of its information
ALONE = 1e-8  # a direction with less information of its own, as a share, is that of what is already known


@dataclass(frozen=True, eq=False)
class Ratios:
    """The logs of a robot as rows with independent errors of variance one, and the changes that are tried on them.

    ``rows`` (K, b, b) are the base parameters' columns, ``value`` (K, b) the left side; ``columns`` (K, b, M) those of
    the groups' directions, ``parts`` which are whose; ``courses`` (S, K): how much of a change each log has. ``turns``
    (K, b, b) make rows of errors that are standardised in the order of the parameters, as those of other logs are.
    ``dof``: degrees of freedom of the scatter that has made variances one.
    """

    rows: Array
    value: Array
    columns: Array
    parts: tuple[slice, ...]
    courses: Array
    turns: Array
    dof: float

    __repr__ = brief

    @classmethod
    def of(cls, history: History, groups: Sequence[Group], parts: Components, courses: Array, dof: float) -> Ratios:
        """Return those of a robot's logs with the scatter of its fleet."""
        one = measured(history.value, history.information)
        b = history.value.shape[1]
        L = np.linalg.cholesky(parts.inflation * np.eye(b) + one.factor @ parts.covariance @ one.factor.swapaxes(1, 2))
        rows, value = np.linalg.solve(L, one.factor), np.linalg.solve(L, one.value[:, :, None])[:, :, 0]
        ends = np.cumsum([0, *(group.directions.shape[1] for group in groups)])
        directions = np.hstack([np.zeros((b, 0)), *(group.directions for group in groups)])
        places = tuple(slice(*ends[k : k + 2]) for k in range(len(groups)))
        columns, most = rows @ directions, np.abs(rows) @ np.abs(directions)
        columns[:, :, np.linalg.norm(columns, axis=(0, 1)) <= ROUNDING * np.linalg.norm(most, axis=(0, 1))] = 0.0
        return cls(rows, value, columns, places, courses, _turns(rows), dof)

    def clearest(
        self, taken: Sequence[Candidate], rng: np.random.Generator, draws: int, pool: Array | None = None
    ) -> tuple[Candidate | None, float]:
        """Return the change with the least tail probability beside those taken, and its p-value among all candidates.

        None where no candidate is left. The p-value is the share of draws without a further change whose least tail
        probability is no larger, counting the data as one of them. Errors are drawn from a normal distribution, or from
        those of a ``pool`` (L, b) of logs (``left``).
        """
        known, many = self._known(taken), max(1, CHUNK // self.value.size)
        shown, best = self._evidence(known, self.value[None], np.ones((1, len(self.parts))))
        least = []
        for start in range(0, draws, many):
            count = min(many, draws - start)
            noise = rng.standard_normal((count, *self.value.shape)) if pool is None else self._drawn(rng, count, pool)
            least.append(self._evidence(known, noise, self._heavy(rng, count))[0])
        chance = float((1 + (np.concatenate(least) >= shown[0]).sum()) / (draws + 1))
        return (best, chance) if best else (None, 1.0)

    def left(self, taken: Sequence[Candidate]) -> Array:
        """Return the standardised errors (K, b) of the logs beside the changes taken, of variance one on average."""
        Q = self._known(taken).reshape(self.value.size, -1)
        flat = self.value.ravel()
        rows = (flat - Q @ (Q.T @ flat)).reshape(self.value.shape)
        shown = int(np.count_nonzero(self.rows.any(axis=2)))
        return np.asarray(np.einsum("kij,ki->kj", self.turns, rows) * np.sqrt(shown / max(shown - Q.shape[1], 1)))

    def _drawn(self, rng: np.random.Generator, draws: int, pool: Array) -> Array:
        """Return rows of errors (N, K, b), each log's those of one of the pool, with a sign by chance."""
        logs = len(self.value)
        some = pool[rng.integers(len(pool), size=(logs, draws))] * rng.choice([-1.0, 1.0], size=(logs, draws, 1))
        return np.asarray((some @ self.turns.swapaxes(1, 2)).swapaxes(0, 1))

    def _heavy(self, rng: np.random.Generator, draws: int) -> Array:
        """Return factors (N, groups) on the gains, as of variances that were estimated: F instead of chi-square."""
        sizes = np.array([part.stop - part.start for part in self.parts])
        dof = np.maximum(self.dof - sizes + 1, 1.0)
        return np.asarray(dof / rng.chisquare(dof, (draws, len(sizes))))

    def _evidence(self, known: Array, values: Array, heavy: Array) -> tuple[Array, Candidate | None]:
        """Return the evidence (N) of the clearest change in values (N, K, b), and which it is in the first of them."""
        scores, top, best = self._scores(known, values), np.full(len(values), -np.inf), None
        for g, part in enumerate(self.parts):
            gains, rank = self._gains(known, scores, part)
            for r in np.unique(rank[rank > 0]):
                some = np.flatnonzero(rank == r)
                shown = evidence(gains[some].max(axis=0) * heavy[:, g], int(r))
                if shown[0] > top[0]:
                    best = g, int(some[np.argmax(gains[some, 0])])
                top = np.maximum(top, shown)
        return top, best

    def refined(self, taken: Sequence[Candidate]) -> list[Candidate]:
        """Return the same changes, each with the course that fits best beside the others."""
        now = list(taken)
        for k, (g, _) in enumerate(taken):
            now[k] = g, int(np.argmax(self.profile(now, k)))
        return now

    def profile(self, taken: Sequence[Candidate], k: int) -> Array:
        """Return twice the log-likelihood (S) of the k-th change by its course, beside the others.

        It is minus infinity where the logs then show less of the change than with another course.
        """
        known = self._known([one for j, one in enumerate(taken) if j != k])
        gains, rank = self._gains(known, self._scores(known, self.value[None]), self.parts[taken[k][0]])
        return np.where(rank == rank.max(), gains[:, 0], -np.inf)

    def fit(self, taken: Sequence[Candidate]) -> list[tuple[Array, Array]]:
        """Return for each change its size (k) and standard error (k), infinite where the logs do not show it."""
        X = self._design(taken)
        scale = np.linalg.norm(X, axis=0)
        X, scale = X / np.where(scale > 0, scale, 1.0), np.where(scale > 0, scale, 1.0)
        information = X.T @ X
        covariance = pseudo_inverse(information)
        shown = np.abs(np.diag(covariance @ information) - 1) < 1e-6
        size = covariance @ (X.T @ self.value.ravel()) / scale
        std = np.where(shown, np.sqrt(np.diag(covariance)) / scale, np.inf)
        found, end = [], self.value.shape[1]
        for g, _ in taken:
            start, end = end, end + self.parts[g].stop - self.parts[g].start
            found.append((size[start:end], std[start:end]))
        return found

    def _design(self, taken: Sequence[Candidate]) -> Array:
        """Return the columns (K b, q) of the base parameters and of the changes taken."""
        changed = [self.courses[s][:, None, None] * self.columns[:, :, self.parts[g]] for g, s in taken]
        return np.concatenate([self.rows, *changed], axis=2).reshape(self.value.size, -1)

    def _known(self, taken: Sequence[Candidate]) -> Array:
        """Return an orthonormal basis (K, b, q) of what is known: the base parameters and the changes taken."""
        X = self._design(taken)
        scale = np.linalg.norm(X, axis=0)
        U, s, _ = np.linalg.svd(X / np.where(scale > 0, scale, 1.0), full_matrices=False)
        return np.asarray(U[:, s > 1e-6 * s[0]].reshape(*self.value.shape, -1))

    def _scores(self, known: Array, values: Array) -> Array:
        """Return (S, N, M) the products of the groups' columns with what the known leaves of values (N, K, b)."""
        flat, Q = values.reshape(len(values), -1), known.reshape(-1, known.shape[2])
        left = (flat - (flat @ Q) @ Q.T).reshape(values.shape)
        return np.tensordot(self.courses, left.swapaxes(0, 1) @ self.columns, axes=1)

    def _gains(self, known: Array, scores: Array, part: slice) -> tuple[Array, NDArray[np.intp]]:
        """Return twice the log-likelihood ratios (S, N) of one group by course, and their ranks (S)."""
        X = self.columns[:, :, part]
        shared = np.tensordot(self.courses, known.swapaxes(1, 2) @ X, axes=1)
        whole = np.tensordot(self.courses**2, X.swapaxes(1, 2) @ X, axes=1)
        scale = np.sqrt(np.einsum("sii->si", whole))
        scale = np.where(scale > 0, scale, 1.0)
        roots, vectors = np.linalg.eigh(
            (whole - shared.swapaxes(1, 2) @ shared) / (scale[:, :, None] * scale[:, None, :])
        )
        alone = roots > ALONE
        half = vectors * np.where(alone, 1 / np.sqrt(np.where(alone, roots, 1.0)), 0.0)[:, None, :]
        gains = ((scores[:, :, part] @ (half / scale[:, :, None])) ** 2).sum(axis=2)
        return gains, alone.sum(axis=1)


def _turns(rows: Array) -> Array:
    """Return the isometries (K, b, b) from standardised errors to rows: these are R W^-1/2 of W = R' R, in scaled
    parameters, with the symmetric root, which mixes parameters least."""
    scale = np.linalg.norm(rows, axis=1)
    R = rows / np.where(scale > 0, scale, 1.0)[:, None, :]
    U, s, Vt = np.linalg.svd(R)
    shown = s > 1e-6 * s[:, :1]
    return np.asarray(U @ (shown[:, :, None] * Vt))


def evidence(gain: Array, rank: int) -> Array:
    """Return minus the logarithm of the tail probability of chi-square with ``rank`` degrees of freedom at gain (N).

    Of large gains, whose probability underflows, by the first terms of its asymptotic series.
    """
    from scipy.special import gammaincc, gammaln

    a, x = 0.5 * rank, 0.5 * np.asarray(gain)
    tail = gammaincc(a, x)
    large = tail < 1e-280
    far = np.where(large, x, 1.0)
    series = far - (a - 1) * np.log(far) + gammaln(a) - np.log1p((a - 1) / far)
    return np.asarray(np.where(large, series, -np.log(np.where(large, 1.0, tail))))
