"""The noise of a residual: an autoregression for each joint, and the covariance of the innovations of all.

``HausmanTest`` tells by simulations of that noise whether it explains what whitening moved the parameters by.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.estimators.least_squares import LinearFit
from dynident.regression import EntryBlock, Rank, Regression, Whitening, is_stable, join_blocks, preceding_counts
from dynident.runtime import Noun, Step, report_progress
from dynident.runtime.arrays import Array

Mask = NDArray[np.bool_]
MAX_CORRELATION_LAG = 50  # samples over which a whitened residual should not be correlated
MIN_SIGNIFICANCE = 5.0  # standard errors of a correlation: by chance in none of some hundred lags
ROWS_PER_COEFFICIENT = 10  # of the data for each coefficient
MIN_EIGENVALUE = 1e-6  # smallest eigenvalue of a correlation matrix
DRAWS = 99  # of which none is as far apart in one of a hundred fits, where the residual is noise
MAX_NUMBERS = 1 << 23  # numbers of noise that are drawn together


class ResidualSeries(Noun):
    """A number of each joint at each row, ``values`` (n, N), where it ``is_used`` (n, N).

    ``age`` (n, N) counts the used rows directly before each row.
    """

    values: Array
    is_used: Mask
    age: NDArray[np.int_]

    def correlations(self, j: int) -> Array:
        """Return the correlation of one joint's values at lags 1 ... MAX_CORRELATION_LAG, zero where not
        significant."""
        x, age = self.values[j], self.age[j] * self.is_used[j]
        square, correlations = float(x @ x) / max(int(self.is_used[j].sum()), 1), np.zeros(MAX_CORRELATION_LAG)
        for lag in range(1, min(MAX_CORRELATION_LAG, len(x) - 1) + 1):
            pairs = age[lag:] >= lag
            count = int(pairs.sum())
            r = float(x[lag:][pairs] @ x[:-lag][pairs]) / max(count * square, 1e-300)
            correlations[lag - 1] = r if abs(r) * np.sqrt(count) > MIN_SIGNIFICANCE else 0.0
        return correlations


class Residuals(Noun):
    """The torque residuals of some parameters in each uninterrupted stretch of rows.

    A joint whose deviation is at most its ``floor`` (n) has nothing but rounding.
    """

    stretches: tuple[EntryBlock, ...]
    floor: Array

    @classmethod
    def of(cls, regression: Regression, theta: Array, floor: Array) -> Residuals:
        """Return the residuals of a regression at theta (p)."""
        none, end = regression.model.structure_with(()), None
        stretches: list[list[EntryBlock]] = []
        # blocks that follow each other without a gap belong to one stretch
        for k, rows, e, keep in regression.residuals(theta):
            stretches += [] if end == (k, rows.start) else [[]]
            stretches[-1].append(EntryBlock(none, np.zeros((0, len(e))), e.T, None if keep is None else keep.T))
            end = k, rows.stop
        return cls(tuple(map(join_blocks, stretches)), floor)

    def innovations(self, whitening: Whitening) -> ResidualSeries:
        """Return the innovations of autoregressions, not yet mixed."""
        innovations = [np.concatenate(whitening.innovations(stretch)) for stretch in self.stretches]
        return ResidualSeries(np.concatenate(innovations, axis=1), self._is_used, self._age)

    def noise(self, max_order: int, rank: int, orders: Sequence[int] | None = None) -> Whitening:
        """Return the noise: autoregressions, and the covariance of their innovations.

        The orders are at most ``max_order``, or those given by ``orders`` (n). ``rank`` is the number of fitted
        parameters.
        """
        n = len(self.floor)
        series = ResidualSeries(
            np.concatenate([stretch.tau * stretch.used for stretch in self.stretches], axis=1),
            self._is_used,
            self._age,
        )
        coefficients = tuple(
            np.zeros(0) if series.values[j].std() <= self.floor[j]
            else autoregression(series, j, max_order, None if orders is None else orders[j])
            for j in range(n)
        )  # fmt: skip
        innovations = (
            self.innovations(Whitening(coefficients, np.eye(n))).values
            if any(map(len, coefficients))
            else series.values
        )
        # joints are correlated only where both have a usable row
        usable = self._is_used.astype(float)
        pairs = usable @ usable.T
        variance = np.maximum(np.square(innovations).sum(axis=1) / np.maximum(np.diag(pairs), 1.0), self.floor**2)
        scale = np.sqrt(variance)
        correlation = (innovations @ innovations.T) / np.maximum(pairs, 1.0) / np.outer(scale, scale)
        correlation = shrink_correlation(np.clip(correlation, -1.0, 1.0), pairs - rank / n)
        return Whitening(coefficients, correlation * np.outer(scale, scale))

    @cached_property
    def _is_used(self) -> Mask:
        return np.concatenate([stretch.used for stretch in self.stretches], axis=1)

    @cached_property
    def _age(self) -> NDArray[np.int_]:
        return np.concatenate(
            [np.stack([preceding_counts(x) for x in stretch.used]) for stretch in self.stretches], axis=1
        )


def autoregression(series: ResidualSeries, j: int, max_order: int, order: int | None = None) -> Array:
    """Return the coefficients (m) of the autoregression of one joint, by Burg's method over all stretches.

    The order is the one with the least Bayesian information criterion N log s^2 + m log N (Schwarz, 1978), of
    those up to ``max_order`` and a tenth of the rows; or ``order``; a lower one where rounding would make it
    unstable. Burg (1975), "Maximum entropy spectral analysis".
    """
    used, age = series.is_used[j], series.age[j]
    rows = int(used.sum())
    forward = backward = series.values[j]
    a, error, candidates = np.zeros(0), 0.0, [np.zeros(0)]
    criteria, limit = [0.0], 1.0 - 1.0 / max(rows, 2)
    # Burg's recursion: each order adds one reflection coefficient, which minimises both prediction errors
    for m in range(1, min(max_order if order is None else order, rows // ROWS_PER_COEFFICIENT) + 1):
        before = np.concatenate([[0.0], backward[:-1]])
        pairs = used & (age >= m)
        f, b = forward[pairs], before[pairs]
        size = float(f @ f + b @ b)
        if size <= 0:
            break
        reflection = float(np.clip(2.0 * (f @ b) / size, -limit, limit))
        a = np.append(a - reflection * a[::-1], reflection)
        forward, backward = forward - reflection * before, before - reflection * forward
        error += rows * np.log(1.0 - reflection**2)
        candidates.append(a)
        criteria.append(error + m * np.log(rows))
    # take the order of least criterion, or the next lower one that is stable
    best = len(candidates) - 1 if order is not None else int(np.argmin(criteria))
    return next(coefficients for coefficients in reversed(candidates[: best + 1]) if is_stable(coefficients))


def shrink_correlation(correlation: Array, pairs: Array) -> Array:
    """Return a correlation matrix (n, n), estimated from so many ``pairs`` (n, n), shrunk to the identity.

    It is shrunk by the share of its entries that is chance (Schaefer and Strimmer, 2005), by at least n over the
    pairs, and until it is positive definite. It is the identity where the Bayesian information criterion, N log
    det + log N n (n - 1) / 2, is positive.
    """
    n = len(correlation)
    off_diagonal = ~np.eye(n, dtype=bool)
    correlations, count = correlation[off_diagonal], np.maximum(pairs[off_diagonal], 1.0)
    min_count, squares = float(count.min(initial=np.inf)), float(np.sum(correlations**2))
    # keep the correlations only where the likelihood gains more than their number costs
    spread = float(np.log(np.maximum(np.linalg.eigvalsh(correlation), MIN_EIGENVALUE)).sum())
    if squares == 0.0 or min_count * spread + np.log(min_count) * n * (n - 1) / 2 > 0:
        return np.eye(n)
    share = max(float(np.sum((1.0 - correlations**2) ** 2 / count)) / squares, n / min_count)
    smallest = float(np.linalg.eigvalsh(correlation)[0])
    # shrink at least until the matrix is safely positive definite
    share = min(max(share, (MIN_EIGENVALUE - smallest) / (1.0 - smallest)), 1.0)
    return np.asarray(np.where(off_diagonal, (1.0 - share) * correlation, 1.0))


class HausmanTest(Noun):
    """Least squares of the ``plain`` rows of a regression, reduced to the ``fit``, with weights by joint.

    The distance of parameters is the weighted sum of squares of the torque between them, |X (a - b)|^2.
    """

    plain: Regression
    fit: LinearFit

    def distance(self, change: Array) -> Array:
        """Return the distance of parameters that differ by ``change`` (p, k)."""
        return np.asarray(np.square(self.fit.factor[:-1, :-1] @ change).sum(axis=0))

    def is_chance(self, change: Array, noise: Whitening, rank: Rank) -> bool:
        """Return whether a fit to whitened rows may differ from least squares by ``change`` (p) by chance.

        The rows are whitened by ``noise``, and the fit has this ``rank``. It is chance where one of 99 simulations
        differs as much.
        """
        white, limit = replace(self.plain, whitening=noise), self.distance(change[:, None])[0]
        count, rng = 0, np.random.default_rng(0)  # a fit is the same whenever it is made
        size = sum(motion.q.size for motion in self.plain.motions)
        while count < DRAWS:
            report_progress(Step("simulating the noise", count, DRAWS))
            # both fits are linear in the torque: the noise alone gives the difference of their errors
            draws = min(max(MAX_NUMBERS // size, 1), DRAWS - count)
            noise_draws = self._draw_noise(noise, draws, rng)
            products = self.plain.weighted_products(noise_draws, self.fit.weights, filtered=True)
            unwhitened = self.fit.directions.inverse @ products
            whitened = rank.inverse @ white.weighted_products(noise_draws, filtered=True)
            if (self.distance(whitened - unwhitened) >= limit).any():
                return True
            count += draws
        return False

    def _draw_noise(self, noise: Whitening, count: int, rng: np.random.Generator) -> list[Array]:
        """Return noise (N, n, k) for each motion, where it has rows."""
        draws = [np.zeros((*motion.q.shape, count)) for motion in self.plain.motions]
        series = self._noise_series(noise, count, rng)
        at = 0
        for k, rows, length in self._rows:
            draws[k][rows] = series[at : at + length]
            at += length
        return draws

    def _noise_series(self, noise: Whitening, count: int, rng: np.random.Generator) -> Array:
        """Return noise (N, n, k) of as many consecutive rows as there are, after a run-in of the same length."""
        from scipy.signal import lfilter  # seldom needed

        # the autoregression starts from zero: as many rows again are drawn first and dropped
        total = sum(length for _, _, length in self._rows)
        root = np.linalg.cholesky(noise.covariance)
        out = np.einsum("ij,tjk->tik", root, rng.standard_normal((2 * total, len(root), count)))
        for j, coefficients in enumerate(noise.coefficients):
            out[:, j] = lfilter([1.0], np.append(1.0, -coefficients), out[:, j], axis=0)
        return np.asarray(out[total:])

    @cached_property
    def _rows(self) -> list[tuple[int, slice, int]]:
        """The index of the motion, the samples, and the number of rows of each block."""
        blocks = self.plain.placed_blocks(self.plain.model.structure_with(()))
        return [(k, rows, block.tau.shape[1]) for k, rows, block in blocks]
