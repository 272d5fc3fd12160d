"""What the errors of a smoothed motion do to an estimate that takes the motion as exact.

The smoother takes from the motion (attenuated accelerations), and leaves noise in it (errors in variables): both bias
least squares. The bias is that of a repetition in which the truth is known: the smoothed positions, with noise like the
recording's, and the torque that the model gives to the smoothed motion, are smoothed and fitted once more (a parametric
bootstrap; Efron and Tibshirani, 1993; of the smoothing alone, Tukey's twicing).
"""

from __future__ import annotations

from collections.abc import Sequence, Sized
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError, ModelError, brief
from dynident.estimators import Estimate
from dynident.estimators.least_squares import weighted
from dynident.estimators.linear import solve
from dynident.identification.repetition import Piece, credible, equations, likely, pieces_of, repetition, worst_of
from dynident.identification.sampled_bias import repeat, sampled_bias
from dynident.log import Log
from dynident.models import Model
from dynident.regression import Regression, base_parameters, base_std
from dynident.smoothers import Smoother
from dynident.splines import NORMAL_95
from dynident.validation import correlated_std

__all__ = ["MotionErrors", "motion_errors"]

Array = NDArray[np.float64]
SAMPLES = 20_000  # of all logs that are repeated for the covariance
MOST = 80_000  # for the bias; of longer logs its covariance between pieces counts
DRAWS = 16  # of the noise, for the covariance; the bias needs one pair, of either sign


@dataclass(frozen=True, eq=False)
class MotionErrors:
    """The ``bias`` (p) of a fit that takes the motion as exact, and the ``covariance`` (p, p) by its noise once the
    bias is corrected, on the directions that the data determine.

    ``parameter`` is the base parameter with the largest bias, of ``size`` standard errors; ``share`` is the torque of
    the bias relative to that of the parameters.
    """

    bias: Array
    covariance: Array
    parameter: str
    size: float
    share: float

    __repr__ = brief

    @property
    def significant(self) -> bool:
        """Whether a bias is larger than 95 % of the errors; a smaller one counts as one of these."""
        return self.size > NORMAL_95


def motion_errors(
    model: Model,
    logs: Sequence[Log],
    regression: Regression,
    smoother: Smoother,
    estimate: Estimate,
    rng: np.random.Generator | None = None,
) -> MotionErrors | None:
    """Return what the errors of the motions that ``smoother`` has made of ``logs`` do to an ``estimate``.

    It is that of the fit of ``regression`` without constraints, by least squares with the estimate's weights, or where
    these depend on the residual, with the weights by which the fit follows a change of the torque. Of more
    than 20 000 samples a few pieces are used, for the bias of more than 80 000. ``rng`` draws the noise, by default the
    same each time. None where a piece cannot be smoothed by itself.
    """
    rng = rng or np.random.default_rng(0)
    triangular, weights = regression.triangular_factors, estimate.residual.weights
    follows = estimate.residual.responding(regression)
    try:
        parts = _parts(logs, follows, smoother, estimate, SAMPLES, rng)
        bias, more = _bias(logs, follows, smoother, estimate, parts, rng)
        worst = worst_of(parts)
        torques = [
            np.stack([likely(one.torque(model, estimate.value, one.noise(rng)), worst) for _ in range(DRAWS)], axis=2)
            for one in parts
        ]
    except InputError:
        return None
    ones = _ones(weights, triangular.rows)
    factor, rank = weighted(follows.triangular_factors, ones, model.parameters, shown=estimate.shown)
    here = equations(follows, parts, [one.motion for one in parts])
    moved = rank.inverse @ here.pulls(torques, weights)
    scale = sum(float(one.mask.sum()) for one in regression.motions) / max(_usable(here), 1.0)
    covariance = scale * moved @ moved.T / DRAWS
    basis = base_parameters(rank, model.parameters)
    wide = np.sqrt(np.einsum("ij,jk,ik->i", basis.combination, covariance, basis.combination))
    own = base_std(basis, triangular, estimate.residual.row_deviation(triangular, estimate.value), weights)
    size = _sizes(basis.to_base(bias), own, wide)
    if (size > NORMAL_95).any():
        with suppress(ModelError):  # nearly dependent columns
            robust = correlated_std(regression, estimate.value, weights, basis.independent, estimate.residual.slopes)
            size = _sizes(basis.to_base(bias), robust, wide)
    largest = int(size.argmax()) if len(size) else 0
    p = len(bias)
    share = np.linalg.norm(factor[:, :p] @ bias) / max(float(np.linalg.norm(factor[:, :p] @ estimate.value)), 1e-300)
    return MotionErrors(bias, covariance + more, basis.groupings[largest], float(size[largest]), float(share))


def _parts(
    logs: Sequence[Log],
    regression: Regression,
    smoother: Smoother,
    estimate: Estimate,
    samples: int,
    rng: np.random.Generator,
) -> list[Piece]:
    """Return pieces of about so many samples of the logs, with as much noise as is credible."""
    share = min(1.0, samples / sum(map(len, logs)))
    weights = regression.weights or [None] * len(logs)
    found = [
        one
        for log, motion, own in zip(logs, regression.motions, weights, strict=True)
        for one in pieces_of(regression.model, log, motion, smoother, estimate.value, share, own)
    ]
    return credible(regression.model, found, estimate.value, rng)


def _bias(
    logs: Sequence[Log],
    regression: Regression,
    smoother: Smoother,
    estimate: Estimate,
    parts: Sequence[Piece],
    rng: np.random.Generator,
) -> tuple[Array, Array]:
    """Return the bias (p), and the covariance (p, p) of its error where it is that of some of the samples."""
    model, theta, weights = regression.model, estimate.value, estimate.residual.weights
    samples = sum(map(len, logs))
    share = MOST / samples
    if samples > SAMPLES:
        parts = _parts(logs, regression, smoother, estimate, MOST, rng)
    if share < 1.0:
        each = (repeat(model, one, theta, regression, rng) for one in parts)
        found = sampled_bias(each, model, _ones(weights, model.joints))
        if found is not None:
            more = (1.0 - share) * found.covariance + np.outer(found.remainder, found.remainder)
            return found.bias, more
    e = [one.noise(rng) for one in parts]
    both = [_refitted(model, parts, [s * x for x in e], regression, estimate) for s in (1, -1)]
    return np.mean(both, axis=0), np.zeros((len(theta), len(theta)))


def _sizes(bias: Array, std: Array, more: Array) -> Array:
    """Return the bias (r) in standard errors, of which there are two independent parts."""
    whole = np.hypot(std, more)
    return np.divide(np.abs(bias), whole, out=np.zeros_like(whole), where=whole > 0)


def _refitted(
    model: Model, parts: Sequence[Piece], errors: Sequence[Array], regression: Regression, estimate: Estimate
) -> Array:
    """Return by how much (p) the fit of the repetition with these errors of the positions differs from its truth."""
    motions = repetition(model, parts, errors, estimate.value, worst_of(parts))
    left = equations(regression, parts, motions).triangular_factors.less(estimate.value)
    ones = _ones(estimate.residual.weights, left.rows)
    return solve(*weighted(left, ones, model.parameters, shown=estimate.shown)).value


def _ones(weights: Array | None, like: Sized) -> Array:
    return np.ones(len(like)) if weights is None else weights


def _usable(regression: Regression) -> float:
    return float(sum(one.mask.sum() for one in regression.motions))
