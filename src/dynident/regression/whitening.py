"""Whitening: rows whose noise is coloured in time and correlated between joints, made independent and of unit variance.

The noise of joint j is an autoregression e_t = a_1 e_(t-1) + ... + a_m e_(t-m) + u_t, and the innovations u_t of all
joints have a covariance S. Rows, torque and regressor alike, go through the same filter and the same mixing U^-1 with
S = U U', U upper triangular: row j is then the innovation of joint j less what those of the joints after it tell of it,
so that it has few columns more than before (Aitken's generalised least squares).

Every uninterrupted stretch of rows of a joint starts anew, exactly: its first m rows have the best predictors from the
rows that there are (Durbin and Levinson), and are scaled to the variance of an innovation. Of innovations of several
joints at such a row the covariance S is kept, which is exact where their coefficients are the same. Where rows of some
joints are missing, those that are there are mixed by their part of S.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError, brief
from dynident.models import Structure
from dynident.models.structure import independent
from dynident.regression.triangular import EntryBlock

__all__ = ["Placed", "Whitening", "ages", "is_stable", "joined", "whitened"]

Array = NDArray[np.float64]
Placed = tuple[int, slice, EntryBlock]  # rows, with the place of their motion and their samples in it
SPARE = 30  # random rows beyond the number of columns that they are to tell apart


@dataclass(frozen=True, eq=False)
class Whitening:
    """A noise model: ``coefficients`` a (m_j) of the autoregression of each joint, and ``covariance`` S (n, n) of the
    innovations, (N m)^2 or N^2.

    Raises ConfigError where an autoregression is not stable, or the covariance not positive definite.
    """

    coefficients: tuple[Array, ...]
    covariance: Array

    __repr__ = brief

    def __post_init__(self) -> None:
        n = len(self.coefficients)
        if self.covariance.shape != (n, n) or not np.allclose(self.covariance, self.covariance.T, rtol=1e-9):
            raise ConfigError(f"covariance of the noise is no symmetric matrix of the {n} joints.")
        if not (np.isfinite(self.covariance).all() and np.linalg.eigvalsh(self._correlation)[0] > 0):
            raise ConfigError("covariance of the noise: is not positive definite.")
        for j, one in enumerate(self.coefficients):
            if not is_stable(one):
                raise ConfigError(f"coefficients of the noise of joint {j + 1}: the autoregression is not stable.")

    @property
    def _correlation(self) -> Array:
        deviation = np.sqrt(np.diag(self.covariance))
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(np.nan_to_num(self.covariance / np.outer(deviation, deviation)))

    @property
    def orders(self) -> tuple[int, ...]:
        """The order of the autoregression of each joint."""
        return tuple(map(len, self.coefficients))

    @property
    def span(self) -> int:
        """The number of rows before a row that count in it."""
        return max(self.orders, default=0)

    @cached_property
    def mixes(self) -> bool:
        """Whether innovations of the joints are correlated."""
        return bool((self.covariance[~np.eye(len(self.covariance), dtype=bool)] != 0).any())

    @cached_property
    def predictors(self) -> tuple[tuple[tuple[Array, float], ...], ...]:
        """For each joint the coefficients (k) of the best predictor from k rows, k = 0 ... m, and by what its error is
        multiplied to have the variance of an innovation (zero where the autoregression is not stable)."""
        return tuple(map(_predictors, self.coefficients))

    def structure(self, plain: Structure) -> Structure:
        """Return the structure of the rows that are made of those with a ``plain`` structure."""
        if not self.mixes:
            return plain
        found = [_spanned(np.concatenate(plain.maps[j:])) for j in range(len(plain.maps))]
        return Structure(tuple(columns for columns, _ in found), tuple(maps for _, maps in found))

    def innovations(self, block: EntryBlock, lead: int = 0) -> list[Array]:
        """Return for each joint the innovations (b_j + 1, B) of [Y_j | tau_j]', zero where they are not to be used; the
        first ``lead`` rows of the block only count in the others."""
        return [self._prewhitened(j, block, lead) for j in range(len(self.coefficients))]

    def rows(self, block: EntryBlock, mixed: Structure, lead: int = 0) -> EntryBlock:
        """Return the whitened rows of a block, which have the structure ``mixed``."""
        series = self.innovations(block, lead)
        keep = None if block.keep is None else block.keep[:, lead:]
        if not self.mixes:
            series = [one / s for one, s in zip(series, np.sqrt(np.diag(self.covariance)), strict=True)]
            entries, tau = np.concatenate([one[:-1] for one in series]), np.stack([one[-1] for one in series])
            return EntryBlock(mixed, entries, tau, keep)
        w, plain = self._mixing(keep), block.structure
        entries, tau = np.zeros((len(mixed.joint), series[0].shape[1])), np.zeros((len(series), series[0].shape[1]))
        for j, (part, columns) in enumerate(zip(mixed.parts, mixed.columns, strict=True)):
            for k in range(j, len(series)):
                own = w[j, k] * series[k]
                entries[part] += plain.maps[k][:, columns].T @ own[:-1]
                tau[j] += own[-1]
        return EntryBlock(mixed, entries, tau, keep)

    def _prewhitened(self, j: int, block: EntryBlock, lead: int) -> Array:
        x, a = block.used(j), self.coefficients[j]
        if not len(a):
            return x[:, lead:]
        kernel, present = np.append(1.0, -a), _present(block, j)
        y = np.stack([np.convolve(row, kernel)[lead : len(row)] for row in x]) * present[lead:]
        age = ages(present)
        young = lead + np.flatnonzero(present[lead:] & (age[lead:] < len(a)))
        for k in np.unique(age[young]):
            at, (known, scale) = young[age[young] == k], self.predictors[j][k]
            past = at - 1 - np.arange(k)[:, None]
            y[:, at - lead] = scale * (x[:, at] - np.einsum("k,rkt->rt", known, x[:, past]))
        return y

    def _mixing(self, keep: NDArray[np.bool_] | None) -> Array:
        """Return what the innovations of each joint count in each row: (n, n, B), or (n, n, 1) for all rows."""
        if keep is None or keep.all():
            return _unmixed(self.covariance)[:, :, None]
        patterns, which = np.unique(keep, axis=1, return_inverse=True)
        found = np.zeros((*self.covariance.shape, patterns.shape[1]))
        for i, present in enumerate(patterns.T):
            some = np.flatnonzero(present)
            found[some[:, None], some, i] = _unmixed(self.covariance[np.ix_(some, some)])
        return found[:, :, which.ravel()]


def whitened(blocks: Iterable[Placed], whitening: Whitening, mixed: Structure, first: int = 0) -> Iterator[Placed]:
    """Yield the whitened rows of blocks that follow each other, those of samples before ``first`` left out.

    Of a block only the last rows are held, as many as count in the next.
    """
    before: tuple[int, slice, EntryBlock] | None = None
    for k, kept, block in blocks:
        follows = before is not None and before[:2] == (k, kept.start)
        whole = joined([before[2], block]) if before is not None and follows else block
        lead = whole.tau.shape[1] - block.tau.shape[1]
        early = len(range(kept.start, min(first, kept.stop), kept.step or 1))
        if early < block.tau.shape[1]:
            start = kept.start + early * (kept.step or 1)
            yield k, slice(start, kept.stop, kept.step), whitening.rows(whole, mixed, lead + early)
        before = k, kept.stop, _last(whole, whitening.span)


def joined(blocks: list[EntryBlock]) -> EntryBlock:
    """Return blocks of one structure that follow each other as one."""
    if len(blocks) == 1:
        return blocks[0]
    some = any(one.keep is not None for one in blocks)
    keep = [np.ones(one.tau.shape, dtype=bool) if one.keep is None else one.keep for one in blocks]
    entries, tau = (np.concatenate([getattr(one, x) for one in blocks], axis=1) for x in ("entries", "tau"))
    return EntryBlock(blocks[0].structure, entries, tau, np.concatenate(keep, axis=1) if some else None)


def ages(present: NDArray[np.bool_]) -> NDArray[np.int_]:
    """Return how many rows (B) directly before each are present."""
    index = np.arange(len(present))
    gap = np.maximum.accumulate(np.where(present, -1, index))
    return np.asarray(index - 1 - np.concatenate([[-1], gap[:-1]])) if len(index) else index


def is_stable(a: Array) -> bool:
    """Return whether an autoregression with the coefficients a (m) is stable, to working precision."""
    return all(np.isfinite(scale) and scale > 0 for _, scale in _predictors(a))


def _last(block: EntryBlock, rows: int) -> EntryBlock:
    few = slice(max(block.tau.shape[1] - rows, 0), None)
    keep = None if block.keep is None else block.keep[:, few]
    return EntryBlock(block.structure, block.entries[:, few], block.tau[:, few], keep)


def _present(block: EntryBlock, j: int) -> NDArray[np.bool_]:
    return np.ones(block.tau.shape[1], dtype=bool) if block.keep is None else block.keep[j]


def _predictors(a: Array) -> tuple[tuple[Array, float], ...]:
    """Return the predictors from 0 ... m rows with their scales, by Levinson's recursion backwards."""
    found, scale = [(np.asarray(a, dtype=float), 1.0)], 1.0
    while len(known := found[-1][0]):
        own, rest = known[-1], known[:-1]
        scale *= np.sqrt(max(1.0 - own**2, 0.0))
        found.append((np.zeros_like(rest) if scale == 0 else (rest + own * rest[::-1]) / (1.0 - own**2), float(scale)))
    return tuple(reversed(found))


def _unmixed(S: Array) -> Array:
    """Return the inverse of the upper triangular U with U U' = S (n, n)."""
    if not len(S):
        return S
    lower = np.linalg.inv(np.linalg.cholesky(S[::-1, ::-1]))
    return np.asarray(np.tril(lower)[::-1, ::-1])


def _spanned(maps: Array) -> tuple[NDArray[np.intp], Array]:
    """Return independent columns (b) of the rows ``maps`` (m, p), and what makes all of them (b, p)."""
    used = np.flatnonzero(maps.any(axis=0))
    if not len(used):
        return used, np.zeros((0, maps.shape[1]))
    random = np.random.default_rng(0).standard_normal((2 * len(used) + SPARE, len(maps)))
    X = random @ maps[:, used]
    scale = np.sqrt(np.square(X).mean(axis=0))
    some, K = independent(X / scale)
    whole = np.zeros((len(some), maps.shape[1]))
    whole[:, used] = K * scale / scale[some, None]
    return used[some], whole
