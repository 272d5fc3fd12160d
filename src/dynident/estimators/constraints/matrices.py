"""Constrained matrices of one size, stacked: what Newton's methods need of them, in products over all at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.estimators.constraints.constraints import PsdConstraint

__all__ = ["Matrices"]

Array = NDArray[np.float64]
Index = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Matrices:
    """Matrices of one size, each on as many components of x: ``columns`` (K, c), ``slopes`` (K, c, s, s).

    ``offset`` (K, s, s) are the matrices at zero, ``share`` (K) is the weight of each in the barrier.
    """

    columns: Index
    slopes: Array
    offset: Array
    share: Array

    @classmethod
    def of(cls, columns: Sequence[Index], alike: Sequence[PsdConstraint]) -> Matrices:
        """Stack constraints on matrices of one size, each of which depends on its ``columns`` (c) of x."""
        pairs = list(zip(columns, alike, strict=True))
        return cls(
            np.concatenate([np.tile(own, (len(one.slopes), 1)) for own, one in pairs]),
            np.concatenate([np.moveaxis(one.slopes[..., own], -1, 1) for own, one in pairs]),
            np.concatenate([one.constant for one in alike]),
            np.concatenate([np.full(len(one.slopes), 1.0 / len(one.slopes)) for one in alike]),
        )

    @cached_property
    def flat(self) -> Array:
        """The slopes as (K, c, s s)."""
        return self.slopes.reshape(*self.columns.shape, self.offset[0].size)

    def change(self, x: Array) -> Array:
        """Return what x (v) adds to the matrices (K, s, s)."""
        return np.asarray((x[self.columns][:, None] @ self.flat).reshape(self.offset.shape))

    def root(self, x: Array) -> Array:
        """Return the Cholesky factors (K, s, s) at x (v); LinAlgError outside."""
        return np.asarray(np.linalg.cholesky(self.offset + self.change(x)))

    def turned(self, inverse: Array) -> Array:
        """Return the slopes (K, c, s s) between matrices (K, s, s) and their transposes."""
        between = inverse[:, None] @ self.slopes @ np.swapaxes(inverse, -1, -2)[:, None]
        return np.asarray(between.reshape(self.flat.shape))

    def add_gradient(self, total: Array, slopes: Array, by: Array) -> None:
        """Add the products of slopes (K, c, s s) and matrices (K, s, s) to ``total`` (v)."""
        found = (slopes @ by.reshape(len(by), -1, 1))[:, :, 0]
        total += np.bincount(self.columns.ravel(), found.ravel(), len(total))

    def add_hessian(self, total: Array, slopes: Array) -> None:
        """Add the products of slopes (K, c, s s) with each other to ``total`` (v, v)."""
        v, found = len(total), slopes @ np.swapaxes(slopes, 1, 2)
        at = self.columns[:, :, None] * v + self.columns[:, None, :]
        total += np.bincount(at.ravel(), found.ravel(), v * v).reshape(v, v)
