"""Standard errors for residuals that are correlated in time and between joints, as real ones are.

The scores u_t = sum_j w_j^2 Y_jt' e_jt of the least-squares fit sum to zero; the variance of such sums determines that
of the estimate. Their long-run covariance is Newey and West's (1987), with the bandwidth of Andrews (1991).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.errors import ModelError
from dynident.log import pieces
from dynident.regression import EntryBlock, Regression, rank_of, stretches
from dynident.regression.long_run import bandwidth, bartlett

__all__ = ["bread", "plain_std", "robust_covariance", "samples_of", "stretches_of"]

Array = NDArray[np.float64]
MOST, PIECE = 200_000, 20_000  # samples of all logs whose scores are looked at, and of one piece of them


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
    value = np.asarray(theta, dtype=float)
    w = np.ones(n) if weights is None else np.asarray(weights, dtype=float)
    kept = list(range(p)) if columns is None else list(columns)
    if value.shape != (p,) or w.shape != (n,):
        raise ModelError(f"theta has shape {value.shape} and weights {w.shape}, expected ({p},) and ({n},).")
    curved = replace(regression, weights=tuple(np.sqrt(np.maximum(one, 0.0)) for one in slopes))
    scale, inverse = bread(curved if slopes else regression, w, kept)

    chosen = regression.model.structure_with(kept)
    place = np.zeros(p, dtype=np.intp)
    place[kept] = np.arange(len(kept))

    def scores(part: Regression) -> Iterator[Array]:
        return (_scores(block, w, place, scale) for block in part.entries(chosen, value))

    parts = stretches_of(regression, MOST, PIECE)
    series = [list(scores(part)) for part in parts]
    length = max(bandwidth(map(iter, series)), int(share * sum(map(samples_of, parts))), 1)
    rows, total = 0, np.zeros((len(kept), len(kept)))
    for blocks in series:
        count, one = bartlett(iter(blocks), length, len(kept))
        rows, total = rows + count, total + one
    small_sample = rows / max(rows - len(kept) / n, 1.0)
    total = total * (samples_of(regression) / sum(map(samples_of, parts)))
    return small_sample * inverse @ total @ inverse / np.outer(scale, scale)


def plain_std(regression: Regression, theta: Array, weights: Array, columns: Sequence[int]) -> Array:
    """Return the standard errors (r) of the same fit for residuals at ``theta`` (p) that are independent."""
    kept, triangular = list(columns), regression.triangular_factors
    scale, inverse = bread(regression, weights, kept)
    R = triangular.factors[:, :-1, :-1][:, :, kept] / scale
    size = weights**4 * triangular.residual(theta) / np.maximum(triangular.rows, 1)
    S = np.einsum("j,jik,jil->kl", size, R, R, optimize=True)
    return np.asarray(np.sqrt(np.diag(inverse @ S @ inverse)) / scale)


def bread(regression: Regression, w: Array, kept: list[int]) -> tuple[Array, Array]:
    """Return the norms of the columns and the inverse of A in columns scaled by them."""
    found = rank_of(np.asarray(np.linalg.qr(regression.triangular_factors.stacked(w)[:, [*kept, -1]], mode="r")))
    if found.groups:
        if any(len(group) == 1 for group in found.groups):
            raise ModelError("a column of the regressor is zero; leave it out of the columns.")
        raise ModelError("the columns of the regressor are dependent; give those of base parameters.")
    return found.scale, found.inverse * np.outer(found.scale, found.scale)


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


def stretches_of(regression: Regression, most: int, size: int) -> list[Regression]:
    """Return the regression of each uninterrupted stretch: samples on both sides of a gap are independent.

    Of more than ``most`` samples in all, a few pieces of about ``size``, evenly spread, represent each stretch.
    """
    share = min(1.0, most / max(samples_of(regression), 1))
    found = []
    for k, motion in enumerate(regression.motions):
        weights = regression.weights[k : k + 1]
        for part in stretches(motion.mask):
            for piece in _pieces(part, share, size):
                mask = np.zeros(len(motion), dtype=bool)
                mask[piece] = True
                found.append(replace(regression, motions=(replace(motion, mask=mask),), weights=weights))
    return found


def _pieces(part: slice, share: float, size: int) -> list[slice]:
    """Return about that share of a stretch, in pieces of about ``size`` samples; all of it where the share is 1."""
    length = part.stop - part.start
    if share == 1.0 or share * length < 100:
        return [part]
    return pieces(part, max(1, round(share * length / size)), share)


def samples_of(regression: Regression) -> int:
    """Return the number of usable samples."""
    return sum(int(motion.mask.sum()) for motion in regression.motions)
