"""Blocked cross-validation: the torque of stretches of time, predicted from the others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynident.estimators.linear import solve
from dynident.log import Motion
from dynident.models import Model, Parameter
from dynident.regression import Regression, TriangularFactors, factorise, fitted_rows, rank_of

__all__ = ["FOLDS", "Gain", "factors_of", "fitted", "gain_of", "gained", "left_out_errors", "predicted", "stretch"]

Array = NDArray[np.float64]
FOLDS = 10


@dataclass(frozen=True)
class Gain:
    """The ``share`` (%) of the squared cross-validated torque error that a change removes, and its standard error.

    Each joint counts by its own error, and the standard error is that of the sum over stretches of time.
    """

    share: float
    std: float

    @property
    def sure(self) -> bool:
        """Whether the error falls by more than one standard error."""
        return self.share > self.std


def gain_of(model: Model, before: Sequence[Motion], after: Sequence[Motion], folds: int = FOLDS) -> Gain:
    """Return what is gained where least squares is fitted to the motions ``after`` and not to those ``before``.

    Both have the same samples, and are compared on those that both fit: neither wins by what it leaves out.
    """
    common = [fitted(one) & fitted(other) for one, other in zip(before, after, strict=True)]
    old, new = (left_out_errors(model, motions, _scored(motions, common), folds) for motions in (before, after))
    return gained(old, new)


def gained(old: Array, new: Array) -> Gain:
    """Return what is gained where the squared errors (folds, n) of left-out stretches are ``new`` and not ``old``."""
    size = np.where(old.sum(axis=0) > 0, old.sum(axis=0), np.inf)
    blocks = 100.0 * ((old - new) / size).mean(axis=1)
    return Gain(float(blocks.sum()), float(np.sqrt(len(blocks)) * np.std(blocks, ddof=1)))


def _scored(motions: Sequence[Motion], keep: Sequence[NDArray[np.bool_]]) -> list[Motion]:
    return [replace(one, keep=rows) for one, rows in zip(motions, keep, strict=True)]


def left_out_errors(
    model: Model, motions: Sequence[Motion], scored: Sequence[Motion] | None = None, folds: int = FOLDS
) -> Array:
    """Return the squared torque error (folds, n) of each joint in stretches of time predicted from the others.

    Each motion is cut into ``folds`` stretches with as many usable samples. Joints are fitted relative to their
    torque. ``scored`` are the motions to predict, by default those that are fitted.
    """
    parts = factors_of(model, motions, folds)
    return predicted(parts, parts if scored is None else factors_of(model, scored, folds), model.parameters)


def predicted(
    parts: Sequence[TriangularFactors],
    judged: Sequence[TriangularFactors],
    parameters: Sequence[Parameter] = (),
    *,
    relative: bool = True,
) -> Array:
    """Return the squared errors (folds, n) of what is ``judged``, each predicted from all ``parts`` but its own.

    Joints are fitted ``relative`` to their torque, or all alike.
    """
    size = np.sqrt(sum(np.square(one.factors[:, :, -1]).sum(axis=1) for one in parts))
    weights = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0) if relative else None
    stacked, rows = np.stack([one.stacked(weights) for one in parts]), np.array([one.total for one in parts])
    found = []
    for k, one in enumerate(judged):
        factor = TriangularFactors(np.delete(stacked, k, axis=0), np.delete(rows, k)).stacked()
        found.append(one.residual(solve(factor, rank_of(factor, parameters)).value))
    return np.stack(found)


def stretch(motion: Motion, k: int, folds: int) -> Motion:
    """Return the motion with only the k-th of ``folds`` equal shares of its usable samples left in the mask."""
    used = np.array_split(np.flatnonzero(motion.mask), folds)[k]
    mask = np.zeros(len(motion), dtype=bool)
    mask[used] = True
    return replace(motion, mask=mask)


def factors_of(
    model: Model,
    motions: Sequence[Motion],
    folds: int = FOLDS,
    min_speed: tuple[float, ...] | None = None,
    part: Callable[[Motion, int, int], Motion] = stretch,
) -> list[TriangularFactors]:
    """Return the factors of the torque equations in each of the ``folds`` parts of the motions."""
    parts = [tuple(part(one, k, folds) for one in motions) for k in range(folds)]
    return [factorise(Regression(model, some, None, min_speed).entries(), model.structure) for some in parts]


def fitted(motion: Motion, min_speed: tuple[float, ...] | None = None) -> NDArray[np.bool_]:
    """Return which torque equations (N, n) of a motion are fitted."""
    rows = fitted_rows(motion, min_speed)
    return np.asarray(motion.mask[:, None] & (np.ones(motion.q.shape, dtype=bool) if rows is None else rows))
