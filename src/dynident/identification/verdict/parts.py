"""Cross-validation of what is left out of the training: consecutive parts of it, each predicted from the others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.identification.cross_validation import fitted
from dynident.identification.result import Identification
from dynident.log import subsample, together

__all__ = ["Parts", "parts_of"]

Array = NDArray[np.float64]
SAMPLES = 4000  # of all training motions, up to twice as many
PARTS = 20  # of all training motions, about
RANK = 1e-5  # share of the largest singular value below which the data say nothing
SEEN = 1e-3  # share of a direction that must be left where samples are left out


@dataclass(frozen=True, eq=False)
class Parts:
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

    __repr__ = brief

    @cached_property
    def left(self) -> Array:
        """What is left (M, n) of the weighted torque of each part, predicted from the others."""
        return self.without(np.zeros(self.y.shape, dtype=bool))

    def without(self, out: NDArray[np.bool_]) -> Array:
        """Return the same where the equations ``out`` (M, n) are not fitted; nan where the rest shows too little."""
        found = np.full(self.y.shape, np.nan)
        omitted = [self._sums(out & (self.part == k)[:, None]) for k in range(self.count)]
        A, b = (whole - sum(one[i] for one in omitted) for i, whole in enumerate(self._whole))
        for k, (own, less) in enumerate(zip(self._each, omitted, strict=True)):
            try:
                L = np.linalg.cholesky(A - own[0] + less[0])
            except np.linalg.LinAlgError:
                continue
            if (np.diag(L) ** 2 > SEEN).all():
                mine = self.part == k
                found[mine] = self.y[mine] - self.Z[mine] @ np.linalg.solve(
                    L.T, np.linalg.solve(L, b - own[1] + less[1])
                )
        return found

    @property
    def count(self) -> int:
        """Number of parts."""
        return int(self.part.max(initial=-1)) + 1

    def squares(self, left: Array, rows: NDArray[np.bool_] | None = None) -> Array:
        """Return the sums (K, n) over each part of squares of what is ``left`` (M, n), of the ``rows`` (M) alone."""
        kept = np.square(left) if rows is None else np.where(rows[:, None], np.square(left), 0.0)
        return np.array([kept[self.part == k].sum(axis=0) for k in range(self.count)])

    @cached_property
    def _each(self) -> list[tuple[Array, Array]]:
        return [self._sums(np.repeat((self.part == k)[:, None], self.y.shape[1], axis=1)) for k in range(self.count)]

    @cached_property
    def _whole(self) -> tuple[Array, Array]:
        return np.sum([one[0] for one in self._each], axis=0), np.sum([one[1] for one in self._each], axis=0)

    def _sums(self, chosen: NDArray[np.bool_]) -> tuple[Array, Array]:
        Z, y = self.Z[chosen], self.y[chosen]
        return Z.T @ Z, Z.T @ y


def parts_of(found: Identification) -> Parts:
    """Return the parts of the training of an identification, each joint weighted by its residual."""
    motions = [log.motion for log in found.validations if log.role == "train"]
    rows = subsample(motions, SAMPLES)
    speeds = found.recipe.min_speeds([joint.name for joint in found.model.joints])
    pairs = list(zip(motions, rows, strict=True))
    tau, t = (np.concatenate([getattr(motion, name)[kept] for motion, kept in pairs]) for name in ("tau", "t"))
    used = np.concatenate([fitted(motion, speeds)[kept] for motion, kept in pairs])
    Y = found.model.regressor(**together(motions, rows))
    size = np.sqrt(np.mean(np.where(used, tau - Y @ found.estimate.value, 0.0) ** 2, axis=0))
    weight = 1.0 / np.where(size > 0, size, 1.0)
    X, y = Y * (weight * used)[:, :, None], tau * weight * used
    log = np.repeat(np.arange(len(motions)), list(map(len, rows)))
    names = tuple(one.name for one in found.validations if one.role == "train")
    return Parts(names, log, _parts(list(map(len, rows))), t, X @ _coordinates(X), y, weight)


def _parts(lengths: Sequence[int]) -> NDArray[np.intp]:
    """Return the part of each sample; none has samples of two logs."""
    found, total = list[NDArray[np.intp]](), sum(lengths) or 1
    for length in lengths:
        count = max(1, round(PARTS * length / total))
        start = int(found[-1][-1]) + 1 if found else 0
        if length:
            found.append(start + np.arange(length) * count // length)
    return np.concatenate(found) if found else np.zeros(0, dtype=np.intp)


def _coordinates(X: Array) -> Array:
    """Return the map (p, r) of rows X (M, n, p) to coordinates in which the sum of their squares is one, without the
    directions that they do not show."""
    scale = np.linalg.norm(X, axis=(0, 1))
    scale = np.where(scale > 0, scale, 1.0)
    _, singular, directions = np.linalg.svd(np.linalg.qr((X / scale).reshape(-1, X.shape[2]), mode="r"))
    seen = singular > RANK * singular.max(initial=0.0)
    return np.asarray(directions[: len(singular)][seen].T / singular[seen] / scale[:, None])
