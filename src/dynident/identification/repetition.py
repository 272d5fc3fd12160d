"""A recording repeated with known truth: its smoothed positions and their torque, with noise like its own.

What smoothing and fit make of the repetition, less its truth, is what they do to the recording.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief, called
from dynident.filters import one_pole
from dynident.log import Log, Motion, pieces
from dynident.models import Model
from dynident.regression import Regression
from dynident.smoothers import Smoother, as_used, position_noise, unshifted
from dynident.splines import coloured_noise

__all__ = [
    "Piece",
    "credible",
    "credible_share",
    "equations",
    "likely",
    "pieces_of",
    "repeated",
    "repetition",
    "worst_of",
]

Array = NDArray[np.float64]
PIECE = 4_000  # samples of one piece of a recording of which not all is repeated


@dataclass(frozen=True, eq=False)
class Piece:
    """Part of a log with its motion as fitted; its smoothed positions and their torque as a ``clean`` log.

    ``smoother`` is the linear one that made the motion; ``sigma`` and ``rho`` (n) are deviation and correlation of
    neighbours of the noise in the positions. ``weights`` (N, n) are what the rows of the fit were multiplied with, None
    where all count the same.
    """

    motion: Motion
    clean: Log
    smoother: Smoother
    sigma: Array
    rho: Array
    weights: Array | None = None

    __repr__ = brief

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


def repeated(
    model: Model, logs: Sequence[Log], motions: Sequence[Motion], smoother: Smoother, theta: Array
) -> tuple[tuple[Motion, ...], tuple[Motion, ...]]:
    """Return repetitions of the motions, with noise and with its opposite, whose torque is that of theta (p).

    Torque and motion agree in time; what a search finds in them is invented. Raises the errors of the smoother.
    """
    rng, pairs = np.random.default_rng(0), zip(logs, motions, strict=True)
    parts = [one for log, motion in pairs for one in pieces_of(model, log, motion, smoother, theta, 1.0)]
    parts = credible(model, parts, theta, rng)
    e = [one.noise(rng) for one in parts]
    worst = worst_of(parts)
    ups, downs = (repetition(model, parts, [s * x for x in e], theta, worst) for s in (1.0, -1.0))
    return ups, downs


def credible(model: Model, parts: list[Piece], theta: Array, rng: np.random.Generator) -> list[Piece]:
    """Return the pieces with no more noise than is ``credible_share`` of theirs."""
    share = credible_share(model, parts, theta, rng)
    return [replace(one, sigma=one.sigma * share) for one in parts]


def credible_share(model: Model, parts: Sequence[Piece], theta: Array, rng: np.random.Generator) -> float:
    """Return how much of the noise of the positions the residual of the torque, which holds what it leaves, allows.

    The noise of the positions is estimated too large where the sampling is slow for the motion.
    """
    worst = worst_of(parts)
    noise = [likely(one.torque(model, theta, one.noise(rng), corrected=False), worst)[one.motion.mask] for one in parts]
    left = [(one.motion.tau - one.clean.tau)[one.motion.mask] for one in parts]
    predicted, seen = (np.square(np.concatenate(x)).mean(axis=0) for x in (noise, left))
    return float(np.sqrt(np.min(seen[predicted > 0] / predicted[predicted > 0], initial=1.0)))


def repetition(
    model: Model, parts: Sequence[Piece], errors: Sequence[Array], theta: Array, worst: Array
) -> tuple[Motion, ...]:
    """Return the pieces smoothed again with errors of their positions, without torques that are wrong by more than
    the ``worst`` (n)."""
    found = []
    for one, e in zip(parts, errors, strict=True):
        motion = model.remembering(one.again(e), None if one.motion.memory is None else one.motion.memory[0])
        fits = np.abs(motion.tau - model.torque(**motion.states(), theta=theta)) <= worst
        found.append(replace(motion, keep=fits if motion.keep is None else fits & motion.keep))
    return tuple(found)


def equations(like: Regression, parts: Sequence[Piece], motions: Sequence[Motion]) -> Regression:
    """Return the equations of motions that repeat each of the parts, weighted as those of ``like`` are."""
    weights = tuple(one.weights for one in parts if one.weights is not None)
    return replace(like, motions=tuple(motions), weights=weights, bias=None)


def worst_of(parts: Sequence[Piece]) -> Array:
    """Return the largest residual (n) of each joint: a sample on the other side of a reversal of speed, which did not
    happen in a recording, is no bias of it."""
    left = [np.abs((one.motion.tau - one.clean.tau) * _fitted(one.motion)) for one in parts]
    return np.asarray(np.concatenate(left).max(axis=0))


def likely(torque: Array, worst: Array) -> Array:
    """Return errors of the torque (N, n) without those that no residual shows, as of a sign of speed that is wrong."""
    return np.where(np.abs(torque) <= worst, torque, 0.0)


def _fitted(motion: Motion) -> NDArray[np.bool_]:
    """Return which torques (N, n) may count in a fit."""
    return motion.mask[:, None] & (True if motion.keep is None else motion.keep)


def pieces_of(
    model: Model,
    log: Log,
    motion: Motion,
    smoother: Smoother,
    theta: Array,
    share: float,
    weights: Array | None = None,
) -> Iterator[Piece]:
    """Yield the pieces of a log that stand for it, with the noise of its positions and their part of its weights."""
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
        clean = Log(log.t[one], bare.q[one], tau, log.joints, log.source)
        yield Piece(part, clean, used, sigma, rho, None if weights is None else weights[one])


def _noise(log: Log, smoothed: Motion) -> tuple[Array, Array]:
    """Return deviation and correlation of neighbours (n) of the noise in the positions of a log."""
    widths = smoothed.smoothing.get("bandwidth")
    if widths is None:
        sigma = position_noise(log)
        return sigma, np.zeros_like(sigma)
    order = int(str(smoothed.smoothing.get("order", 2)))
    return coloured_noise(log.t, log.q, log.q - smoothed.q, np.array(widths), order)
