"""How a robot is while it is not changed: what its parameters are beside those of the result, and how blocks scatter.

No robot is on a day as it was identified, and no model is right: a period at the start, the baseline, shows what is
usual. Scores of blocks scatter more than white noise would have them, because residuals are correlated and models have
errors; by how much is found for each direction, with what lasts over several blocks (its long-run variance).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.online.scores import Scores
from dynident.regression.long_run import long_run

__all__ = ["Reference", "reference_of"]

Array = NDArray[np.float64]
UNKNOWN = 30.0  # of the noise: the torque by which a parameter may be wrong that no motion has shown
SHOWN = 1e-3  # of the usual information: blocks with less do not show how a direction scatters
HARDLY = 1e-4  # of the usual information: what a direction has at least in that
LEAST = 1e-12


@dataclass(frozen=True, eq=False)
class Reference:
    """The scaled base parameters (``Scorer``) of a robot less those of the result, ``value`` (r), with their
    ``covariance`` (r, r), of which ``unknown`` (r, r) is the part that more motion without a change would lessen.

    ``spread`` (M) is how many times the variance of white noise the scores of the groups' directions have, by ``dof``
    degrees of freedom; ``left`` (n) and ``left_std`` (n) mean and spread of a block's logarithm of what is left of the
    torque, ``left_error`` (n) that of the mean, in such spreads;
    ``residual`` (n) its root mean square (N m, N).
    """

    value: Array
    covariance: Array
    unknown: Array
    spread: Array
    dof: float
    left: Array
    left_std: Array
    left_error: Array
    residual: Array

    __repr__ = brief

    def louder(self, joint: int, step: float) -> Reference:
        """Return the reference after a change of what is left of a joint's torque, by a step of its logarithm."""
        left = self.left.copy()
        left[joint] += step
        return replace(self, left=left)

    def learned(self, block: Scores) -> Reference:
        """Return the reference after a block of motion that is new to it."""
        usual = float(np.median(self.spread))
        step = block.score - block.information @ self.value
        covariance, unknown = (_after(one, block.information / usual) for one in (self.covariance, self.unknown))
        return replace(self, value=self.value + covariance @ step / usual, covariance=covariance, unknown=unknown)


def reference_of(blocks: Sequence[Scores], directions: Array) -> Reference:
    """Return the reference that blocks without a change show, for the groups' ``directions`` (r, M)."""
    A, s = sum(one.information for one in blocks), sum(one.score for one in blocks)
    shown = np.diag(np.asarray(A)) / sum(one.samples for one in blocks)  # mean square torque, in units of the noise
    prior = np.diag(np.maximum(shown, HARDLY * float(np.median(shown))) / UNKNOWN**2)
    value = np.linalg.solve(_guarded(A + prior), np.asarray(s))
    M = np.stack([np.diag(directions.T @ one.information @ directions) for one in blocks])
    u = np.stack([(one.score - one.information @ value) @ directions for one in blocks])
    spread = np.array([_spread(u[:, m], M[:, m]) for m in range(u.shape[1])])
    covariance = np.asarray(np.linalg.inv(_guarded(A / float(np.median(spread)) + prior)), dtype=float)
    left = np.stack([one.left for one in blocks])
    mean, std = (np.array([one(x) for x in left.T]) for one in (_mean, _long_std))
    count = np.isfinite(left).sum(axis=0)
    residual = np.sqrt(np.array([_mean(x) for x in np.stack([one.residual for one in blocks]).T]))
    return Reference(
        value,
        covariance,
        covariance,
        spread,
        max(len(blocks) / 2.0, 4.0),
        mean,
        std,
        1 / np.sqrt(np.maximum(count, 1)),
        residual,
    )


def _spread(u: Array, M: Array) -> float:
    """Return the variance of scores u (K) relative to M (K), that of their sum if it is larger; at least 1."""
    shown = SHOWN * max(float(M.max()), LEAST) < M
    if shown.sum() < 4:
        return 1.0
    z = u[shown] / np.sqrt(M[shown])
    k = len(z)
    together = float(long_run([z[:, None] - z.mean()])[0, 0]) / (k - 1)
    return max(float(z.var(ddof=1)), together, 1e-6)


def _mean(x: Array) -> float:
    known = x[np.isfinite(x)]
    return float(known.mean()) if len(known) else float("nan")


def _long_std(x: Array) -> float:
    """Return the standard deviation of a block that the long-run variance asks for; nan of fewer than 4 blocks."""
    known = x[np.isfinite(x)]
    if len(known) < 4:
        return float("nan")
    centred = known - known.mean()
    return float(np.sqrt(max(long_run([centred[:, None]])[0, 0] / (len(known) - 1), known.var(ddof=1), LEAST)))


def _after(covariance: Array, information: Array) -> Array:
    """Return the covariance after more information."""
    return np.asarray(np.linalg.inv(_guarded(np.linalg.inv(_guarded(covariance)) + information)), dtype=float)


def _guarded(matrix: Array) -> Array:
    """Return a symmetric matrix with a trace of its diagonal added, so that rounding leaves it invertible."""
    A = np.asarray(matrix)
    return np.asarray((A + A.T) / 2 + 1e-12 * np.diag(np.maximum(np.diag(A), LEAST)))
