"""What some seconds of a motion say of changed parameters: score and information of the base parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.identification import Identification
from dynident.log import Motion
from dynident.regression import BaseParameters, Regression, structural_base_parameters

__all__ = ["Scorer", "Scores"]

Array = NDArray[np.float64]
SLOWEST = 0.01  # rad/s, m/s: below, Coulomb friction has no known sign
RIDGE = 1e-9  # of the largest information: what a block does not show


@dataclass(frozen=True, eq=False)
class Scores:
    """Sums over the samples from ``start`` to ``stop`` (s), with the residual e of the model as it was identified.

    With the rows Y of the scaled base parameters (``Scorer``), weighted by the joints' noise: ``information`` sum Y' Y (r, r), ``score``
    sum Y' e (r). ``left`` (n) is the logarithm of each joint's mean square that no base parameters explain, nan where
    no row of the joint is in use; ``residual`` (n) the mean square itself, with what they would explain (N m, N).
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
    """Reduces motions to scores for the parameters ``theta`` (p) of a result, in its base parameters.

    Each base parameter is multiplied by its ``scale`` (r), so that all have effects of about the same size. ``sigma``
    (n) is the noise of the joints' torques that weights them, ``min_speed`` (n) that
    below which a joint's rows are left out.
    """

    found: Identification
    basis: BaseParameters
    sigma: Array
    min_speed: tuple[float, ...]

    __repr__ = brief

    @classmethod
    def of(cls, found: Identification) -> Scorer:
        """Return the scorer of a result."""
        model = found.model
        basis = found.base.structural or structural_base_parameters(model)
        sigma = np.asarray(found.estimate.residual.sigma, dtype=float)
        usual = float(np.median(sigma[sigma > 0])) if (sigma > 0).any() else 1.0
        speeds = found.recipe.min_speeds([joint.name for joint in model.joints])
        slowest = tuple(max(one, SLOWEST) for one in speeds or (0.0,) * len(model.joints))
        return cls(found, basis, np.where(sigma > 0, sigma, usual), slowest)

    @property
    def scale(self) -> Array:
        """What the base parameters (r) are multiplied by."""
        return self.basis.scale[list(self.basis.independent)]

    def __call__(self, motion: Motion, rows: slice) -> Scores:
        """Reduce the ``rows`` of a motion; those around them count in the filter of the recipe alone."""
        model, theta = self.found.model, self.found.estimate.value
        regression = Regression(model, (model.remembering(motion),), self.found.recipe.filter, self.min_speed)
        maps = [one[:, list(self.basis.independent)] / self.scale for one in model.structure.maps]
        sums = [np.zeros((len(one) + 1, len(one) + 1)) for one in maps]
        count = np.zeros(len(maps))
        for block in regression.entries(theta=theta, within=(0, rows)):
            for j, total in enumerate(sums):
                used = block.used(j)
                total += used @ used.T
                count[j] += used.shape[1] if block.keep is None else int(block.keep[j].sum())
        A = np.stack([one.T @ total[:-1, :-1] @ one for one, total in zip(maps, sums, strict=True)])
        s = np.stack([one.T @ total[:-1, -1] for one, total in zip(maps, sums, strict=True)])
        squares = np.array([total[-1, -1] for total in sums])
        w2 = self.sigma**-2
        information, score = np.einsum("j,jkl->kl", w2, A), w2 @ s
        step = _solved(information, score)
        left = squares - 2 * s @ step + np.einsum("k,jkl,l->j", step, A, step)
        known = count > 0
        mean = np.where(known, squares / np.maximum(count, 1.0), np.nan)
        rest = np.maximum(left, 1e-12 * np.maximum(squares, 1e-300)) / np.maximum(count, 1.0)
        return Scores(
            float(motion.t[rows][0]), float(motion.t[rows][-1]), int(motion.mask[rows].sum()), information, score,
            np.where(known, np.log(rest), np.nan), mean,
        )  # fmt: skip


def _solved(information: Array, score: Array) -> Array:
    """Return the parameters that the score asks for; what the information does not hold stays as it is."""
    scale = np.sqrt(np.diag(information))
    scale = np.where(scale > 0, scale, 1.0)
    size, axes = np.linalg.eigh(information / np.outer(scale, scale))
    shown = size > RIDGE * max(float(size[-1]), 1e-300)
    inverse = np.where(shown, 1 / np.where(shown, size, 1.0), 0.0)
    return np.asarray(axes @ (inverse * (axes.T @ (score / scale))) / scale)
