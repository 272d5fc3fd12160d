"""Bias and covariance of an estimate by the errors of the smoothed motion, which the fit takes as exact.

The smoother takes from the motion (attenuated accelerations), and leaves noise in it (errors in variables):
both bias least squares. The bias is that of a repetition in which the truth is known: the smoothed positions,
with noise like the recording's, and the torque that the model gives to the smoothed motion, are smoothed and
fitted once more (a parametric bootstrap; Efron and Tibshirani, 1993; of the smoothing alone, Tukey's
twicing).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence, Sized
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from dynident.estimators import Estimate
from dynident.estimators.least_squares import solve_least_squares, weight_joints
from dynident.identification.repetition import (
    LogPiece,
    drop_unlikely_errors,
    equations,
    largest_residuals,
    limit_noise,
    pieces_of,
    repeat_pieces,
)
from dynident.models import Model
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import Smoother, strip_time_offset
from dynident.motion.splines import NORMAL_95
from dynident.regression import Rank, Regression, TriangularFactors, base_parameters, base_std, factorise, merge_factors
from dynident.runtime import InputError, ModelError, Noun, call_part
from dynident.runtime.arrays import Array
from dynident.validation import correlated_std


class RepetitionFactors(Noun):
    """The factors of a repetition, and of its own repetition, with the torque less that of the parameters."""

    once: TriangularFactors
    twice: TriangularFactors


class SampledBias(Noun):
    """A ``bias`` (p), its ``covariance`` (p, p) from the spread between parts, and the ``remainder`` (p).

    The remainder is the difference between the biases of the second repetition and of the first. All are on the
    directions that the data determine.
    """

    bias: Array
    covariance: Array
    remainder: Array


def repeat_piece(
    model: Model, piece: LogPiece, theta: Array, template: Regression, rng: np.random.Generator
) -> RepetitionFactors:
    """Return the factors of a piece that is repeated with noise and its opposite, in the equations of ``template``.

    Samples on the wrong side of a speed reversal count here: over many pieces they occur as often as they should.
    Raises the errors of the smoother.
    """
    e = piece.noise(rng)
    repeated_motions = _repeat_both_signs(model, piece, e, theta)
    states = repeated_motions[0].states()
    clean = replace(
        piece.clean, q=call_part(strip_time_offset(piece.smoother), replace(piece.clean, q=piece.clean.q + e), Motion).q
    )
    # The repetition takes the place of the recording: its motion is the truth of the second one.
    second_piece = replace(
        piece, motion=repeated_motions[0], clean=replace(clean, tau=model.torque(**states, theta=theta))
    )
    return RepetitionFactors(
        _residual_factors(piece, repeated_motions, theta, template),
        _residual_factors(piece, _repeat_both_signs(model, second_piece, e, theta), theta, template),
    )


def _repeat_both_signs(model: Model, piece: LogPiece, e: Array, theta: Array) -> tuple[Motion, ...]:
    no_limit = np.full(len(model.joints), np.inf)
    return tuple(
        motion for sign in (1.0, -1.0) for motion in repeat_pieces(model, [piece], [sign * e], theta, no_limit)
    )


def _residual_factors(
    piece: LogPiece, motions: tuple[Motion, ...], theta: Array, template: Regression
) -> TriangularFactors:
    regression = equations(template, [piece] * len(motions), motions)
    return factorise(regression.entries(), regression.structure).subtract_torque(theta)


def sampled_bias(parts: Iterable[RepetitionFactors], model: Model, weights: Array) -> SampledBias | None:
    """Return the bias from all parts, with the ``weights`` (n) of the joints; None from fewer than two parts."""
    usable_parts = [part for part in parts if part.once.total]
    if len(usable_parts) < 2:
        return None
    once, twice = merge_factors(part.once for part in usable_parts), merge_factors(part.twice for part in usable_parts)
    factor, rank = weight_joints(once, weights, model.parameters)
    bias = solve_least_squares(factor, rank).value
    residual = np.append(-bias, 1.0)
    # Scores of the parts at the solution; their spread gives the variance, as of a ratio of sums.
    factors = [part.once.factors for part in usable_parts]
    scores = np.stack([np.einsum("j,jik,ji->k", weights**2, R[:, :, :-1], R @ residual) for R in factors])
    influences = scores @ rank.inverse
    covariance = len(usable_parts) / (len(usable_parts) - 1) * influences.T @ influences
    return SampledBias(
        bias, covariance, solve_least_squares(*weight_joints(twice, weights, model.parameters)).value - bias
    )


MAX_COVARIANCE_SAMPLES = 20_000  # of all logs that are repeated for the covariance
MAX_BIAS_SAMPLES = 80_000  # for the bias; of longer logs its covariance between pieces counts
NOISE_DRAWS = 16  # of the noise, for the covariance; the bias needs one pair, of either sign


class MotionErrors(Noun):
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

    @property
    def significant(self) -> bool:
        """Whether the largest bias exceeds the 95 % error; a smaller one counts as an error."""
        return self.size > NORMAL_95


@dataclass(frozen=True, eq=False)
class _RepeatedFit:
    """An ``estimate`` from ``logs`` and their ``smoother``, in the equations of ``regression``, to be repeated.

    ``rng`` draws the noise.
    """

    logs: Sequence[Log]
    regression: Regression
    smoother: Smoother
    estimate: Estimate
    rng: np.random.Generator

    @property
    def samples(self) -> int:
        """Samples of all logs."""
        return sum(map(len, self.logs))

    def credible_pieces(self, samples: int) -> list[LogPiece]:
        """Return pieces of about ``samples`` rows of the logs, with as much noise as is credible."""
        share, regression, theta = min(1.0, samples / self.samples), self.regression, self.estimate.value
        weights = regression.weights or [None] * len(self.logs)
        pieces = [
            piece
            for log, motion, motion_weights in zip(self.logs, regression.motions, weights, strict=True)
            for piece in pieces_of(regression.model, log, motion, self.smoother, theta, share, motion_weights)
        ]
        return limit_noise(regression.model, pieces, theta, self.rng)

    def bias(self, parts: Sequence[LogPiece]) -> tuple[Array, Array]:
        """Return the bias (p), and the covariance (p, p) of its error where only part of the samples give it."""
        model, theta, weights = self.regression.model, self.estimate.value, self.estimate.residual.weights
        share = MAX_BIAS_SAMPLES / self.samples
        if self.samples > MAX_COVARIANCE_SAMPLES:
            parts = self.credible_pieces(MAX_BIAS_SAMPLES)
        if share < 1.0:
            # Too many samples to repeat all: pieces give the bias, and their spread its sampling error.
            repetitions = (repeat_piece(model, piece, theta, self.regression, self.rng) for piece in parts)
            sampled = sampled_bias(repetitions, model, _unit_weights(weights, model.joints))
            if sampled is not None:
                covariance = (1.0 - share) * sampled.covariance + np.outer(sampled.remainder, sampled.remainder)
                return sampled.bias, covariance
        e = [piece.noise(self.rng) for piece in parts]
        # Noise and its opposite: terms of odd order in the noise cancel in the mean.
        changes = [self._refit(parts, [s * x for x in e]) for s in (1, -1)]
        return np.mean(changes, axis=0), np.zeros((len(theta), len(theta)))

    def noise_covariance(self, parts: Sequence[LogPiece], rank: Rank, samples: int) -> Array:
        """Return the covariance (p, p) by the noise of the corrected motion, of a fit to so many ``samples``.

        ``rank`` is that of the weighted rows.
        """
        model, theta, weights = self.regression.model, self.estimate.value, self.estimate.residual.weights
        worst, torques = largest_residuals(parts), []
        # draws of the noise as torque errors; those larger than any residual did not happen
        for part in parts:
            draws = [part.torque(model, theta, part.noise(self.rng)) for _ in range(NOISE_DRAWS)]
            torques.append(np.stack([drop_unlikely_errors(e, worst) for e in draws], axis=2))
        repeated_regression = equations(self.regression, parts, [part.motion for part in parts])
        changes = rank.inverse @ repeated_regression.weighted_products(torques, weights)
        # a few pieces stand for all samples: the covariance of sums grows with the number of samples
        scale = samples / max(repeated_regression.usable_samples, 1)
        return np.asarray(scale * changes @ changes.T / NOISE_DRAWS)

    def _refit(self, parts: Sequence[LogPiece], errors: Sequence[Array]) -> Array:
        """Return the error (p) of a fit to the repetition with these position errors, whose truth is known."""
        model, estimate = self.regression.model, self.estimate
        motions = repeat_pieces(model, parts, errors, estimate.value, largest_residuals(parts))
        residual_factors = equations(self.regression, parts, motions).triangular_factors.subtract_torque(estimate.value)
        ones = _unit_weights(estimate.residual.weights, residual_factors.rows)
        return solve_least_squares(
            *weight_joints(residual_factors, ones, model.parameters, unwhitened_rank=estimate.unwhitened_rank)
        ).value


def motion_errors(
    logs: Sequence[Log],
    regression: Regression,
    smoother: Smoother,
    estimate: Estimate,
    rng: np.random.Generator | None = None,
    *,
    needs_noise: bool = True,
) -> MotionErrors | None:
    """Return the bias and covariance of an ``estimate`` by the errors of the smoothed motions of ``logs``.

    They are those of the fit of ``regression`` without constraints, by least squares with the estimate's weights,
    or where these depend on the residual, with the weights by which the fit follows a change of the torque. Of
    more than 20 000 samples a few pieces are used, for the bias of more than 80 000. ``rng`` draws the noise, by
    default the same each time. Unless ``needs_noise``, its covariance is zero where even without it the bias is within
    the standard errors. None where a piece cannot be smoothed by itself.
    """
    rng = rng or np.random.default_rng(0)
    model, triangular, weights = regression.model, regression.triangular_factors, estimate.residual.weights
    follows = estimate.residual.weight_by_slopes(regression)
    factor, rank = weight_joints(
        follows.triangular_factors, _unit_weights(weights, triangular.rows), model.parameters,
        unwhitened_rank=estimate.unwhitened_rank,
    )  # fmt: skip
    basis = base_parameters(rank, model.parameters)
    std = base_std(basis, triangular, estimate.residual.row_deviation(triangular, estimate.value), weights)
    try:
        repeated = _RepeatedFit(logs, follows, smoother, estimate, rng)
        parts = repeated.credible_pieces(MAX_COVARIANCE_SAMPLES)
        bias, covariance = repeated.bias(parts)
        size = _standardised_bias(basis.to_base(bias), std, np.zeros_like(std))
        # noise only adds to the standard errors: a bias within them is not significant with it, either
        if needs_noise or (size > NORMAL_95).any():
            noise_covariance = repeated.noise_covariance(parts, rank, regression.usable_samples)
            noise_std = np.sqrt(np.einsum("ij,jk,ik->i", basis.combination, noise_covariance, basis.combination))
            size, covariance = _standardised_bias(basis.to_base(bias), std, noise_std), noise_covariance + covariance
    except InputError:
        return None
    # The robust standard errors are costly: compute them only where the bias is significant without them.
    if (size > NORMAL_95).any():
        with suppress(ModelError):  # nearly dependent columns
            robust = correlated_std(regression, estimate.value, weights, basis.independent, estimate.residual.slopes)
            size = _standardised_bias(basis.to_base(bias), robust, noise_std)
    largest = int(size.argmax()) if len(size) else 0
    p = len(bias)
    share = np.linalg.norm(factor[:, :p] @ bias) / max(float(np.linalg.norm(factor[:, :p] @ estimate.value)), 1e-300)
    return MotionErrors(bias, covariance, basis.groupings[largest], float(size[largest]), float(share))


def _standardised_bias(bias: Array, std: Array, extra_std: Array) -> Array:
    """Return the bias (r) in standard errors, with two independent contributions to these."""
    total_std = np.hypot(std, extra_std)
    return np.divide(np.abs(bias), total_std, out=np.zeros_like(total_std), where=total_std > 0)


def _unit_weights(weights: Array | None, like: Sized) -> Array:
    return np.ones(len(like)) if weights is None else weights
