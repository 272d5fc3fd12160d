"""Blocked cross-validation: the torque of stretches of time, predicted from the others."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynident.models import Model, Parameter
from dynident.motion.log import Motion
from dynident.regression import (
    EVERYTHING,
    Reduction,
    Regression,
    Selection,
    TriangularFactors,
    fitted_mask,
    one_thread,
    precision,
    rank_of,
)
from dynident.runtime import short
from dynident.runtime.arrays import Array

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

    def __str__(self) -> str:
        return f"{short(self.share, 2)} +- {short(self.std, 2)} % of the squared cross-validated error"


def motion_gain(
    model: Model,
    before: Sequence[Motion],
    after: Sequence[Motion],
    folds: int = FOLDS,
    *,
    model_before: Model | None = None,
) -> Gain:
    """Return the gain in the cross-validated error from fitting the motions ``after`` instead of ``before``.

    Both have the same samples and are compared on those that both fit, so that neither wins by leaving samples
    out. ``model_before`` is that for the motions before, where it is another one.
    """
    common = [fitted_mask(old) & fitted_mask(new) for old, new in zip(before, after, strict=True)]
    old, new = (
        left_out_errors(
            fitted_model,
            motions,
            [replace(motion, keep=keep) for motion, keep in zip(motions, common, strict=True)],
            folds,
        )
        for fitted_model, motions in ((model_before or model, before), (model, after))
    )
    return gain_from_errors(old, new)


def gains_by_stretch(old: Array, new: Array) -> Array:
    """Return what each stretch (folds) adds to the gain (%) where squared errors (folds, n) fall from old to new."""
    size = np.where(old.sum(axis=0) > 0, old.sum(axis=0), np.inf)
    # Each joint relative to its own error.
    return np.asarray(100.0 * ((old - new) / size).mean(axis=1))


def gain_from_errors(old: Array, new: Array) -> Gain:
    """Return the gain where the squared errors (folds, n) of left-out stretches fall from ``old`` to ``new``."""
    stretches = gains_by_stretch(old, new)
    # The spread over the stretches gives the standard error of the sum.
    return Gain(float(stretches.sum()), float(np.sqrt(len(stretches)) * np.std(stretches, ddof=1)))


def left_out_errors(
    model: Model, motions: Sequence[Motion], test_motions: Sequence[Motion] | None = None, folds: int = FOLDS
) -> Array:
    """Return the squared torque error (folds, n) of each joint in stretches of time predicted from the others.

    Each motion is cut into ``folds`` stretches with equal numbers of usable samples. Joints are fitted relative
    to their torque. ``test_motions`` are the motions to predict, by default those that are fitted.
    """
    parts = factors_by_fold(model, motions, folds)
    return prediction_errors(
        parts, parts if test_motions is None else factors_by_fold(model, test_motions, folds), model.parameters
    )


def prediction_errors(
    train_folds: Sequence[TriangularFactors],
    test_folds: Sequence[TriangularFactors],
    parameters: Sequence[Parameter] = (),
    *,
    relative: bool = True,
) -> Array:
    """Return the squared errors (folds, n) of each of ``test_folds``, predicted from all other ``train_folds``.

    Joints are weighted by the inverse of their torque where ``relative``, else all alike.
    """
    size = np.sqrt(sum(np.square(fold.factors[:, :, -1]).sum(axis=1) for fold in train_folds))
    weights = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0) if relative else None
    # Factors of the other folds merge by stacking, so that leaving a fold out needs no pass over the samples.
    stacked = np.stack([fold.stack(weights) for fold in train_folds])
    # What no fold determines is left out at once, so that there are fewer columns in what follows.
    total = np.asarray(np.linalg.qr(np.concatenate(stacked), mode="r"))
    directions = rank_of(total, parameters).determined_directions
    r = directions.shape[1]
    along = np.concatenate([stacked[:, :, :-1] @ directions, stacked[:, :, -1:]], axis=2)
    reduced = np.asarray(np.linalg.qr(along, mode="r"))
    others = np.stack([np.concatenate(np.delete(reduced, k, axis=0)) for k in range(len(reduced))])
    factors = np.asarray(np.linalg.qr(others, mode="r"))
    # least squares of least norm, without what the other folds do not determine
    U, s, Vt = np.linalg.svd(factors[:, :r, :r])
    inverse = np.divide(1.0, s, out=np.zeros_like(s), where=s > precision(parameters) * s[:, :1])
    values = directions @ np.einsum("kji,kj,klj,kl->ik", Vt, inverse, U, factors[:, :r, r], optimize=True)
    return np.stack([fold.residual(value) for fold, value in zip(test_folds, values.T, strict=True)])


def fold_numbers(motion: Motion, folds: int) -> NDArray[np.intp]:
    """Return the fold of each sample (N): equal shares of the usable ones, in order of time; -1 for all others."""
    numbers = np.full(len(motion), -1)
    for k, rows in enumerate(np.array_split(np.flatnonzero(motion.mask), folds)):
        numbers[rows] = k
    return numbers


def keep_fold(motion: Motion, k: int, folds: int) -> Motion:
    """Return the motion with only the k-th of ``folds`` equal shares of its usable samples in the mask."""
    return replace(motion, mask=fold_numbers(motion, folds) == k)


def factors_by_fold(
    model: Model,
    motions: Sequence[Motion],
    folds: int = FOLDS,
    selection: Selection = EVERYTHING,
    number_samples: Callable[[Motion, int], NDArray[np.intp]] = fold_numbers,
    extra_torques: Sequence[Array] = (),
) -> list[TriangularFactors]:
    """Return the triangular factors of the torque equations in each of ``folds`` parts of the motions.

    ``number_samples`` returns the fold of each sample, as ``fold_numbers`` does. ``extra_torques`` holds other torques
    (N, n, k) of each motion, which become columns after all others.
    """
    numbers = [number_samples(motion, folds) for motion in motions]
    structure = model.structure.append_columns(extra_torques[0].shape[2]) if extra_torques else model.structure
    parts = [Reduction(structure) for _ in range(folds)]
    regression = Regression(model, tuple(motions), selection.unfiltered)
    with one_thread():
        # The entries of all folds are computed together: a fold of many short stretches takes long by itself.
        for k, rows, block in regression.placed_blocks(model.structure, extra_torques=extra_torques):
            for fold in np.unique(numbers[k][rows]):
                if fold >= 0:
                    parts[fold].add(block.take(numbers[k][rows] == fold))
        return [part.factors() for part in parts]


def cross_validated_error(model: Model, motions: Sequence[Motion], folds: int = 5) -> float:
    """Return the relative torque error (%) of stretches of time predicted from the others, from triangular factors."""
    parts = factors_by_fold(model, motions, folds)
    total = sum(float(np.square(part.factors[:, :, -1]).sum()) for part in parts)
    squared_error = prediction_errors(parts, parts, model.parameters, relative=False).sum()
    return 100.0 * float(np.sqrt(squared_error / total)) if total > 0 else float("nan")
