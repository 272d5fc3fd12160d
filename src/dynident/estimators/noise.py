"""The noise in a residual: an autoregression of each joint, and the covariance of the innovations of all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.regression import EntryBlock, Regression, Whitening, ages, is_stable, joined

__all__ = ["Residuals", "Series", "autoregression", "shrunk"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
LAGS = 50  # samples over which a whitened residual should not be correlated
SIGNIFICANT = 5.0  # standard errors of a correlation: by chance in none of some hundred lags
ROWS = 10  # of the data for each coefficient
LEAST = 1e-6  # smallest eigenvalue of a correlation matrix


@dataclass(frozen=True, eq=False)
class Series:
    """A number of each joint at each row, ``values`` (n, N), where it is ``used`` (n, N), and how many rows directly
    before it are, too: its ``age`` (n, N)."""

    values: Array
    used: Mask
    age: NDArray[np.int_]

    __repr__ = brief

    def correlations(self, j: int) -> Array:
        """Return the correlation of one joint's values at 1 ... LAGS rows, zero where it is not significant."""
        x, age = self.values[j], self.age[j] * self.used[j]
        square, found = float(x @ x) / max(int(self.used[j].sum()), 1), np.zeros(LAGS)
        for lag in range(1, min(LAGS, len(x) - 1) + 1):
            pairs = age[lag:] >= lag
            count = int(pairs.sum())
            r = float(x[lag:][pairs] @ x[:-lag][pairs]) / max(count * square, 1e-300)
            found[lag - 1] = r if abs(r) * np.sqrt(count) > SIGNIFICANT else 0.0
        return found


@dataclass(frozen=True, eq=False)
class Residuals:
    """What parameters leave of the torque in each uninterrupted stretch of rows; a joint whose deviation is at most its
    ``floor`` (n) has rounding alone."""

    stretches: tuple[EntryBlock, ...]
    floor: Array

    __repr__ = brief

    @classmethod
    def of(cls, regression: Regression, theta: Array, floor: Array) -> Residuals:
        """Return what theta (p) leaves of a regression."""
        none, end = regression.model.structure_with(()), None
        found: list[list[EntryBlock]] = []
        for k, rows, e, keep in regression.residuals(theta):
            found += [] if end == (k, rows.start) else [[]]
            found[-1].append(EntryBlock(none, np.zeros((0, len(e))), e.T, None if keep is None else keep.T))
            end = k, rows.stop
        return cls(tuple(map(joined, found)), floor)

    def innovations(self, whitening: Whitening) -> Series:
        """Return the innovations of autoregressions, not yet mixed."""
        found = [np.concatenate(whitening.innovations(one)) for one in self.stretches]
        return Series(np.concatenate(found, axis=1), self._used, self._age)

    def noise(self, most: int, rank: int, orders: Sequence[int] | None = None) -> Whitening:
        """Return the noise: autoregressions of at most the order ``most``, or of the ``orders`` (n), and the covariance
        of innovations of a fit of so many parameters (``rank``)."""
        n = len(self.floor)
        plain = Series(np.concatenate([one.tau * _kept(one) for one in self.stretches], axis=1), self._used, self._age)
        coefficients = tuple(
            np.zeros(0) if plain.values[j].std() <= self.floor[j]
            else autoregression(plain, j, most, None if orders is None else orders[j])
            for j in range(n)
        )  # fmt: skip
        u = self.innovations(Whitening(coefficients, np.eye(n))).values if any(map(len, coefficients)) else plain.values
        used = self._used.astype(float)
        pairs = used @ used.T
        variance = np.maximum(np.square(u).sum(axis=1) / np.maximum(np.diag(pairs), 1.0), self.floor**2)
        scale = np.sqrt(variance)
        correlation = (u @ u.T) / np.maximum(pairs, 1.0) / np.outer(scale, scale)
        correlation = shrunk(np.clip(correlation, -1.0, 1.0), pairs - rank / n)
        return Whitening(coefficients, correlation * np.outer(scale, scale))

    @cached_property
    def _used(self) -> Mask:
        return np.concatenate([_kept(one) for one in self.stretches], axis=1)

    @cached_property
    def _age(self) -> NDArray[np.int_]:
        return np.concatenate([np.stack([ages(x) for x in _kept(one)]) for one in self.stretches], axis=1)


def autoregression(series: Series, j: int, most: int, order: int | None = None) -> Array:
    """Return the coefficients (m) of the autoregression of one joint, by Burg's method over all stretches.

    The order is the one with the least Bayesian information criterion N log s^2 + m log N (Schwarz, 1978), of those up
    to ``most`` and a tenth of the rows; or ``order``; a lower one where rounding would make it unstable. Burg (1975),
    "Maximum entropy spectral analysis".
    """
    used, age = series.used[j], series.age[j]
    rows = int(used.sum())
    forward = backward = series.values[j]
    a, error, found = np.zeros(0), 0.0, [np.zeros(0)]
    criteria, limit = [0.0], 1.0 - 1.0 / max(rows, 2)
    for m in range(1, min(most if order is None else order, rows // ROWS) + 1):
        before = np.concatenate([[0.0], backward[:-1]])
        pairs = used & (age >= m)
        f, b = forward[pairs], before[pairs]
        size = float(f @ f + b @ b)
        if size <= 0:
            break
        own = float(np.clip(2.0 * (f @ b) / size, -limit, limit))
        a = np.append(a - own * a[::-1], own)
        forward, backward = forward - own * before, before - own * forward
        error += rows * np.log(1.0 - own**2)
        found.append(a)
        criteria.append(error + m * np.log(rows))
    best = len(found) - 1 if order is not None else int(np.argmin(criteria))
    return next(one for one in reversed(found[: best + 1]) if is_stable(one))


def shrunk(correlation: Array, pairs: Array) -> Array:
    """Return a correlation matrix (n, n) of so many ``pairs`` (n, n), drawn to the identity by as much as its entries
    are chance (Schaefer and Strimmer, 2005), by n over the pairs at least, and until it is positive definite. It is the
    identity where the Bayesian information criterion, N log det + log N n (n - 1) / 2, is positive."""
    n = len(correlation)
    off = ~np.eye(n, dtype=bool)
    r, count = correlation[off], np.maximum(pairs[off], 1.0)
    few, squares = float(count.min(initial=np.inf)), float(np.sum(r**2))
    spread = float(np.log(np.maximum(np.linalg.eigvalsh(correlation), LEAST)).sum())
    if squares == 0.0 or few * spread + np.log(few) * n * (n - 1) / 2 > 0:
        return np.eye(n)
    share = max(float(np.sum((1.0 - r**2) ** 2 / count)) / squares, n / few)
    least = float(np.linalg.eigvalsh(correlation)[0])
    share = min(max(share, (LEAST - least) / (1.0 - least)), 1.0)
    return np.asarray(np.where(off, (1.0 - share) * correlation, 1.0))


def _kept(block: EntryBlock) -> Mask:
    return np.ones(block.tau.shape, dtype=bool) if block.keep is None else block.keep
