"""The rank of a regressor: which directions of the parameters its rows determine, and which they leave free."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.models import INERTIAL, Parameter
from dynident.runtime import ConfigError, Noun
from dynident.runtime.arrays import Array

ANGLES = 1e-5  # rad: precision of the angles in robot files; the error of 3.1416 is 7e-6
ARITHMETIC = 1e-12  # double precision, after sums over many rows
SQUARED = 1e-12  # the same for an information matrix, which squares all ratios
MAX_EMPTY_RATIO = 1e-14  # a column this small relative to the largest is rounding error
TIE_LIMITS = (1e-6, 1e-2)  # entries of the projector on the undetermined space above which two parameters are tied
KINDS = (INERTIAL[:1], INERTIAL[1:4], INERTIAL[4:])  # mass, first and second moments: of one unit each


class Rank(Noun):
    """The ``rank`` r of a factor, and the directions of the parameters (p) that it determines and leaves free.

    ``scale`` (p) divides the factor's columns; ``values`` (p) are the singular values of the scaled factor, in
    descending order, with their ``left_vectors`` (p, p) and right ``vectors`` (p, p) as columns. Values below
    ``tolerance`` times the largest count as zero. ``unweighted`` is the rank without weights of the rows, where there
    are any.
    """

    rank: int
    scale: Array
    values: Array
    left_vectors: Array
    vectors: Array
    tolerance: float
    unweighted: Rank | None = None

    @property
    def determined_directions(self) -> Array:
        """Directions (p, r) that act on the torque, in the parameters' units."""
        return self.vectors[:, : self.rank] / self.scale[:, None]

    @property
    def free_directions(self) -> Array:
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
        null = self.vectors[:, self.rank :]
        return tuple(map(tuple, tied_groups(null @ null.T, self._tie)))

    @property
    def undetermined_mask(self) -> NDArray[np.bool_]:
        """Whether each parameter (p) is in one of the groups, so that the data do not determine its value."""
        out = np.zeros(len(self.values), dtype=bool)
        out[[k for group in self.groups for k in group]] = True
        return out

    @property
    def _tie(self) -> float:
        return float(np.clip(100 * self.tolerance, *TIE_LIMITS))

    def spanning_directions(self, axes: NDArray[np.bool_]) -> Array:
        """Return orthonormal directions (p, v) that span the determined ones and the parameters ``axes`` (p)."""
        alone = axes | ~self.undetermined_mask
        tied = np.flatnonzero(~alone)
        # of the tied parameters, the directions that have a share in the determined ones
        rotation, share, _ = np.linalg.svd(self.vectors[tied, : self.rank], full_matrices=False)
        mixed = rotation[:, share**2 > self._tie] / self.scale[tied, None]
        out = np.zeros((len(alone), mixed.shape[1]))
        out[tied] = np.linalg.qr(mixed)[0]
        return np.concatenate([np.eye(len(alone))[:, alone], out], axis=1)

    @property
    def inverse(self) -> Array:
        """(X' X)^-1 on the determined directions, (p, p), in the parameters' units."""
        # the inverse by its square root, so that the condition is not squared
        half = self.determined_directions / self.values[: self.rank]
        return np.asarray(half @ half.T)

    def covariance(self, variance: float = 1.0) -> Array:
        """Return ``variance`` times the inverse, with infinite variances of undetermined parameters."""
        undetermined = self.undetermined_mask
        out = np.where(undetermined | undetermined[:, None], 0.0, variance * self.inverse)
        out[undetermined, undetermined] = np.inf
        return out

    def with_information(self, information: Array, tolerance: float = SQUARED) -> Rank:
        """Return the rank of an information matrix (p, p) on the determined directions; the others remain free."""
        directions = self.vectors[:, : self.rank]
        squares, turn = np.linalg.eigh(directions.T @ (information / np.outer(self.scale, self.scale)) @ directions)
        squares, turn = squares[::-1], turn[:, ::-1]
        values = np.concatenate([np.sqrt(np.maximum(squares, 0.0)), np.zeros(len(self.scale) - self.rank)])
        vectors = np.concatenate([directions @ turn, self.vectors[:, self.rank :]], axis=1)
        retained = int((squares > tolerance * squares[0]).sum()) if self.rank and squares[0] > 0 else 0
        return Rank(retained, self.scale, values, vectors, vectors, self.tolerance, self.unweighted)


