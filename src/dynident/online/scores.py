"""What some seconds of a motion say of changed parameters: score and information of the base parameters."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.identification import Identification
from dynident.regression import BaseParameters, EntryBlock, structural_base_parameters

__all__ = ["Gram", "Scorer", "Scores"]

Array = NDArray[np.float64]
RIDGE = 1e-9  # of the largest information: what a block does not show


@dataclass(frozen=True, eq=False)
class Gram:
    """Sums over samples for each joint, of the rows Y of the scaled base parameters (``Scorer``) and the residual e of
    the model as it was identified: Y' Y (n, r, r), Y' e (n, r), e' e (n), and the number of rows (n)."""

    information: Array
    score: Array
    squares: Array
    rows: Array

    __repr__ = brief

    def without(self, joint: int) -> Gram:
        """Return the sums without the rows of a joint."""
        kept = np.where(np.arange(len(self.rows)) == joint, 0.0, 1.0)
        information, score = self.information * kept[:, None, None], self.score * kept[:, None]
        return Gram(information, score, self.squares * kept, self.rows * kept)

    def __add__(self, other: Gram) -> Gram:
        """Return the sums over both."""
        return Gram(*(getattr(self, one.name) + getattr(other, one.name) for one in fields(self)))


@dataclass(frozen=True, eq=False)
class Scores:
    """What a block of motion from ``start`` to ``stop`` (s), of ``samples``, says of the base parameters.

    With rows weighted by the joints' noise: ``information`` sum Y' Y (r, r), ``score`` sum Y' e (r). ``left`` (n) is
    the logarithm of each joint's mean square that no base parameters explain, nan where no row of the joint is in use;
    ``residual`` (n) the mean square itself, with what they would explain (N m, N).
    """

    start: float
    stop: float
    samples: int
    information: Array
    score: Array
    left: Array
    residual: Array

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class Scorer:
    """Reduces torque equations to scores of the base parameters of a result.

    Each base parameter is multiplied by its ``scale`` (r), so that all have effects of about the same size; ``sigma``
    (n) is the noise of the joints' torques (N m, N) that weights them.
    """

    found: Identification
    basis: BaseParameters
    sigma: Array

    __repr__ = brief

    @classmethod
    def of(cls, found: Identification) -> Scorer:
        """Return the scorer of a result, with what its fit left of the torque as noise."""
        sigma = np.asarray(found.estimate.residual.sigma, dtype=float)
        usual = float(np.median(sigma[sigma > 0])) if (sigma > 0).any() else 1.0
        basis = found.base.structural or structural_base_parameters(found.model)
        return cls(found, basis, np.where(sigma > 0, sigma, usual))

    @property
    def scale(self) -> Array:
        """What the base parameters (r) are multiplied by."""
        return self.basis.scale[list(self.basis.independent)]

    @property
    def nothing(self) -> Gram:
        """The sums over no samples."""
        n, r = len(self.sigma), len(self.basis.independent)
        return Gram(np.zeros((n, r, r)), np.zeros((n, r)), np.zeros(n), np.zeros(n))

    def gram(self, blocks: Iterable[EntryBlock]) -> Gram:
        """Return the sums over blocks of equations."""
        total = self.nothing
        for block in blocks:
            for j, (base, theta) in enumerate(self._maps):
                used = block.used(j)
                used[-1] -= theta @ used[:-1]
                product = used @ used.T
                total.information[j] += base.T @ product[:-1, :-1] @ base
                total.score[j] += base.T @ product[:-1, -1]
                total.squares[j] += product[-1, -1]
                total.rows[j] += used.shape[1] if block.keep is None else np.count_nonzero(block.keep[j])
        return total

    def scores(self, gram: Gram, start: float, stop: float, samples: int) -> Scores:
        """Return what the sums over a block say."""
        weights = self.sigma**-2
        information, score = np.einsum("j,jkl->kl", weights, gram.information), weights @ gram.score
        step = _solved(information, score)
        left = gram.squares - 2 * gram.score @ step + np.einsum("k,jkl,l->j", step, gram.information, step)
        known, rows = gram.rows > 0, np.maximum(gram.rows, 1.0)
        least = np.maximum(1e-12 * gram.squares, np.finfo(float).tiny)
        logarithm = np.where(known, np.log(np.maximum(left, least) / rows), np.nan)
        residual = np.where(known, gram.squares / rows, np.nan)
        return Scores(start, stop, samples, information, score, logarithm, residual)

    @cached_property
    def _maps(self) -> tuple[tuple[Array, Array], ...]:
        """By joint what makes of its entries the rows of the scaled base parameters, and the torque of the result."""
        kept, theta = list(self.basis.independent), self.found.estimate.value
        return tuple((one[:, kept] / self.scale, one @ theta) for one in self.found.model.structure.maps)


def _solved(information: Array, score: Array) -> Array:
    """Return the parameters that the score asks for; what the information does not hold stays as it is."""
    scale = np.sqrt(np.diag(information))
    scale = np.where(scale > 0, scale, 1.0)
    size, axes = np.linalg.eigh(information / np.outer(scale, scale))
    shown = size > RIDGE * max(float(size[-1]), np.finfo(float).tiny)
    inverse = np.where(shown, 1 / np.where(shown, size, 1.0), 0.0)
    return np.asarray(axes @ (inverse * (axes.T @ (score / scale))) / scale)
