"""Which columns of the regressor the normal equations multiply: those that are independent."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Columns"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Columns:
    """The columns ``kept`` (r) of the regressor, from which all p follow: Y = Y[kept] ``combination`` (r, p)."""

    kept: NDArray[np.intp]
    combination: Array

    @classmethod
    def all(cls, p: int) -> Columns:
        """Return all columns of p parameters."""
        return cls(np.arange(p), np.eye(p))

    @classmethod
    def none(cls, p: int) -> Columns:
        """Return no column, where only the trajectory is sought."""
        return cls(np.arange(0), np.zeros((0, p)))

    def of(self, Y: Array) -> Array:
        """Return the columns of a regressor (N, n, p)."""
        return Y if len(self.kept) == Y.shape[2] else Y[:, :, self.kept]
