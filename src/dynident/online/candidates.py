"""The changes that are tried: scores of all groups in windows, their covariance, their evidence, and sizes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.online.evidence import evidence, gains
from dynident.online.reference import Reference
from dynident.online.scores import Scores
from dynident.online.windows import Sums
from dynident.regression import Group, GroupKind

__all__ = ["Candidates", "Move"]

Array = NDArray[np.float64]
CLIP = 12.0  # evidence that one block counts as at most, in each group: what is there in it alone is no change
SHOWN = 1e-6  # of the largest information of a group's directions: less is none
LOUDNESS = 0.1  # by which the logarithm of what is left of the torque may wander without being a change
TINY = 1e-300


@dataclass(frozen=True, eq=False)
class Move:
    """By how much robot and reference differ in ``directions`` (r, k): ``size`` (k), with its ``variance`` (k), which
    is infinite in what the window does not show. ``noise`` (k, k) is the part of its covariance that the window's own
    scatter makes; the error of the reference (r) goes into the size by ``gain`` (k, r)."""

    directions: Array
    size: Array
    variance: Array
    noise: Array
    gain: Array

    __repr__ = brief

    def of(self, reference: Reference) -> Reference:
        """Return the reference after it: its former error in these directions is gone."""
        D = self.directions
        rest = np.eye(len(D)) - D @ self.gain
        covariance, unknown = (rest @ one @ rest.T for one in (reference.covariance, reference.unknown))
        value = reference.value + D @ self.size
        return replace(reference, value=value, covariance=covariance + D @ self.noise @ D.T, unknown=unknown)


@dataclass(frozen=True, eq=False)
class Candidates:
    """The ``groups`` that may change, of base parameters with ``scale`` (r); groups of residuals are of n joints.

    ``tolerance`` is the torque, in units of the noise, by which each direction may wander without being a change.
    """

    groups: tuple[Group, ...]
    scale: Array
    tolerance: float

    __repr__ = brief

    @cached_property
    def directions(self) -> Array:
        """The directions (r, M) of all groups of base parameters, scaled as these."""
        none = np.zeros((len(self.scale), 0))
        return np.hstack([none, *(self.scale[:, None] * one.directions for one in self.groups if is_base(one))])

    @cached_property
    def parts(self) -> tuple[slice, ...]:
        """Where each group is among the directions; nowhere that of a residual."""
        ends = np.cumsum([0, *(one.directions.shape[1] if is_base(one) else 0 for one in self.groups)])
        return tuple(slice(*ends[k : k + 2]) for k in range(len(self.groups)))

    @property
    def ranks(self) -> tuple[int, ...]:
        """The number of directions of each group."""
        return tuple(one.directions.shape[1] for one in self.groups)

    def sums(self, reference: Reference, block: Scores) -> Sums:
        """Return a block as sums; its clipped scores are those beside the reference."""
        one = {"information": block.information[None], "samples": np.array([block.samples])}
        own, covariance = self.covariances(reference, one, self.tolerance)
        u = self.directions.T @ (block.score - block.information @ reference.value)
        for group, part in zip(self.groups, self.parts, strict=True):
            if is_base(group):
                gain, rank = gains(u[None, part], own[:, part, part], covariance[:, part, part])
                u[part] *= np.sqrt(min(1.0, _most(int(rank[0]), reference.dof) / max(float(gain[0]), TINY)))
        z = (block.left - reference.left) / reference.left_std
        known = np.isfinite(z)
        most = np.sqrt(_most(1, reference.dof) * (1 + self._wander(reference) ** 2))
        return Sums(
            block.start, block.stop, 1, block.samples, block.information, block.score, u, np.where(known, z, 0.0),
            np.where(known, np.clip(z, -most, most), 0.0), known.astype(float),
        )  # fmt: skip

    def _wander(self, reference: Reference) -> Array:
        """Return how far (n) what is left of a joint's torque may be off in all blocks, in spreads of one."""
        return reference.left_error + LOUDNESS / reference.left_std

    def rebased(self, kept: Sequence[Sums], step: Array) -> tuple[Sums, ...]:
        """Return sums after the reference has moved by a step (r): scores are beside the new one."""
        move = self.directions.T
        return tuple(replace(one, clipped=one.clipped - move @ (one.information @ step)) for one in kept)

    def evidence(self, reference: Reference, sums: Mapping[str, Array], *, clipped: bool) -> Array:
        """Return the evidence (G, S) of a change of each group alone in S windows; ``clipped``: no block counts much.

        Large changes fill every block to that limit in all groups: which it is, the other evidence says.
        """
        own, covariance = self.covariances(reference, sums, self.tolerance)
        whole = (sums["score"] - sums["information"] @ reference.value) @ self.directions
        scores, left = (sums["clipped"], sums["left_clipped"]) if clipped else (whole, sums["left"])
        found = [
            gains(scores[:, part], own[:, part, part], covariance[:, part, part])
            if is_base(group)
            else self._louder(reference, left, sums["left_count"], joint_of(group))
            for group, part in zip(self.groups, self.parts, strict=True)
        ]
        return np.stack([evidence(gain, rank, reference.dof) for gain, rank in found])

    def covariances(
        self, reference: Reference, sums: Mapping[str, Array], tolerance: float = 0.0
    ) -> tuple[Array, Array]:
        """Return information and covariance (S, M, M) of the scores in all directions in S windows: by the scatter of
        blocks, the error of the reference, and a tolerance."""
        root, AD = np.sqrt(reference.spread), sums["information"] @ self.directions
        own = self.directions.T @ AD
        square = np.einsum("smm->sm", own) / sums["samples"][:, None]
        wander = tolerance**2 / np.maximum(square, SHOWN * square.max(axis=1, keepdims=True, initial=TINY))
        error = AD.swapaxes(1, 2) @ reference.covariance @ AD + own @ (wander[:, :, None] * own)
        return own, own * root[:, None] * root + error

    def move(self, reference: Reference, sums: Mapping[str, Array], taken: Sequence[int]) -> Move:
        """Return by how much the groups ``taken`` differ together from the reference in a window."""
        at = np.concatenate([np.arange(*self.parts[g].indices(self.directions.shape[1])) for g in taken])
        D, root = self.directions[:, at], np.sqrt(reference.spread[at])
        own, covariance = (one[0][np.ix_(at, at)] for one in self.covariances(reference, sums))
        scale = np.sqrt(np.maximum(np.diag(own), TINY))
        size, axes = np.linalg.eigh(own / np.outer(scale, scale))
        kept = size > SHOWN * max(float(size[-1]), TINY)
        inverse = (axes[:, kept] / size[kept]) @ axes[:, kept].T / np.outer(scale, scale)
        shown, A = (axes[:, ~kept] ** 2).sum(axis=1) < SHOWN, sums["information"][0]
        return Move(
            directions=D,
            size=inverse @ (D.T @ (sums["score"][0] - A @ reference.value)),
            variance=np.where(shown, np.diag(inverse @ covariance @ inverse), np.inf),
            noise=inverse @ (own * root[:, None] * root) @ inverse,
            gain=inverse @ D.T @ A,
        )

    def louder(self, reference: Reference, sums: Mapping[str, Array], group: Group) -> tuple[Array, Array]:
        """Return by how much the logarithm of a joint's residual (rms) has changed in a window (1), and its error."""
        j = joint_of(group)
        count, spread = sums["left_count"][0, j], reference.left_std[j] / 2  # of a mean square it is twice
        return spread * sums["left"][0, [j]] / count, np.array([spread / np.sqrt(count)])

    def _louder(self, reference: Reference, left: Array, counts: Array, j: int) -> tuple[Array, NDArray[np.intp]]:
        """Return the gains and ranks (S) of a change of what is left of a joint's torque."""
        count, std = counts[:, j], float(reference.left_std[j])
        known = (count > 0) & np.isfinite(std)
        variance = count + (count * self._wander(reference)[j]) ** 2 if np.isfinite(std) else count
        return np.divide(left[:, j] ** 2, variance, out=np.zeros(len(count)), where=known), known.astype(np.intp)


@cache
def _most(rank: int, dof: float) -> float:
    """Return the gain of that evidence."""
    from scipy.special import fdtri

    return rank * float(fdtri(rank, dof, -np.expm1(-CLIP))) if rank else np.inf


def is_base(group: Group) -> bool:
    """Return whether a group is of base parameters."""
    return group.kind is not GroupKind.RESIDUAL


def joint_of(group: Group) -> int:
    """Return the number of the joint of a residual."""
    return int(np.argmax(group.directions[:, 0]))
