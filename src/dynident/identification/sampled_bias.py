"""The bias by errors of the motion of a long recording, of which some samples of each part are repeated.

Each part has the normal equations of its own repetition; the bias is that of their sum. By how much the parts differ
tells how well it is known (the variance of a ratio of sums; Cochran, 1977, "Sampling techniques", section 6.4), and a
repetition of the repetition, how far the prediction itself is wrong.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief, called
from dynident.estimators.least_squares import weighted
from dynident.estimators.linear import solve
from dynident.identification.repetition import Piece, equations, repetition
from dynident.log import Motion
from dynident.models import Model
from dynident.regression import Regression, TriangularFactors, factorise, merged
from dynident.smoothers import unshifted

__all__ = ["Repeated", "SampledBias", "repeat", "sampled_bias"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Repeated:
    """The factors of a repetition, and of the repetition of that: of the torque less that of the parameters."""

    once: TriangularFactors
    twice: TriangularFactors

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class SampledBias:
    """A ``bias`` (p), its ``covariance`` (p, p) between parts, and the ``remainder`` (p) by which a second repetition
    differs from the first, on the directions that the data determine."""

    bias: Array
    covariance: Array
    remainder: Array

    __repr__ = brief


def repeat(model: Model, piece: Piece, theta: Array, like: Regression, rng: np.random.Generator) -> Repeated:
    """Return the factors of a piece that is repeated with noise and its opposite, in the equations of ``like``.

    A sample on the other side of a reversal of speed counts here: of many pieces, it happens as often as it should.
    Raises the errors of the smoother.
    """
    e = piece.noise(rng)
    again = _both(model, piece, e, theta)
    states = again[0].states()
    clean = replace(
        piece.clean, q=called(unshifted(piece.smoother), replace(piece.clean, q=piece.clean.q + e), Motion).q
    )
    second = replace(piece, motion=again[0], clean=replace(clean, tau=model.torque(**states, theta=theta)))
    return Repeated(_factors(piece, again, theta, like), _factors(piece, _both(model, second, e, theta), theta, like))


def _both(model: Model, piece: Piece, e: Array, theta: Array) -> tuple[Motion, ...]:
    every = np.full(len(model.joints), np.inf)
    return tuple(one for sign in (1.0, -1.0) for one in repetition(model, [piece], [sign * e], theta, every))


def _factors(piece: Piece, motions: tuple[Motion, ...], theta: Array, like: Regression) -> TriangularFactors:
    regression = equations(like, [piece] * len(motions), motions)
    return factorise(regression.entries(), regression.structure).less(theta)


def sampled_bias(parts: Iterable[Repeated], model: Model, weights: Array) -> SampledBias | None:
    """Return the bias from all parts, with the ``weights`` (n) of the joints; None from fewer than two."""
    found = [one for one in parts if one.once.total]
    if len(found) < 2:
        return None
    once, twice = merged(one.once for one in found), merged(one.twice for one in found)
    factor, rank = weighted(once, weights, model.parameters)
    bias = solve(factor, rank).value
    residual = np.append(-bias, 1.0)
    scores = np.stack([
        np.einsum("j,jik,ji->k", weights**2, one.once.factors[:, :, :-1], one.once.factors @ residual) for one in found
    ])  # fmt: skip
    moved = scores @ rank.inverse
    covariance = len(found) / (len(found) - 1) * moved.T @ moved
    return SampledBias(bias, covariance, solve(*weighted(twice, weights, model.parameters)).value - bias)
