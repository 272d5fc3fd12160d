"""Candidate changes: scores of all groups in windows, their covariance, their evidence, and the size of a
change.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache, cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.apps.online.scores import Reference, Scores, Sums
from dynident.regression import GroupKind, ParameterGroup, evidence, rank_of_information
from dynident.runtime import Noun
from dynident.runtime.arrays import Array

MIN_DIRECTION_SHARE = 1e-6  # of the largest information of a direction of the group: less is none
BLOCKS_PER_HOUR = 720  # blocks that are drawn together, with one scatter
SIMULATED_HOURS = 160
EXCEEDED_SHARE = 0.3  # share of the hours that exceed the evidence at which chance alarms are counted
MAX_WINDOW = 512  # blocks of the windows in the draws
# evidence that one block counts as at most, in each group: what is there in it alone is no change
MAX_BLOCK_EVIDENCE = 12.0
MIN_INFORMATION_SHARE = 1e-6  # of the largest information of a group's directions: less is none
RESIDUAL_TOLERANCE = 0.1  # by which the logarithm of what is left of the torque may wander without being a change
MIN_POSITIVE = 1e-300


def gains(scores: Array, information: Array, covariance: Array) -> tuple[Array, NDArray[np.intp]]:
    """Return u' V^-1 u (S) of scores u (S, k) with ``covariance`` V (S, k, k), and the ranks (S).

    Only directions count in which the ``information`` (S, k, k) is not too small for rounding.
    """
    # a unit diagonal: ranks must not depend on the units of the directions
    scale = np.sqrt(np.einsum("sii->si", information))
    scale = np.where(scale > 0, scale, 1.0)
    outer = scale[:, :, None] * scale[:, None, :]
    size, axes = np.linalg.eigh(information / outer)
    is_shown = size > MIN_DIRECTION_SHARE * np.maximum(size[:, -1:], 1e-300)
    is_shown &= np.einsum("sii->s", information)[:, None] > 0
    rotated = axes.swapaxes(1, 2) @ (scores / scale)[:, :, None]
    V = axes.swapaxes(1, 2) @ (covariance / outer) @ axes
    are_shown = is_shown[:, :, None] & is_shown[:, None, :]
    # directions left out get a unit variance and a zero score: they add nothing, and the matrix stays invertible
    V = np.where(are_shown, V, 0.0) + np.eye(V.shape[1]) * ~is_shown[:, :, None]
    u = np.where(is_shown[:, :, None], rotated, 0.0)
    return np.einsum("ski,ski->s", u, np.linalg.solve(V, u)), is_shown.sum(axis=1)


def threshold(
    rate: float, block: float, ranks: Sequence[int], dof: float, rng: np.random.Generator, baseline: int
) -> float:
    """Return the evidence that robots without a change reach ``rate`` times a day, for groups of ``ranks``
    directions.

    ``block`` (s) is the length of a block. ``rng`` draws ``SIMULATED_HOURS`` hours without change, each with
    a scatter by ``dof`` degrees of freedom and a reference by ``baseline`` blocks. From the evidence that a
    good part of these hours reach, the rate falls as exp(-x), by the definition of evidence.
    """
    largest = np.zeros(SIMULATED_HOURS)
    for k in sorted(set(ranks)):
        count = list(ranks).count(k)
        for start in range(0, SIMULATED_HOURS, 20):
            hours = min(20, SIMULATED_HOURS - start)
            z = rng.standard_normal((BLOCKS_PER_HOUR, hours, count, k))
            reference_error = rng.standard_normal((hours, count, k)) / np.sqrt(baseline)
            # one scatter for all blocks of an hour, with few degrees of freedom, makes tails heavy
            scatter = dof / rng.chisquare(dof, (hours, count))
            gain = _largest_gain(z, reference_error, baseline) * scatter
            hour_evidence = evidence(gain, k, dof).max(axis=1)
            largest[start : start + hours] = np.maximum(largest[start : start + hours], hour_evidence)
    # at this quantile a good part of the hours has an alarm, so that the simulated rate is accurate
    x = float(np.quantile(largest, 1 - EXCEEDED_SHARE))
    hourly = -np.log(1 - EXCEEDED_SHARE)  # alarms at x in an hour
    daily = hourly * 86_400.0 / (BLOCKS_PER_HOUR * block)
    return x + float(np.log(daily / rate))


def _largest_gain(z: Array, reference_error: Array, baseline: int) -> Array:
    """Return the largest gain (hours, count) over all windows of draws z (blocks, hours, count, k)."""
    total = np.concatenate([np.zeros((1, *z.shape[1:])), np.cumsum(z, axis=0)])
    best, length = np.zeros(z.shape[1:3]), 1
    while length <= min(MAX_WINDOW, len(z)):
        # windows of nearly all lengths: those left out overlap others almost entirely
        sums = total[length:] - total[:-length] + length * reference_error
        best = np.maximum(best, ((sums**2).sum(axis=-1) / (length + length**2 / baseline)).max(axis=0))
        length += max(1, length // 4)
    return best


class ReferenceUpdate(Noun):
    """Estimated difference of robot and reference in ``directions`` (r, k).

    ``size`` (k) has the ``variance`` (k), which is infinite in what the window does not show. ``noise`` (k,
    k) is the part of its covariance that comes from the window's own scatter; the error of the reference (r)
    goes into the size by ``gain`` (k, r).
    """

    directions: Array
    size: Array
    variance: Array
    noise: Array
    gain: Array

    def apply_to(self, reference: Reference) -> Reference:
        """Return the reference after the update: its former error in these directions is gone."""
        D = self.directions
        projection = np.eye(len(D)) - D @ self.gain
        covariance, unknown = (
            projection @ matrix @ projection.T for matrix in (reference.covariance, reference.unknown)
        )
        value = reference.value + D @ self.size
        return replace(reference, value=value, covariance=covariance + D @ self.noise @ D.T, unknown=unknown)


class Candidates(Noun):
    """Groups that may change, of base parameters with ``scale`` (r); groups of residuals are of n joints.

    ``tolerance`` is the torque, in units of the noise, by which each direction may wander without being a
    change.
    """

    groups: tuple[ParameterGroup, ...]
    scale: Array
    tolerance: float

    @cached_property
    def directions(self) -> Array:
        """Directions (r, M) of all groups of base parameters, scaled like these."""
        base = (self.scale[:, None] * group.directions for group in self.groups if is_base_group(group))
        return np.hstack([np.zeros((len(self.scale), 0)), *base])

    @cached_property
    def group_slices(self) -> tuple[slice, ...]:
        """Slice of each group among the directions; empty for a residual."""
        ends = np.cumsum([0, *(group.directions.shape[1] if is_base_group(group) else 0 for group in self.groups)])
        return tuple(slice(*ends[k : k + 2]) for k in range(len(self.groups)))

    @property
    def ranks(self) -> tuple[int, ...]:
        """Number of directions of each group."""
        return tuple(group.directions.shape[1] for group in self.groups)

    def sums(self, reference: Reference, block: Scores) -> Sums:
        """Return a block as sums; its clipped scores are relative to the reference."""
        block_sums = {"information": block.information[None], "samples": np.array([block.samples])}
        information, covariance = self.covariances(reference, block_sums, self.tolerance)
        # limit what one block adds to the evidence of each group: a short disturbance is no lasting change
        u = self.directions.T @ (block.score - block.information @ reference.value)
        for group, part in zip(self.groups, self.group_slices, strict=True):
            if is_base_group(group):
                gain, rank = gains(u[None, part], information[:, part, part], covariance[:, part, part])
                u[part] *= np.sqrt(min(1.0, _max_gain(int(rank[0]), reference.dof) / max(float(gain[0]), MIN_POSITIVE)))
        z = (block.level - reference.level) / reference.level_std
        # levels of residuals in units of their usual spread
        is_known = np.isfinite(z)
        max_z = np.sqrt(_max_gain(1, reference.dof) * (1 + self._residual_wander(reference) ** 2))
        return Sums(
            block.start, block.stop, 1, block.samples, block.information, block.score, u, np.where(is_known, z, 0.0),
            np.where(is_known, np.clip(z, -max_z, max_z), 0.0), is_known.astype(float),
        )  # fmt: skip

    def _residual_wander(self, reference: Reference) -> Array:
        """Return how far (n) the residual level of a joint may be off in all blocks, in spreads of one block."""
        return reference.level_error + RESIDUAL_TOLERANCE / reference.level_std

    def rebase(self, windows: Sequence[Sums], step: Array) -> tuple[Sums, ...]:
        """Return the sums after the reference has moved by a step (r), with scores relative to the new one."""
        projection = self.directions.T
        return tuple(replace(sums, clipped=sums.clipped - projection @ (sums.information @ step)) for sums in windows)

    def evidence(self, reference: Reference, sums: Mapping[str, Array], *, clipped: bool) -> Array:
        """Return the evidence (G, S) of a change of each group alone in S windows.

        With ``clipped``, no block counts much. A large change fills every block to that limit in all groups:
        which group it is, the unclipped evidence tells.
        """
        information, covariance = self.covariances(reference, sums, self.tolerance)
        unclipped = (sums["score"] - sums["information"] @ reference.value) @ self.directions
        # clipped scores show that there is a change, unclipped ones which it is
        scores, residuals = (sums["clipped"], sums["clipped_level"]) if clipped else (unclipped, sums["level"])
        gains_and_ranks = [
            gains(scores[:, part], information[:, part, part], covariance[:, part, part])
            if is_base_group(group)
            else self._residual_gains(reference, residuals, sums["level_count"], residual_joint(group))
            for group, part in zip(self.groups, self.group_slices, strict=True)
        ]
        return np.stack([evidence(gain, rank, reference.dof) for gain, rank in gains_and_ranks])

    def covariances(
        self, reference: Reference, sums: Mapping[str, Array], tolerance: float = 0.0
    ) -> tuple[Array, Array]:
        """Return information and covariance (S, M, M) of the scores in all directions in S windows.

        The covariance allows for the scatter of blocks, the error of the reference, and a tolerance.
        """
        root, AD = np.sqrt(reference.spread), sums["information"] @ self.directions
        information = self.directions.T @ AD
        squares = np.einsum("smm->sm", information) / sums["samples"][:, None]
        largest = squares.max(axis=1, keepdims=True, initial=MIN_POSITIVE)
        variances = tolerance**2 / np.maximum(squares, MIN_INFORMATION_SHARE * largest)
        # each direction may wander by the tolerance: its variance is larger where a window holds less information
        error = AD.swapaxes(1, 2) @ reference.covariance @ AD + information @ (variances[:, :, None] * information)
        # scatter of blocks, error of the reference and the tolerance add up
        return information, information * root[:, None] * root + error

    def estimate_update(
        self, reference: Reference, sums: Mapping[str, Array], group_indices: Sequence[int]
    ) -> ReferenceUpdate:
        """Estimate by how much some groups together differ from the reference in a window."""
        columns = np.concatenate([np.r_[self.group_slices[g]] for g in group_indices])
        D, root = self.directions[:, columns], np.sqrt(reference.spread[columns])
        information, covariance = (matrix[0][np.ix_(columns, columns)] for matrix in self.covariances(reference, sums))
        # directions that the window does not show keep the reference's value: they are left out of the inverse
        rank = rank_of_information(information, tolerance=MIN_INFORMATION_SHARE)
        inverse, unresolved_axes = rank.inverse, rank.vectors[:, rank.rank :]
        # a parameter counts as shown where it has hardly any part in the directions left out
        is_shown, A = (unresolved_axes**2).sum(axis=1) < MIN_INFORMATION_SHARE, sums["information"][0]
        return ReferenceUpdate(
            directions=D,
            size=inverse @ (D.T @ (sums["score"][0] - A @ reference.value)),
            variance=np.where(is_shown, np.diag(inverse @ covariance @ inverse), np.inf),
            noise=inverse @ (information * root[:, None] * root) @ inverse,
            gain=inverse @ D.T @ A,
        )

    def residual_change(
        self, reference: Reference, sums: Mapping[str, Array], group: ParameterGroup
    ) -> tuple[Array, Array]:
        """Return the change of the logarithm of a joint's residual (rms) in a window (1), and its error."""
        j = residual_joint(group)
        count, spread = sums["level_count"][0, j], reference.level_std[j] / 2  # of a mean square it is twice
        return spread * sums["level"][0, [j]] / count, np.array([spread / np.sqrt(count)])

    def _residual_gains(
        self, reference: Reference, residuals: Array, counts: Array, j: int
    ) -> tuple[Array, NDArray[np.intp]]:
        """Return the gains and ranks (S) of a change of a joint's residual."""
        count, std = counts[:, j], float(reference.level_std[j])
        is_known = (count > 0) & np.isfinite(std)
        variance = count + (count * self._residual_wander(reference)[j]) ** 2 if np.isfinite(std) else count
        gain = np.divide(residuals[:, j] ** 2, variance, out=np.zeros(len(count)), where=is_known)
        return gain, is_known.astype(np.intp)


@cache
def _max_gain(rank: int, dof: float) -> float:
    """Return the gain that has the evidence ``MAX_BLOCK_EVIDENCE``."""
    from scipy.special import fdtri

    return rank * float(fdtri(rank, dof, -np.expm1(-MAX_BLOCK_EVIDENCE))) if rank else np.inf


def is_base_group(group: ParameterGroup) -> bool:
    """Return whether a group is of base parameters."""
    return group.kind is not GroupKind.RESIDUAL


def residual_joint(group: ParameterGroup) -> int:
    """Return the index of the joint of a residual."""
    return int(np.argmax(group.directions[:, 0]))