def tied_groups(projector: Array, limit: float) -> list[list[int]]:
    """Return the sets of rows that a projector ties together, by entries above a limit."""
    from scipy.sparse.csgraph import connected_components

    tied = np.abs(projector) > limit
    _, label = connected_components(tied, directed=False)
    return [np.flatnonzero(label == group).tolist() for group in sorted(set(label[tied.any(axis=1)]))]


def precision(parameters: Sequence[Parameter]) -> float:
    """Return the relative precision of a model's regressor: that of a robot file, or double precision."""
    return ANGLES if any(x.role in INERTIAL for x in parameters) else ARITHMETIC


def rank_of(
    factor: Array, parameters: Sequence[Parameter] = (), tolerance: float | None = None, unweighted: Rank | None = None
) -> Rank:
    """Return the rank of a triangular factor, (p, p) or with the torque (p + 1, p + 1), of a regressor.

    ``tolerance``: share of the largest singular value that counts as zero; None takes the ``precision`` of the
    parameters (double precision where they are not given). Weights of the rows amplify rounding together with small
    effects, so that they must not decide: with ``unweighted``, the rank without weights, only what is below double
    precision is dropped in addition. Raises ConfigError for a tolerance outside (0, 1).
    """
    if tolerance is not None and not 0 < tolerance < 1:
        raise ConfigError(f"tolerance of the rank is {tolerance}; give a number between 0 and 1, such as 1e-12.")
    p = len(parameters) or len(factor) - 1
    limit = precision(parameters) if tolerance is None else tolerance
    R = factor[:p, :p]
    scale, empty = _column_scales(np.linalg.norm(R, axis=0), parameters)
    # directions that have no effect without weights have none with them
    free_count = 0 if unweighted is None else p - unweighted.rank
    # directions without effect, then all others, orthonormal in these units
    turn = (
        np.eye(p)
        if unweighted is None
        else np.linalg.qr(unweighted.free_directions * scale[:, None], mode="complete")[0]
    )
    U, s, Vt = np.linalg.svd(np.where(empty, 0.0, R / scale) @ turn[:, free_count:])
    rank = int((s > (limit if unweighted is None else ARITHMETIC) * s[0]).sum()) if len(s) and s[0] > 0 else 0
    vectors = np.concatenate([turn[:, free_count:] @ Vt.T, turn[:, :free_count]], axis=1)
    vectors[empty, :rank] = 0.0  # a zero column has no share in any direction
    # the values of free directions keep their ratio, and stay below all others
    dropped_values = (
        np.zeros(0)
        if unweighted is None
        else unweighted.values[unweighted.rank :] / (unweighted.values[0] or 1.0) * s.max(initial=0.0)
    )
    values = np.concatenate([s, np.minimum(dropped_values, s.min(initial=np.inf))])
    return Rank(rank, scale, values, U, vectors, limit, unweighted)


def rank_of_information(information: Array, parameters: Sequence[Parameter] = (), tolerance: float = SQUARED) -> Rank:
    """Return the rank of an information matrix X' X (p, p), which has half of the digits of X.

    ``tolerance``: share of the largest eigenvalue that counts as zero, with ones on the diagonal.
    """
    p = len(information)
    scale, empty = _column_scales(np.sqrt(np.maximum(np.diag(information), 0.0)), parameters)
    full_rank = Rank(p, scale, np.ones(p), np.eye(p), np.eye(p), precision(parameters))
    return full_rank.with_information(np.where(empty | empty[:, None], 0.0, information), tolerance)


def _column_scales(effect: Array, parameters: Sequence[Parameter]) -> tuple[Array, NDArray[np.bool_]]:
    """Return the scale of each column (p), and whether the column is zero."""
    scale = effect.copy()
    # inertial parameters of one kind share the scale of their largest effect (see above)
    for kind in KINDS:
        alike = [k for k, x in enumerate(parameters) if x.role in kind]
        scale[alike] = effect[alike].max(initial=0.0)
    empty = (effect <= MAX_EMPTY_RATIO * effect.max(initial=0.0)) | (scale == 0)
    return np.where(empty & (scale == 0), 1.0, scale), empty
