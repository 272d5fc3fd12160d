"""Standard errors of a least-squares fit: robust to correlated residuals, plain, and by the scatter of parts."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.motion.log import spread_pieces
from dynident.motion.splines import stretches
from dynident.regression import EntryBlock, Regression, TriangularFactors, rank_of
from dynident.regression.whitening import bandwidth, bartlett
from dynident.runtime import ModelError
from dynident.runtime.arrays import Array

MAX_SCORED_SAMPLES, SCORED_PIECE = 200_000, 20_000  # samples of all logs whose scores are looked at, and of one piece


def robust_covariance(
    regression: Regression,
    theta: ArrayLike,
    weights: ArrayLike | None = None,
    columns: Sequence[int] | None = None,
    slopes: Sequence[Array] = (),
    share: float = 0.0,
) -> Array:
    """Return the covariance of a least-squares fit, robust to correlated residuals: A^-1 S A^-1 (p, p), SI units.

    ``theta`` (p) is the estimate, ``weights`` (n) what each joint's rows were multiplied with in the fit (one where
    None). ``columns`` (r) are those of the regressor to invert, the leaders of base parameters say (then (r, r)); they
    must be independent. The regression's own weights of samples count in A and S; ``slopes``, for each motion (N, n),
    stand for their squares in A where the weights depend on the residual (Huber's psi'). A = sum w_j^2 Y_j' Y_j, and
    with Bartlett's weights of bandwidth L

        S = sum_ts max(0, 1 - |t - s| / L) u_t u_s' = (1/L) sum_t b_t b_t',  b_t = u_t + ... + u_(t+L-1).

    L is at least this ``share`` of the samples. The second form needs one pass over the blocks and stores only one
    block and L rows. It holds for an exactly known regressor, and where residuals decorrelate within about a tenth of
    the data; otherwise it is too small. Raises ModelError where shapes do not fit or the columns are dependent.
    """
    p, n = len(regression.model.parameters), len(regression.model.joints)
    estimate = np.asarray(theta, dtype=float)
    w = np.ones(n) if weights is None else np.asarray(weights, dtype=float)
    fitted_columns = list(range(p)) if columns is None else list(columns)
    if estimate.shape != (p,) or w.shape != (n,):
        raise ModelError(f"theta has shape {estimate.shape} and weights {w.shape}, expected ({p},) and ({n},).")
    curved = replace(regression, weights=tuple(np.sqrt(np.maximum(piece, 0.0)) for piece in slopes))
    scale, inverse = bread(curved if slopes else regression, w, fitted_columns)

    # the scores need only the entries of the fitted columns
    structure = regression.model.structure_with(fitted_columns)
    place = np.zeros(p, dtype=np.intp)
    place[fitted_columns] = np.arange(len(fitted_columns))

    def scores(part: Regression) -> Iterator[Array]:
        return (_scores(block, w, place, scale) for block in part.entries(structure, estimate))

    parts = stretches_of(regression, MAX_SCORED_SAMPLES, SCORED_PIECE)
    series = [list(scores(part)) for part in parts]
    # the bandwidth comes from the scores of all pieces, then a second pass over them gives the covariance
    length = max(bandwidth(map(iter, series)), int(share * sum(part.usable_samples for part in parts)), 1)
    rows, total = 0, np.zeros((len(fitted_columns), len(fitted_columns)))
    for blocks in series:
        count, piece = bartlett(iter(blocks), length, len(fitted_columns))
        rows, total = rows + count, total + piece
    # small-sample correction for the fitted parameters, and from the pieces to all samples
    small_sample = rows / max(rows - len(fitted_columns) / n, 1.0)
    total = total * (regression.usable_samples / sum(part.usable_samples for part in parts))
    return small_sample * inverse @ total @ inverse / np.outer(scale, scale)


def plain_std(regression: Regression, theta: Array, weights: Array, columns: Sequence[int]) -> Array:
    """Return the standard errors (r) of the same fit for independent residuals at ``theta`` (p)."""
    fitted_columns, triangular = list(columns), regression.triangular_factors
    scale, inverse = bread(regression, weights, fitted_columns)
    R = triangular.factors[:, :-1, :-1][:, :, fitted_columns] / scale
    size = weights**4 * triangular.residual(theta) / np.maximum(triangular.rows, 1)
    S = np.einsum("j,jik,jil->kl", size, R, R, optimize=True)
    return np.asarray(np.sqrt(np.diag(inverse @ S @ inverse)) / scale)


def _scores(block: EntryBlock, w: Array, place: NDArray[np.intp], scale: Array) -> Array:
    """Return u (B, r) in scaled columns, of all joints together, so that their correlation counts too.

    ``place`` (p) is the column of each parameter.
    """
    error = block.tau * w[:, None] ** 2
    if block.keep is not None:
        error = np.where(block.keep, error, 0.0)
    u = np.zeros((len(scale), block.tau.shape[1]))
    for j, part in enumerate(block.structure.parts):
        u[place[block.structure.columns[j]]] += error[j] * block.entries[part]
    return u.T / scale


def clustered_std(
    parts: Callable[[], Iterable[TriangularFactors]],
    regression: Regression,
    theta: ArrayLike,
    weights: ArrayLike | None = None,
    columns: Sequence[int] | None = None,
    _: Sequence[Array] = (),
) -> Array:
    """Return the standard errors (r) of a least-squares fit: the roots of the diagonal of A^-1 S A^-1, in SI units.

    ``parts`` gives the factors of all K parts of the ``regression``; the other arguments are those of
    ``robust_covariance``. A = sum w_j^2 Y_j' Y_j, S = K / (K - 1) sum_k u_k u_k'. Parts should be longer than what
    correlates, and 40 or more. Raises ModelError where columns are dependent or there are fewer than two parts.
    """
    estimate = np.asarray(theta, dtype=float) + (0.0 if regression.bias is None else regression.bias)
    fitted_columns = list(range(len(estimate))) if columns is None else list(columns)
    w = np.ones(len(regression.model.joints)) if weights is None else np.asarray(weights, dtype=float)
    scale, inverse = bread(regression, w, fitted_columns)
    # [Y | tau] (-theta, 1) is the residual, so that R' R (-theta, 1) is its product with the columns
    residual, total, count = np.append(-estimate, 1.0), np.zeros((len(fitted_columns), len(fitted_columns))), 0
    for part in parts():
        score = np.einsum("j,jik,ji->k", w**2, part.factors[:, :, fitted_columns], part.factors @ residual) / scale
        total, count = total + np.outer(score, score), count + bool(part.total)
    if count < 2:
        raise ModelError("the spread of the parts needs at least two of them.")
    # K / (K - 1): the scores of all parts sum to zero
    return np.asarray(np.sqrt(count / (count - 1) * np.diag(inverse @ total @ inverse)) / scale)


def bread(regression: Regression, w: Array, columns: list[int]) -> tuple[Array, Array]:
    """Return the norms of the fitted columns, and the inverse of A in columns scaled by them."""
    rank = rank_of(np.asarray(np.linalg.qr(regression.triangular_factors.stack(w)[:, [*columns, -1]], mode="r")))
    if rank.groups:
        if any(len(group) == 1 for group in rank.groups):
            raise ModelError("a column of the regressor is zero; leave it out of the columns.")
        raise ModelError("the columns of the regressor are dependent; give those of base parameters.")
    return rank.scale, rank.inverse * np.outer(rank.scale, rank.scale)


def stretches_of(regression: Regression, max_samples: int, piece_samples: int) -> list[Regression]:
    """Return the regression of each uninterrupted stretch: samples on both sides of a gap are independent.

    Of more than ``max_samples`` samples in all, a few pieces of about ``piece_samples``, evenly spread, represent
    each stretch.
    """
    share = min(1.0, max_samples / max(regression.usable_samples, 1))
    regressions = []
    for k, motion in enumerate(regression.motions):
        weights = regression.weights[k : k + 1]
        for part in stretches(motion.mask):
            size = share * (part.stop - part.start)
            count = max(1, round(size / piece_samples))
            for piece in [part] if share == 1.0 or size < 100 else spread_pieces(part, count, share):
                mask = np.zeros(len(motion), dtype=bool)
                mask[piece] = True
                regressions.append(replace(regression, motions=(replace(motion, mask=mask),), weights=weights))
    return regressions
