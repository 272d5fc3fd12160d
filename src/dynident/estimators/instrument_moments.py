"""The covariance of a solution, from the long-run covariance of its scores W_t' D^2 e_t (Newey and West, 1987).

Where two passes of a motion are instruments of each other, the scores of both contain the product of both
errors: scores of paired samples are added before they count as a series.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from dynident.estimators.instruments import Instruments
from dynident.estimators.least_squares import LinearFit
from dynident.regression import Rank, Regression
from dynident.regression.whitening import bandwidth, bartlett
from dynident.runtime import InputError, Noun
from dynident.runtime.arrays import Array

# of the torque: a residual below is rounding; of a weighted row without any torque
MIN_RELATIVE_RESIDUAL, MIN_WEIGHTED_RESIDUAL = 1e-14, 1e-10
MIN_SINGULAR_VALUE = 1e-9  # relative singular value of W' X below which a direction has no instrument


class InstrumentStrength(Noun):
    """How much of the regressor the instruments explain in the direction where they explain least.

    ``correlation`` is the smallest canonical correlation r, ``statistic`` the F statistic N r^2 / (1 - r^2) of
    the first stage, and ``direction`` (p) that of the parameters.
    """

    correlation: float
    statistic: float
    direction: Array


class Moments(Noun):
    """Cross products of rows and instruments by joint, in the r columns of ``basis`` (p, r).

    ``cross_product`` = W_j' X_j, ``instruments`` = W_j' W_j and ``regressors`` = X_j' X_j (n, r, r);
    ``instrument_torque`` = W_j' y_j (n, r); ``torque_square`` (n) = y_j' y_j and ``regressor_torque`` (n, r) =
    X_j' y_j, from ``rows`` (n) of each joint, whose ``weights`` (n) are those in D.
    """

    basis: Array
    weights: Array
    cross_product: Array
    instruments: Array
    regressors: Array
    instrument_torque: Array
    regressor_torque: Array
    torque_square: Array
    rows: NDArray[np.int_]

    def total(self, per_joint: Array) -> Array:
        """Return the sum over the joints of w_j^2 times ``per_joint`` (n, ...)."""
        return np.asarray(np.tensordot(self.weights**2, per_joint, axes=1))

    @property
    def value(self) -> Array:
        """The solution theta (p) = basis (W' D^2 X)^-1 W' D^2 y, with no component along directions without
        instrument."""
        # least squares leaves out directions of the parameters that the instruments do not see
        solution = np.linalg.lstsq(
            self.total(self.cross_product), self.total(self.instrument_torque), rcond=MIN_SINGULAR_VALUE
        )[0]
        return np.asarray(self.basis @ solution, dtype=np.float64)

    def to_basis(self, value: Array) -> Array:
        """Return the coordinates beta (r) with basis beta = ``value`` (p)."""
        return np.asarray(np.linalg.lstsq(self.basis, value, rcond=None)[0])

    def white_covariance(self, beta: Array) -> Array:
        """Return the covariance (r, r) of W' D^2 e for white residuals e, of the size that beta (r) leaves."""
        return np.asarray(np.tensordot(self.weights**4 * self.residual(beta), self.instruments, axes=1))

    def distance(self, value: Array, reference: Array) -> float:
        """Return the distance of two values (p), as rms standard errors of a direction where residuals are white."""
        # in units of the errors that white residuals would give the moments
        beta, step = self.to_basis(value), self.to_basis(value - reference)
        errors = np.linalg.solve(
            regularised_cholesky(self.white_covariance(beta)), self.total(self.cross_product) @ step
        )
        return float(np.sqrt(np.mean(np.square(errors))))

    def change(self, value: Array, reference: Array) -> float:
        """Return the relative difference of the torque of two values (p)."""
        size = float(np.linalg.norm(self.to_basis(value)))
        return float(np.linalg.norm(self.to_basis(value - reference))) / size if size else 0.0

    def residual(self, beta: Array) -> Array:
        """Return the mean squared residual (n) of each joint at beta (r), not below rounding of the torque."""
        square_sum = (
            self.torque_square - 2 * self.regressor_torque @ beta + np.einsum("i,jik,k->j", beta, self.regressors, beta)
        )
        # exact data leave only rounding, which must not make an error zero
        floor = np.where(
            self.torque_square > 0,
            MIN_RELATIVE_RESIDUAL**2 * self.torque_square,
            (MIN_WEIGHTED_RESIDUAL / self.weights) ** 2,
        )
        return np.asarray(np.maximum(square_sum, floor) / np.maximum(self.rows, 1))

    def strength(self, samples: float) -> InstrumentStrength:
        """Return the strength of the instruments, given the number of independent ``samples``."""
        # canonical correlations are the singular values of the cross product between orthonormal columns
        instrument_root, regressor_root = (
            regularised_cholesky(self.total(product)) for product in (self.instruments, self.regressors)
        )
        _, correlations, axes = np.linalg.svd(
            np.linalg.solve(instrument_root, np.linalg.solve(regressor_root, self.total(self.cross_product).T).T)
        )
        correlation = float(np.clip(correlations[-1], 0.0, 1.0))
        direction = self.basis @ np.linalg.solve(regressor_root.T, axes[-1])
        return InstrumentStrength(
            correlation, samples * correlation**2 / max(1.0 - correlation**2, np.finfo(float).eps), direction
        )


def moments_of(rows: Regression, instruments: Regression, plain: LinearFit) -> Moments:
    """Return the moments of the ``rows`` with the regressor of other motions at the same samples.

    They are expressed in the directions that ``plain`` least squares determines, with its weights of the joints.
    Raises InputError where there are too few rows.
    """
    rank, weights = plain.directions, np.ones(len(rows.model.joints)) if plain.weights is None else plain.weights
    # in these directions the weighted regressor is orthonormal
    basis = rank.determined_directions / rank.values[: rank.rank]
    n, r = len(weights), basis.shape[1]
    cross_product, instrument_square, regressors = (np.zeros((n, r, r)) for _ in range(3))
    instrument_torque, regressor_torque = np.zeros((n, r)), np.zeros((n, r))
    torque_square, count = np.zeros(n), np.zeros(n, dtype=int)
    for block in moment_blocks(rows, instruments, basis):
        for j in range(n):
            x, w, y = block.X[:, j], block.W[:, j], block.y[:, j]
            cross_product[j] += w.T @ x
            instrument_square[j] += w.T @ w
            regressors[j] += x.T @ x
            instrument_torque[j] += w.T @ y
            regressor_torque[j] += x.T @ y
            torque_square[j] += y @ y
        count += block.keep.sum(axis=0)
    if count.sum() <= r:
        raise InputError(
            f"{', '.join(motion.source for motion in rows.motions)}: {count.max()} samples have instruments, too few "
            f"for {r} parameters; record longer or, where these are lagged, smooth less or give a shorter `lag`."
        )
    products = cross_product, instrument_square, regressors, instrument_torque, regressor_torque, torque_square
    return Moments(basis, weights, *products, count)


class MomentBlock(Noun):
    """Samples ``rows`` of a recording: X and W (B, n, r), the torque ``y``, and whether to use it, ``keep`` (B, n).

    Entries that are not used are zero.
    """

    rows: slice
    X: Array
    W: Array
    y: Array
    keep: NDArray[np.bool_]


def moment_blocks(rows: Regression, instruments: Regression, basis: Array) -> Iterator[MomentBlock]:
    """Yield the rows and their instruments in the columns of ``basis`` (p, r)."""
    pairs = zip(rows.placed_blocks(rows.model.structure), instruments.placed_blocks(rows.model.structure), strict=True)
    for (_, at, row_block), (_, _, instrument_block) in pairs:
        keep = np.ones(row_block.tau.T.shape, dtype=bool) if row_block.keep is None else row_block.keep.T
        X, W = (block.regressor(basis) * keep[:, :, None] for block in (row_block, instrument_block))
        yield MomentBlock(at, X, W, row_block.tau.T * keep, keep)


def regularised_cholesky(matrix: Array) -> Array:
    """Return the Cholesky factor (r, r) of a matrix, slightly regularised where it is singular."""
    scale = np.sqrt(np.maximum(np.diag(matrix), np.finfo(float).tiny))
    unit_matrix = matrix / np.outer(scale, scale)
    # a tiny multiple of the identity makes a singular matrix definite without changing a regular one
    return np.asarray(
        scale[:, None] * np.linalg.cholesky(unit_matrix + 1e-13 * len(unit_matrix) * np.eye(len(unit_matrix)))
    )


BANDWIDTH_SHARE = 0.02  # of a recording: errors of accelerations cancel only over longer times than they correlate
COVARIANCE_FLOOR = 1e-6  # of the covariance for white residuals: what is below is no estimate
ScoreSeries = tuple[NDArray[np.intp], Array]  # samples, and the scores there


def score_information(
    moments: Moments, rows: Regression, instrument_rows: Regression, instruments: Sequence[Instruments], rank: Rank
) -> tuple[Array, float]:
    """Return the inverse covariance (p, p) of the solution, and the number of independent samples.

    The covariance is A^-1 S A^-T with A = W' D^2 X and the long-run covariance S of the scores of each recording.
    In units of S for white residuals, estimated correlations between directions are trusted the more, the more
    independent samples there are per direction.
    """
    r, beta = moments.basis.shape[1], moments.to_basis(moments.value)
    root = regularised_cholesky(moments.white_covariance(beta))
    total, independent, spans = np.zeros((r, r)), 0.0, 0.0
    for series in _recording_scores(moments, beta, root, (rows, instrument_rows), instruments):
        count = sum(map(len, series()))
        if not count:
            continue
        # the short bandwidth counts independent samples, the long one covers slow errors of the motion
        short = bandwidth(iter([series()]))
        long = max(short, int(BANDWIDTH_SHARE * count))
        total = total + bartlett(series(), long, r)[1]
        independent, spans = independent + count / short, spans + count / long
    # shrink correlations between directions to zero, the more the fewer independent spans there are
    variances = np.diag(np.diag(total))
    score_covariance = root @ ((spans * total + r * variances) / (spans + r) + COVARIANCE_FLOOR * np.eye(r)) @ root.T
    information_root = np.linalg.solve(
        regularised_cholesky(score_covariance), moments.total(moments.cross_product)
    )  # its square is that of beta
    n = max(moments.rows.max(), 1)
    back = rank.values[: rank.rank, None] * rank.vectors[:, : rank.rank].T * rank.scale
    # back from the orthonormal directions to the parameters, with the degrees of freedom of a joint
    return max(n - r / len(moments.weights), 1.0) / n * (information_root @ back).T @ (
        information_root @ back
    ), independent


def _recording_scores(
    moments: Moments,
    beta: Array,
    root: Array,
    regressions: tuple[Regression, Regression],
    instruments: Sequence[Instruments],
) -> Iterator[Callable[[], Iterator[Array]]]:
    """Yield for each recording a function that gives its scores, in blocks (B, r)."""
    recordings = [
        [replace(x, motions=x.motions[k : k + 1], weights=x.weights[k : k + 1]) for x in regressions]
        for k in range(len(instruments))
    ]
    score_functions = [partial(_sample_scores, moments, beta, root, *recording) for recording in recordings]
    joined_scores = {
        k: _join_scores(score_functions[k](), beta)
        for k, source in enumerate(instruments)
        if source.partner_motion is not None
    }
    for k in joined_scores:
        m = instruments[k].partner_motion
        if m in joined_scores and m >= k:
            _add_partner_scores(joined_scores[k], joined_scores[m], instruments[k], instruments[m])
    for k, scores in enumerate(score_functions):
        yield partial(_score_blocks, [joined_scores[k]] if k in joined_scores else scores)


def _score_blocks(series: Iterable[ScoreSeries] | Callable[[], Iterator[ScoreSeries]]) -> Iterator[Array]:
    return (u for _, u in (series() if callable(series) else series))


def _sample_scores(
    moments: Moments, beta: Array, root: Array, rows: Regression, instrument_rows: Regression
) -> Iterator[ScoreSeries]:
    """Yield samples and their scores (B, r), in units of ``root``."""
    for block in moment_blocks(rows, instrument_rows, moments.basis):
        error = (block.y - block.X @ beta) * moments.weights**2
        yield (
            np.arange(len(rows.motions[0]))[block.rows],
            np.linalg.solve(root, np.einsum("bj,bjr->rb", error, block.W)).T,
        )


def _join_scores(series: Iterator[ScoreSeries], beta: Array) -> ScoreSeries:
    parts = [(np.zeros(0, dtype=np.intp), np.zeros((0, len(beta)))), *series]
    at, scores = zip(*parts, strict=True)
    return np.concatenate(at), np.concatenate(scores)


def _add_partner_scores(
    series: ScoreSeries, partner_series: ScoreSeries, instruments: Instruments, partner_instruments: Instruments
) -> None:
    """Add the scores of the partner samples to those of this pass, and set them to zero there.

    Only samples that are instruments of each other are joined.
    """
    (at, u), (partner_at, v) = series, partner_series
    if not len(at) or not len(partner_at) or instruments.partner is None or partner_instruments.partner is None:
        return
    partner, step = instruments.partner[at], int(np.median(np.diff(at))) if len(at) > 1 else 1
    j = np.clip(np.searchsorted(partner_at, partner), 1, max(len(partner_at) - 1, 1)) - 1
    j = np.minimum(
        j + (partner - partner_at[j] > step // 2), len(partner_at) - 1
    )  # the nearest that is left after decimation
    back = partner_instruments.partner[partner_at[j]]
    is_mutual = (partner >= 0) & (back >= 0) & (np.abs(partner_at[j] - partner) <= step) & (np.abs(back - at) <= step)
    # where a recording is its own partner, count each pair of samples once
    if u is v:
        is_mutual &= at < partner_at[j]
    u[is_mutual] += v[j[is_mutual]]
    v[j[is_mutual]] = 0.0
