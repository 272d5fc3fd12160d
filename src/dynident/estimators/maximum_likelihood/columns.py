"""Which columns of the regressor the normal equations multiply: those that are independent."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.models import Model
from dynident.models.structure import independent

__all__ = ["Columns"]

Array = NDArray[np.float64]
STATES = 120  # random ones, for n rows each; an even number, so that either half has all joints


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

    @classmethod
    def independent(cls, model: Model) -> Columns:
        """Return the columns of a model without those of its bodies that depend on others.

        The columns of rigid bodies are analytic in the states: what holds at enough random ones always holds.
        """
        p = len(model.parameters)
        bodies = np.flatnonzero([bool(one.body) for one in model.parameters])
        if not len(bodies):
            return cls.all(p)
        Y = model.regressor(**model.random_states(np.random.default_rng(0), STATES))[:, :, bodies]
        scale = np.sqrt((Y**2).mean(axis=(0, 1)))
        scale[scale == 0] = 1.0
        lead, shares = independent(Y.swapaxes(0, 1).reshape(-1, len(bodies)) / scale)
        combination = np.eye(p)
        combination[np.ix_(bodies[lead], bodies)] = shares * scale / scale[lead, None]
        kept = np.setdiff1d(np.arange(p), np.delete(bodies, lead))
        return cls(kept, combination[kept])

    def of(self, Y: Array) -> Array:
        """Return the columns of a regressor (N, n, p)."""
        return Y if len(self.kept) == Y.shape[2] else Y[:, :, self.kept]
