"""What the errors of a smoothed motion do to an estimate that takes the motion as exact.

The smoother takes from the motion (attenuated accelerations), and leaves noise in it (errors in variables): both bias
least squares. The bias is that of a repetition in which the truth is known: the smoothed positions, with noise like the
recording's, and the torque that the model gives to the smoothed motion, are smoothed and fitted once more (a parametric
bootstrap; Efron and Tibshirani, 1993; of the smoothing alone, Tukey's twicing).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError, ModelError, brief, called
from dynident.estimators import Estimate
from dynident.estimators.least_squares import solve, weighted
from dynident.filters import one_pole
from dynident.log import Log, Motion, pieces
from dynident.models import Model
from dynident.regression import Regression, base_parameters, base_std
from dynident.smoothers import Smoother, as_used, position_noise, unshifted
from dynident.splines import NORMAL_95, coloured_noise
from dynident.validation import correlated_std

__all__ = ["MotionErrors", "motion_errors", "repeated"]

Array = NDArray[np.float64]
SAMPLES, PIECE = 20_000, 4_000  # of all logs that are repeated, and of one piece of them
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


@dataclass(frozen=True, eq=False)
class _Piece:
    """Part of a log with its motion as fitted; its smoothed positions and their torque as a ``clean`` log.

    ``smoother`` is the linear one that made the motion; ``sigma`` and ``rho`` (n) are deviation and correlation of
    neighbours of the noise in the positions.
    """

    motion: Motion
    clean: Log
    smoother: Smoother
    sigma: Array
    rho: Array

    def noise(self, rng: np.random.Generator) -> Array:
        """Draw noise like that of the positions (N, n)."""
        lead = 200  # samples in which the start is forgotten
        white = rng.standard_normal((len(self.clean) + lead, len(self.sigma))) * np.sqrt(1 - self.rho**2)
        columns = [one_pole(float(a), white[:, j])[lead:] for j, a in enumerate(self.rho)]
        return np.stack(columns, axis=1) * self.sigma

    def again(self, e: Array) -> Motion:
        """Return the motion of the clean log with errors e (N, n) of its positions, as usable as it was."""
        motion = called(self.smoother, replace(self.clean, q=self.clean.q + e), Motion)
        return replace(motion, mask=motion.mask & self.motion.mask, keep=self.motion.keep)

    @cached_property
    def smoothed(self) -> Motion:
        """The motion of the clean log, not shifted."""
        return called(unshifted(self.smoother), self.clean, Motion)

    def passed(self, e: Array) -> tuple[Array, Array, Array]:
        """Return what the smoother makes of errors e (N, n) of the positions: errors of q, dq and ddq."""
        without, with_e = (
            self.smoothed,
            called(unshifted(self.smoother), replace(self.clean, q=self.clean.q + e), Motion),
        )
        return with_e.q - without.q, with_e.dq - without.dq, with_e.ddq - without.ddq

    def torque(self, model: Model, theta: Array, e: Array, *, corrected: bool = True) -> Array:
        """Return the torque (N, n) of what errors e of the positions leave in the motion, or in the corrected one."""
        once = q, dq, ddq = self.passed(e)
        if corrected:
            q, dq, ddq = (2 * a - b for a, b in zip(once, self.passed(q), strict=True))
        at = self.motion
        ends = [model.torque(at.q + s * q, at.dq + s * dq, at.ddq + s * ddq, theta, at.memory) for s in (0.5, -0.5)]
        return ends[0] - ends[1]


def motion_errors(
    model: Model,
    logs: Sequence[Log],
    regression: Regression,
    smoother: Smoother,
    estimate: Estimate,
    rng: np.random.Generator | None = None,
) -> MotionErrors | None:
    """Return what the errors of the motions that ``smoother`` has made of ``logs`` do to an ``estimate``.

    It is that of the fit of ``regression`` without constraints, by least squares with the estimate's weights. Of more
    than 20 000 samples a few pieces are used. ``rng`` draws the noise, by default the same each time. None where a
    piece cannot be smoothed by itself.
    """
    rng = rng or np.random.default_rng(0)
    triangular, weights = regression.triangular_factors, estimate.residual.weights
    try:
        parts = [
            one
            for log, motion in zip(logs, regression.motions, strict=True)
            for one in _pieces(model, log, motion, smoother, estimate.value, min(1.0, SAMPLES / sum(map(len, logs))))
        ]
        parts = _credible(model, parts, estimate.value, rng)
        e = [one.noise(rng) for one in parts]
        bias = np.mean([_refitted(model, parts, [s * x for x in e], regression, estimate) for s in (1, -1)], axis=0)
        worst = _worst(parts)
        torques = [
            np.stack([_likely(one.torque(model, estimate.value, one.noise(rng)), worst) for _ in range(DRAWS)], axis=2)
            for one in parts
        ]
    except InputError:
        return None
    factor, rank = weighted(triangular, _ones(weights, triangular.rows), model.parameters)
    here = replace(regression, motions=tuple(one.motion for one in parts), weights=(), bias=None)
    moved = rank.inverse @ here.pulls(torques, weights)
    scale = sum(float(one.mask.sum()) for one in regression.motions) / max(_usable(here), 1.0)
    covariance = scale * moved @ moved.T / DRAWS
    basis = base_parameters(rank, model.parameters)
    wide = np.sqrt(np.einsum("ij,jk,ik->i", basis.combination, covariance, basis.combination))
    size = _sizes(basis.to_base(bias), base_std(basis, triangular, estimate.residual.sigma, weights), wide)
    if (size > NORMAL_95).any():
        with suppress(ModelError):  # nearly dependent columns
            robust = correlated_std(regression, estimate.value, weights, basis.independent, estimate.residual.slopes)
            size = _sizes(basis.to_base(bias), robust, wide)
    largest = int(size.argmax()) if len(size) else 0
    p = len(bias)
    share = np.linalg.norm(factor[:, :p] @ bias) / max(float(np.linalg.norm(factor[:, :p] @ estimate.value)), 1e-300)
    return MotionErrors(bias, covariance, basis.groupings[largest], float(size[largest]), float(share))


def _sizes(bias: Array, std: Array, more: Array) -> Array:
    """Return the bias (r) in standard errors, of which there are two independent parts."""
    whole = np.hypot(std, more)
    return np.divide(np.abs(bias), whole, out=np.zeros_like(whole), where=whole > 0)


def repeated(
    model: Model, logs: Sequence[Log], motions: Sequence[Motion], smoother: Smoother, theta: Array
) -> tuple[tuple[Motion, ...], tuple[Motion, ...]]:
    """Return repetitions of the motions, with noise and with its opposite, whose torque is that of theta (p).

    Torque and motion agree in time; what a search finds in them is invented. Raises the errors of the smoother.
    """
    rng, pairs = np.random.default_rng(0), zip(logs, motions, strict=True)
    parts = [one for log, motion in pairs for one in _pieces(model, log, motion, smoother, theta, 1.0)]
    parts = _credible(model, parts, theta, rng)
    e = [one.noise(rng) for one in parts]
    ups, downs = (_repetition(model, parts, [s * x for x in e], theta) for s in (1.0, -1.0))
    return ups, downs


def _credible(model: Model, parts: list[_Piece], theta: Array, rng: np.random.Generator) -> list[_Piece]:
    """Return the pieces with no more noise than the residual of the torque allows: it holds what noise leaves there.

    The noise of the positions is estimated too large where the sampling is slow for the motion.
    """
    worst = _worst(parts)
    noise = [
        _likely(one.torque(model, theta, one.noise(rng), corrected=False), worst)[one.motion.mask] for one in parts
    ]
    left = [(one.motion.tau - one.clean.tau)[one.motion.mask] for one in parts]
    predicted, seen = (np.square(np.concatenate(x)).mean(axis=0) for x in (noise, left))
    allowed = np.sqrt(np.min(seen[predicted > 0] / predicted[predicted > 0], initial=1.0))
    return [replace(one, sigma=one.sigma * allowed) for one in parts]


def _repetition(model: Model, parts: Sequence[_Piece], errors: Sequence[Array], theta: Array) -> tuple[Motion, ...]:
    """Return the pieces smoothed again with errors of their positions, without torques that fit worse than any that
    was recorded: a sample on the other side of a reversal of speed, which did not happen, is no bias."""
    worst, found = _worst(parts), []
    for one, e in zip(parts, errors, strict=True):
        motion = model.remembering(one.again(e), None if one.motion.memory is None else one.motion.memory[0])
        likely = np.abs(motion.tau - model.torque(**motion.states(), theta=theta)) <= worst
        found.append(replace(motion, keep=likely if motion.keep is None else likely & motion.keep))
    return tuple(found)


def _worst(parts: Sequence[_Piece]) -> Array:
    """Return the largest residual (n) of each joint."""
    left = [np.abs((one.motion.tau - one.clean.tau) * _fitted(one.motion)) for one in parts]
    return np.asarray(np.concatenate(left).max(axis=0))


def _likely(torque: Array, worst: Array) -> Array:
    """Return errors of the torque (N, n) without those that no residual shows, as of a sign of speed that is wrong."""
    return np.where(np.abs(torque) <= worst, torque, 0.0)


def _fitted(motion: Motion) -> NDArray[np.bool_]:
    """Return which torques (N, n) may count in a fit."""
    return motion.mask[:, None] & (True if motion.keep is None else motion.keep)


def _refitted(
    model: Model, parts: Sequence[_Piece], errors: Sequence[Array], regression: Regression, estimate: Estimate
) -> Array:
    """Return by how much (p) the fit of the repetition with these errors of the positions differs from its truth."""
    motions = _repetition(model, parts, errors, estimate.value)
    left = replace(regression, motions=motions, weights=(), bias=None).triangular_factors.less(estimate.value)
    return solve(*weighted(left, _ones(estimate.residual.weights, left.rows), model.parameters)).value


def _pieces(model: Model, log: Log, motion: Motion, smoother: Smoother, theta: Array, share: float) -> Iterator[_Piece]:
    """Yield the pieces of a log that stand for it, with the noise of its positions."""
    used = as_used(smoother, motion)
    bare = called(unshifted(used), log, Motion) if motion.time_offset else motion
    sigma, rho = _noise(log, bare)
    whole = slice(0, len(log))
    count = max(1, round(share * len(log) / PIECE))
    for one in [whole] if share == 1.0 else pieces(whole, count, share):
        part = motion.shifted(0.0, np.arange(one.start, one.stop))
        if not part.mask.any():
            continue
        tau = model.torque(**part.states(), theta=theta)
        yield _Piece(part, Log(log.t[one], bare.q[one], tau, log.joints, log.source), used, sigma, rho)


def _noise(log: Log, smoothed: Motion) -> tuple[Array, Array]:
    """Return deviation and correlation of neighbours (n) of the noise in the positions of a log."""
    widths = smoothed.smoothing.get("bandwidth")
    if widths is None:
        sigma = position_noise(log)
        return sigma, np.zeros_like(sigma)
    return coloured_noise(log.t, log.q, log.q - smoothed.q, np.array(widths))


def _ones(weights: Array | None, like: NDArray[np.int_]) -> Array:
    return np.ones(len(like)) if weights is None else weights


def _usable(regression: Regression) -> float:
    return float(sum(one.mask.sum() for one in regression.motions))
