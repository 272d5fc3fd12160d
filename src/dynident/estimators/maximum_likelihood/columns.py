"""Which columns of the regressor the normal equations multiply: those that are independent."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr, solve_triangular

from dynident.models import Model

__all__ = ["Columns"]

Array = NDArray[np.float64]
STATES = 60  # random ones, for n rows each
ROUNDING = 1e-12  # share of the largest column below which nothing is left of one


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
        reach = np.array([np.pi if joint.kind == "revolute" else 1.0 for joint in model.joints])
        states = np.random.default_rng(0).uniform(-1.0, 1.0, (3, STATES, len(reach))) * reach
        Y = model.regressor(*states)[:, :, bodies].reshape(-1, len(bodies))
        scale = np.linalg.norm(Y, axis=0)
        R, order = qr(Y / np.where(scale > 0, scale, 1.0), mode="r", pivoting=True)
        rank = int((np.abs(np.diag(R)) > ROUNDING * abs(R[0, 0])).sum())
        lead, rest = bodies[order[:rank]], bodies[order[rank:]]
        combination = np.eye(p)
        shares = solve_triangular(R[:rank, :rank], R[:rank, rank:])
        combination[np.ix_(lead, rest)] = shares * scale[order[rank:]] / scale[order[:rank], None]
        kept = np.setdiff1d(np.arange(p), rest)
        return cls(kept, combination[kept])

    def of(self, Y: Array) -> Array:
        """Return the columns of a regressor (N, n, p)."""
        return Y if len(self.kept) == Y.shape[2] else Y[:, :, self.kept]
