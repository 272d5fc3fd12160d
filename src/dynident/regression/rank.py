"""Rank: which directions of the parameters act on the torque, and which are only rounding; used by all estimators.

In a robot file whose angles are rounded to the precision eps (rad), a column that should be zero is about eps times the
columns of other axes. Inertial parameters are therefore not scaled by their own column, which would amplify this
rounding to the size of data, but by the largest effect of a parameter of their kind (mass, first or second moment) on
the torque. By Weyl's inequality, singular values that should be zero then stay below about eps times the largest. All
else in a model is exact to double precision, as are models without a robot file.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError, brief
from dynident.models import INERTIAL, Parameter

__all__ = ["Rank", "precision", "rank_of", "rank_of_information"]

Array = NDArray[np.float64]
ANGLES = 1e-5  # rad: precision of the angles in robot files; the error of 3.1416 is 7e-6
ARITHMETIC = 1e-12  # double precision, after sums over many rows
SQUARED = 1e-12  # the same for an information matrix, which squares all ratios
EMPTY = 1e-14  # a column this small relative to the largest is rounding error
TIED = (1e-6, 1e-2)  # entries of the projector on the undetermined space above which two parameters are tied
KINDS = (INERTIAL[:1], INERTIAL[1:4], INERTIAL[4:])  # mass, first and second moments: of one unit each


@dataclass(frozen=True, eq=False)
class Rank:
    """The ``rank`` r of a factor, and the directions of the parameters (p) that it determines and leaves free.

    ``scale`` (p) divides the factor's columns; ``values`` (p) are the singular values of the scaled factor, in
    descending order, with their ``left`` (p, p) and right ``vectors`` (p, p) as columns. ``tolerance``: values below
    this share of the largest count as zero. ``unweighted`` is the rank without weights of the
    rows, where there are any.
    """

    rank: int
    scale: Array
    values: Array
    left: Array
    vectors: Array
    tolerance: float
    unweighted: Rank | None = None

    __repr__ = brief

    @property
    def determined(self) -> Array:
        """Directions (p, r) that act on the torque, in the parameters' units."""
        return self.vectors[:, : self.rank] / self.scale[:, None]

    @property
    def free(self) -> Array:
        """Directions (p, p - r) that do not act on the torque, in the parameters' units."""
        return self.vectors[:, self.rank :] / self.scale[:, None]

    @property
    def condition(self) -> float:
        """Ratio of the largest to the smallest of all singular values, inf where one is zero."""
        with np.errstate(over="ignore"):
            return float(self.values[0] / self.values[-1]) if len(self.values) and self.values[-1] > 0 else np.inf

    @cached_property
    def groups(self) -> tuple[tuple[int, ...], ...]:
        """Sets of parameters of which only combinations are identifiable; single ones have no effect."""
        if self.rank == len(self.values):
            return ()
        from scipy.sparse.csgraph import connected_components

        null = self.vectors[:, self.rank :]
        tied = np.abs(null @ null.T) > self._tie
        _, label = connected_components(tied, directed=False)
        involved = tied.any(axis=1)
        return tuple(tuple(np.flatnonzero(label == one).tolist()) for one in sorted(set(label[involved])))

    @property
    def undetermined(self) -> NDArray[np.bool_]:
        """Whether each parameter (p) is in one of the groups, so that the data do not determine its value."""
        out = np.zeros(len(self.values), dtype=bool)
        out[[k for group in self.groups for k in group]] = True
        return out

    @property
    def _tie(self) -> float:
        return float(np.clip(100 * self.tolerance, *TIED))

    def reached(self, axes: NDArray[np.bool_]) -> Array:
        """Return orthonormal directions (p, v) that span the determined ones and the parameters ``axes`` (p)."""
        alone = axes | ~self.undetermined
        rest = np.flatnonzero(~alone)
        turned, share, _ = np.linalg.svd(self.vectors[rest, : self.rank], full_matrices=False)
        mixed = turned[:, share**2 > self._tie] / self.scale[rest, None]
        out = np.zeros((len(alone), mixed.shape[1]))
        out[rest] = np.linalg.qr(mixed)[0]
        return np.concatenate([np.eye(len(alone))[:, alone], out], axis=1)

    @property
    def inverse(self) -> Array:
        """(X' X)^-1 on the determined directions, (p, p), in the parameters' units."""
        half = self.determined / self.values[: self.rank]
        return np.asarray(half @ half.T)

    def covariance(self, variance: float = 1.0) -> Array:
        """Return ``variance`` times the inverse, with infinite variances of undetermined parameters."""
        free = self.undetermined
        out = np.where(free | free[:, None], 0.0, variance * self.inverse)
        out[free, free] = np.inf
        return out

    def within(self, information: Array) -> Rank:
        """Return the rank of an information matrix (p, p) on the determined directions; the others remain free."""
        known = self.vectors[:, : self.rank]
        squares, turn = np.linalg.eigh(known.T @ (information / np.outer(self.scale, self.scale)) @ known)
        squares, turn = squares[::-1], turn[:, ::-1]
        values = np.concatenate([np.sqrt(np.maximum(squares, 0.0)), np.zeros(len(self.scale) - self.rank)])
        vectors = np.concatenate([known @ turn, self.vectors[:, self.rank :]], axis=1)
        kept = int((squares > SQUARED * squares[0]).sum()) if self.rank and squares[0] > 0 else 0
        return Rank(kept, self.scale, values, vectors, vectors, self.tolerance, self.unweighted)


