"""Repetition of a recording with known truth: its smoothed positions and their torque, with noise like its own.

The error of smoothing and fitting the repetition predicts their error on the recording.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from dynident.models import Model
from dynident.motion.filters import one_pole_filter
from dynident.motion.log import Log, Motion, spread_pieces
from dynident.motion.smoothers import Smoother, position_noise, strip_time_offset
from dynident.motion.splines import coloured_noise
from dynident.regression import Regression, fitted_mask
from dynident.runtime import Noun, call_part
from dynident.runtime.arrays import Array

SAMPLING_PHASES = (0.0, 0.25, 0.5, 0.75)  # shares of the sampling interval, of the repetitions
PIECE = 4_000  # samples of one piece of a recording of which not all is repeated


class LogPiece(Noun):
    """Part of a log with its fitted motion, and its smoothed positions with their torque as a ``clean`` log.

    ``smoother`` is the linear one that made the motion. ``sigma`` and ``rho`` (n) are the standard deviation and
    lag-one correlation of the noise in the positions. ``weights`` (N, n) multiply the rows of the fit, None where
    all count the same.
    """

    motion: Motion
    clean: Log
    smoother: Smoother
    sigma: Array
    rho: Array
    weights: Array | None = None

    def noise(self, rng: np.random.Generator) -> Array:
        """Draw noise like that of the positions (N, n)."""
        lead = 200  # samples in which the start is forgotten
        # First-order autoregression of unit variance; the start is dropped once it is forgotten.
        white = rng.standard_normal((len(self.clean) + lead, len(self.sigma))) * np.sqrt(1 - self.rho**2)
        columns = [one_pole_filter(float(a), white[:, j])[lead:] for j, a in enumerate(self.rho)]
        return np.stack(columns, axis=1) * self.sigma

    def smooth_with_errors(self, e: Array) -> Motion:
        """Return the motion of the clean log with errors e (N, n) added to its positions, with the original masks."""
        motion = call_part(self.smoother, replace(self.clean, q=self.clean.q + e), Motion)
        return replace(motion, mask=motion.mask & self.motion.mask, keep=self.motion.keep)

    def resample(self, model: Model, theta: Array, phase: float) -> LogPiece:
        """Return the piece whose clean log is sampled later by a share ``phase`` of the interval.

        Where a reversal lies between two samples decides which torques get a wrong sign.
        """
        # stamps and masks stay: only what is measured at them is of the later times
        delay = phase * float(np.median(np.diff(self.motion.t)))
        tau = model.torque(**self.motion.shift(delay).states(), theta=theta)
        # positions are stamped by the time offset later than their torque
        return replace(self, clean=replace(self.clean, q=self.motion.shift(delay - self.motion.time_offset).q, tau=tau))

    @cached_property
    def clean_motion(self) -> Motion:
        """The motion of the clean log, without time offset."""
        return call_part(strip_time_offset(self.smoother), self.clean, Motion)

    def smoothed_errors(self, e: Array) -> tuple[Array, Array, Array]:
        """Return the errors of q, dq and ddq that the smoother makes of errors e (N, n) of the positions."""
        # The difference of two smoothings: a smoother need not be linear at the ends or where it repairs.
        without = self.clean_motion
        with_e = call_part(strip_time_offset(self.smoother), replace(self.clean, q=self.clean.q + e), Motion)
        return with_e.q - without.q, with_e.dq - without.dq, with_e.ddq - without.ddq

    def torque(self, model: Model, theta: Array, e: Array, *, corrected: bool = True) -> Array:
        """Return the torque (N, n) of the motion errors caused by errors e of the positions.

        With ``corrected``, of those that remain once the smoothing error itself has been subtracted (twicing).
        """
        once = q, dq, ddq = self.smoothed_errors(e)
        if corrected:
            q, dq, ddq = (2 * a - b for a, b in zip(once, self.smoothed_errors(q), strict=True))
        at = self.motion
        # Central difference in the errors, so that their even orders cancel.
        ends = [model.torque(at.q + s * q, at.dq + s * dq, at.ddq + s * ddq, theta, at.memory) for s in (0.5, -0.5)]
        return ends[0] - ends[1]


def repeat_recordings(
    model: Model, logs: Sequence[Log], motions: Sequence[Motion], smoother: Smoother, theta: Array
) -> Iterator[tuple[Motion, ...]]:
    """Yield repetitions of the motions, sampled and disturbed in several ways, whose torque is that of theta (p).

    Torque and motion agree in time: an offset found in them is spurious. Raises the errors of the smoother.
    """
    rng, pairs = np.random.default_rng(0), zip(logs, motions, strict=True)
    parts = [piece for log, motion in pairs for piece in pieces_of(model, log, motion, smoother, theta, 1.0)]
    parts = limit_noise(model, parts, theta, rng)
    worst, errors = largest_residuals(parts), list[Array]()
    for k, phase in enumerate(SAMPLING_PHASES):
        # noise and its opposite in turn, so that what is linear in it cancels in the mean
        errors = [-e for e in errors] if k % 2 else [piece.noise(rng) for piece in parts]
        yield repeat_pieces(model, [piece.resample(model, theta, phase) for piece in parts], errors, theta, worst)


def limit_noise(model: Model, parts: list[LogPiece], theta: Array, rng: np.random.Generator) -> list[LogPiece]:
    """Return the pieces with their noise reduced to ``credible_share``."""
    share = credible_share(model, parts, theta, rng)
    return [replace(piece, sigma=piece.sigma * share) for piece in parts]


def credible_share(model: Model, parts: Sequence[LogPiece], theta: Array, rng: np.random.Generator) -> float:
    """Return the share of the position noise that the torque residual allows.

    The torque residual contains the effect of the position noise. That noise is estimated too large where the
    sampling is slow for the motion.
    """
    worst = largest_residuals(parts)
    noise = [
        drop_unlikely_errors(piece.torque(model, theta, piece.noise(rng), corrected=False), worst)[piece.motion.mask]
        for piece in parts
    ]
    residuals = [(piece.motion.tau - piece.clean.tau)[piece.motion.mask] for piece in parts]
    # Mean squares over all pieces; the joint that allows the least noise decides for all.
    predicted, measured = (np.square(np.concatenate(x)).mean(axis=0) for x in (noise, residuals))
    return float(np.sqrt(np.min(measured[predicted > 0] / predicted[predicted > 0], initial=1.0)))


def repeat_pieces(
    model: Model, parts: Sequence[LogPiece], errors: Sequence[Array], theta: Array, max_residual: Array
) -> tuple[Motion, ...]:
    """Return the pieces smoothed again with errors of their positions.

    Torques that are wrong by more than ``max_residual`` (n) are left out of the fit.
    """
    repeated_motions = []
    for piece, e in zip(parts, errors, strict=True):
        motion = model.remembering(
            piece.smooth_with_errors(e), None if piece.motion.memory is None else piece.motion.memory[0]
        )
        is_likely = np.abs(motion.tau - model.torque(**motion.states(), theta=theta)) <= max_residual
        repeated_motions.append(replace(motion, keep=is_likely if motion.keep is None else is_likely & motion.keep))
    return tuple(repeated_motions)


def equations(template: Regression, parts: Sequence[LogPiece], motions: Sequence[Motion]) -> Regression:
    """Return the regression of motions that repeat the ``parts``, weighted as ``template`` is."""
    weights = tuple(piece.weights for piece in parts if piece.weights is not None)
    return replace(template, motions=tuple(motions), weights=weights, bias=None)


def largest_residuals(parts: Sequence[LogPiece]) -> Array:
    """Return the largest residual (n) of each joint.

    A sample on the other side of a speed reversal, which did not happen in a recording, is no bias of it.
    """
    residuals = [np.abs((piece.motion.tau - piece.clean.tau) * fitted_mask(piece.motion)) for piece in parts]
    return np.asarray(np.concatenate(residuals).max(axis=0))


def drop_unlikely_errors(torque: Array, max_residual: Array) -> Array:
    """Return errors of the torque (N, n) without those beyond any residual, as of a wrong sign of the speed."""
    return np.where(np.abs(torque) <= max_residual, torque, 0.0)


def pieces_of(
    model: Model,
    log: Log,
    motion: Motion,
    smoother: Smoother,
    theta: Array,
    share: float,
    weights: Array | None = None,
) -> Iterator[LogPiece]:
    """Yield pieces that represent a log, with the noise of its positions and their part of its weights."""
    # The smoother with the bandwidth that was used: a repetition must not choose its own.
    used_smoother = smoother.as_used(motion)
    unshifted_motion = call_part(strip_time_offset(used_smoother), log, Motion) if motion.time_offset else motion
    sigma, rho = _coloured_position_noise(log, unshifted_motion)
    all_rows = slice(0, len(log))
    count = max(1, round(share * len(log) / PIECE))
    for rows in [all_rows] if share == 1.0 else spread_pieces(all_rows, count, share):
        part = motion.shift(0.0, np.arange(rows.start, rows.stop))
        if not part.mask.any():
            continue
        tau = model.torque(**part.states(), theta=theta)
        clean = Log(log.t[rows], unshifted_motion.q[rows], tau, log.joints, log.source)
        yield LogPiece(part, clean, used_smoother, sigma, rho, None if weights is None else weights[rows])


def _coloured_position_noise(log: Log, smoothed: Motion) -> tuple[Array, Array]:
    """Return the standard deviation and lag-one correlation (n) of the noise in the positions of a log."""
    widths = smoothed.smoothing.get("bandwidth")
    if widths is None:
        sigma = position_noise(log)
        return sigma, np.zeros_like(sigma)
    order = int(str(smoothed.smoothing.get("order", 2)))
    return coloured_noise(log.t, log.q, log.q - smoothed.q, np.array(widths), order)
