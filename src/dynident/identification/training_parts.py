"""The training in parts, each predicted from all others."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.identification.result import Identification
from dynident.motion.log import stack_states, subsample
from dynident.regression import fitted_mask
from dynident.runtime import Noun
from dynident.runtime.arrays import Array

MAX_TRAINING_SAMPLES = 4000  # of all training motions, up to twice as many
N_PARTS = 20  # of all training motions, about
RANK_TOLERANCE = 1e-5  # share of the largest singular value below which the data say nothing
MIN_DIRECTION_SHARE = 1e-3  # share of a direction that must be left where samples are left out


class TrainingParts(Noun):
    """Thinned samples of the training: of each its ``log`` (M), time ``t`` (M), and ``part`` (M), by number.

    Rows ``Z`` (M, n, r) and torque ``y`` (M, n) are times the ``weight`` (n) of each joint, zero where the fit leaves
    an equation out; in the coordinates of Z the sum of all Z'Z is one.
    """

    names: tuple[str, ...]
    log: NDArray[np.intp]
    part: NDArray[np.intp]
    t: Array
    Z: Array
    y: Array
    weight: Array

    @cached_property
    def residual(self) -> Array:
        """The residual (M, n) of the weighted torque of each part, predicted from the others."""
        return self.residual_without(np.zeros(len(self.y), dtype=bool))

    def residual_without(self, out: NDArray[np.bool_]) -> Array:
        """Return this residual without the samples ``out`` (M); nan where the rest determines too little."""
        residual = np.full(self.y.shape, np.nan)
        # Samples left out are subtracted from all normal equations; those of the part itself only once.
        pairs = list(zip(self._part_sums, self._sums(out), strict=True))
        A, b = (sum(part[i] - omitted[i] for part, omitted in pairs) for i in range(2))
        for k, (part_sums, part_omitted) in enumerate(pairs):
            try:
                L = np.linalg.cholesky(A - part_sums[0] + part_omitted[0])
            except np.linalg.LinAlgError:
                continue
            # In these coordinates all data have information one: a small pivot is a direction the others do not show.
            if (np.diag(L) ** 2 > MIN_DIRECTION_SHARE).all():
                in_part = self.part == k
                residual[in_part] = self.y[in_part] - self.Z[in_part] @ np.linalg.solve(
                    L.T, np.linalg.solve(L, b - part_sums[1] + part_omitted[1])
                )
        return residual

    @property
    def count(self) -> int:
        """Number of parts."""
        return int(self.part.max(initial=-1)) + 1

    def squares(self, residual: Array, rows: NDArray[np.bool_] | None = None) -> Array:
        """Return the sums of squares (K, n) of the ``residual`` (M, n) over each part, of the ``rows`` (M) alone."""
        squared = np.square(residual) if rows is None else np.where(rows[:, None], np.square(residual), 0.0)
        return np.array([squared[self.part == k].sum(axis=0) for k in range(self.count)])

    @cached_property
    def _part_sums(self) -> list[tuple[Array, Array]]:
        return self._sums(np.ones(len(self.y), dtype=bool))

    def _sums(self, samples: NDArray[np.bool_]) -> list[tuple[Array, Array]]:
        """Return Z'Z and Z'y of each part, of the ``samples`` (M) alone."""
        masks = (samples & (self.part == k) for k in range(self.count))
        equations = ((self.Z[mask].reshape(-1, self.Z.shape[2]), self.y[mask].ravel()) for mask in masks)
        return [(Z.T @ Z, Z.T @ y) for Z, y in equations]


def parts_of(identification: Identification) -> TrainingParts:
    """Return the parts of the training of an identification, each joint weighted by its residual."""
    motions = identification.training_motions
    rows = subsample(motions, MAX_TRAINING_SAMPLES)
    selection = identification.recipe.selection(identification.model.joints)
    pairs = list(zip(motions, rows, strict=True))
    tau, t = (np.concatenate([getattr(motion, name)[indices] for motion, indices in pairs]) for name in ("tau", "t"))
    is_fitted = np.concatenate([fitted_mask(motion, selection.min_speed, indices) for motion, indices in pairs])
    X = identification.model.regressor(**stack_states(motions, rows))
    size = np.sqrt(np.mean(np.where(is_fitted, tau - X @ identification.estimate.value, 0.0) ** 2, axis=0))
    weight = 1.0 / np.where(size > 0, size, 1.0)
    X *= (weight * is_fitted)[:, :, None]  # in place, as these rows are the largest array of an identification
    log = np.repeat(np.arange(len(motions)), list(map(len, rows)))
    names = tuple(validation.name for validation in identification.of_role("train"))
    return TrainingParts(
        names, log, _part_numbers(list(map(len, rows))), t, X @ _coordinates(X), tau * weight * is_fitted, weight
    )


def _part_numbers(lengths: Sequence[int]) -> NDArray[np.intp]:
    """Return the part number of each sample; no part has samples of two logs."""
    numbers, total = list[NDArray[np.intp]](), sum(lengths) or 1
    for length in lengths:
        count = max(1, round(N_PARTS * length / total))
        start = int(numbers[-1][-1]) + 1 if numbers else 0
        if length:
            numbers.append(start + np.arange(length) * count // length)
    return np.concatenate(numbers) if numbers else np.zeros(0, dtype=np.intp)


def _coordinates(X: Array) -> Array:
    """Return the map (p, r) of rows X (M, n, p) to coordinates in which the sum of their squares is the identity.

    Directions that the rows do not determine are left out.
    """
    rows = X.reshape(-1, X.shape[2])
    gram = rows.T @ rows
    size = np.sqrt(np.diag(gram))
    scale = np.where(size > 0, size, 1.0)
    values, directions = np.linalg.eigh(gram / np.outer(scale, scale))
    is_determined = values > RANK_TOLERANCE**2 * values.max(initial=0.0)
    return np.asarray(directions[:, is_determined] / np.sqrt(values[is_determined]) / scale[:, None])