def precision(parameters: Sequence[Parameter]) -> float:
    """Return the relative precision of a model's regressor: that of a robot file, or double precision."""
    return ANGLES if any(x.role in INERTIAL for x in parameters) else ARITHMETIC


def rank_of(
    factor: Array, parameters: Sequence[Parameter] = (), tolerance: float | None = None, shown: Rank | None = None
) -> Rank:
    """Return the rank of a triangular factor, (p, p) or with the torque (p + 1, p + 1), of a regressor.

    ``tolerance``: share of the largest singular value that counts as zero; None takes the ``precision`` of the
    parameters (double precision where they are not given). Weights of the rows amplify rounding together with small
    effects, so that they must not decide: with ``shown``, the rank without weights, only what is below double precision
    is dropped in addition. Raises ConfigError for a tolerance outside (0, 1).
    """
    if tolerance is not None and not 0 < tolerance < 1:
        raise ConfigError(f"tolerance of the rank is {tolerance}; give a number between 0 and 1, such as 1e-12.")
    p = len(parameters) or len(factor) - 1
    limit = precision(parameters) if tolerance is None else tolerance
    R = factor[:p, :p]
    scale, empty = _measured(np.linalg.norm(R, axis=0), parameters)
    none = 0 if shown is None else p - shown.rank
    # directions without effect, then all others, orthonormal in these units
    turn = np.eye(p) if shown is None else np.linalg.qr(shown.free * scale[:, None], mode="complete")[0]
    U, s, Vt = np.linalg.svd(np.where(empty, 0.0, R / scale) @ turn[:, none:])
    rank = int((s > (limit if shown is None else ARITHMETIC) * s[0]).sum()) if len(s) and s[0] > 0 else 0
    vectors = np.concatenate([turn[:, none:] @ Vt.T, turn[:, :none]], axis=1)
    vectors[empty, :rank] = 0.0  # a zero column has no share in any direction
    rest = np.zeros(0) if shown is None else shown.values[shown.rank :] / (shown.values[0] or 1.0) * s.max(initial=0.0)
    values = np.concatenate([s, np.minimum(rest, s.min(initial=np.inf))])
    return Rank(rank, scale, values, U, vectors, limit, shown)


def rank_of_information(information: Array, parameters: Sequence[Parameter] = ()) -> Rank:
    """Return the rank of an information matrix X' X (p, p), which has half of the digits of X."""
    p = len(information)
    scale, empty = _measured(np.sqrt(np.maximum(np.diag(information), 0.0)), parameters)
    whole = Rank(p, scale, np.ones(p), np.eye(p), np.eye(p), precision(parameters))
    return whole.within(np.where(empty | empty[:, None], 0.0, information))


def _measured(effect: Array, parameters: Sequence[Parameter]) -> tuple[Array, NDArray[np.bool_]]:
    """Return the scale of each column (p), and whether the column is zero."""
    scale = effect.copy()
    for kind in KINDS:
        alike = [k for k, x in enumerate(parameters) if x.role in kind]
        scale[alike] = effect[alike].max(initial=0.0)
    empty = (effect <= EMPTY * effect.max(initial=0.0)) | (scale == 0)
    return np.where(empty & (scale == 0), 1.0, scale), empty
