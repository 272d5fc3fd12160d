"""The linear problem y = X theta + e, eqs. (9)-(10): streamed block by block to one triangular factor per joint."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.models import Model, Structure
from dynident.models.evaluation import check_memory
from dynident.motion.log import Motion
from dynident.motion.splines import stretches
from dynident.regression.triangular import EntryBlock, TriangularFactors, factorise
from dynident.regression.whitening import ParallelFilter, PlacedBlock, Whitening, whiten_blocks
from dynident.runtime import ConfigError, InputError, Noun
from dynident.runtime.arrays import Array
from dynident.runtime.jobs import Status, run_jobs

BLOCK = 2048  # samples whose entries stay in the cache while they are factorised
BLOCK_ENTRIES = 50_000  # in a block: more samples where each has few


class RegressorBlock(Noun):
    """Some rows of the problem: ``Y`` (B, n, p), ``tau`` (B, n), and which of them to use, ``keep`` (B, n) or all."""

    Y: Array
    tau: Array
    keep: NDArray[np.bool_] | None = None


@dataclass(frozen=True)
class Selection:
    """Which samples a fit uses, and how its rows are filtered.

    ``min_speed`` (n), in rad/s or m/s, leaves out of each joint's equation the samples at which that joint is slower,
    where the friction model is poor; None leaves none out. ``filter`` is the low-pass and decimation of all rows.
    """

    filter: ParallelFilter | None = None
    min_speed: tuple[float, ...] | None = None

    @property
    def unfiltered(self) -> Selection:
        """The same samples, unfiltered: what is calibrated before a fit needs no filter."""
        return self if self.filter is None else Selection(None, self.min_speed)


EVERYTHING = Selection()


class Regression(Noun):
    """The torque equation of a model over any number of motions; only samples inside the masks are used.

    The matrix is never formed whole: ``blocks`` computes it a few thousand samples at a time, on every call;
    ``triangular_factors`` caches its triangular factors. ``selection`` says which samples count, and how rows are
    filtered.
    ``whitening`` makes the rows independent where their noise is not, after any filter; row j is then no longer of
    joint j alone. ``weights`` multiply the rows of each motion, one (N, n) for each, after that; empty: all rows count
    the same.
    ``bias`` (p) is taken off the solution: the torque is that of the motions less Y bias.
    """

    model: Model
    motions: tuple[Motion, ...]
    selection: Selection = EVERYTHING
    weights: tuple[Array, ...] = ()
    bias: Array | None = None
    whitening: Whitening | None = None

    def __post_init__(self) -> None:
        names = tuple(joint.name for joint in self.model.joints)
        for motion in self.motions:
            if motion.joints != names:
                raise InputError(f"{motion.source}: has the joints {motion.joints}, the model {names}.")
            check_memory(self.model, motion.memory, len(motion))
        if self.min_speed is not None and not (len(self.min_speed) == len(names) and min(self.min_speed) >= 0):
            raise ConfigError(
                f"min_speed = {self.min_speed}: give a speed >= 0 for each of the joints {', '.join(names)}."
            )
        shapes = [motion.q.shape for motion in self.motions]
        if self.weights and [weight.shape for weight in self.weights] != shapes:
            raise ConfigError(f"weights have shapes {[w.shape for w in self.weights]}, the motions {shapes}.")
        if self.whitening is not None and len(self.whitening.coefficients) != len(names):
            raise ConfigError(f"whitening is of {len(self.whitening.coefficients)} joints, the model has {len(names)}.")

    @property
    def usable_samples(self) -> int:
        """The number of samples inside the masks."""
        return sum(int(motion.mask.sum()) for motion in self.motions)

    @property
    def filter(self) -> ParallelFilter | None:
        """The low-pass and decimation of all rows."""
        return self.selection.filter

    @property
    def min_speed(self) -> tuple[float, ...] | None:
        """The speed (n) below which the equation of a joint is left out."""
        return self.selection.min_speed

    def blocks(self) -> Iterator[RegressorBlock]:
        """Yield the rows block by block, filtered and decimated where ``filter`` says so, and weighted."""
        for block in self.entries():
            yield RegressorBlock(block.regressor(), block.tau.T, None if block.keep is None else block.keep.T)

    def entries(
        self, structure: Structure | None = None, theta: Array | None = None, within: tuple[int, slice] | None = None
    ) -> Iterator[EntryBlock]:
        """Yield the same rows as entries of a ``structure``, by default that of the model.

        The torque is less Y theta, where ``theta`` (p) is given. ``within`` is the index of a motion and the samples
        to take: those around them still count in the filter.
        """
        for _, _, block in self.placed_blocks(structure or self.model.structure, theta, within):
            yield block

    @cached_property
    def structure(self) -> Structure:
        """The structure of the rows: that of the model, or what whitening makes of it."""
        plain = self.model.structure
        return plain if self.whitening is None else self.whitening.structure(plain)

    def residuals(self, theta: Array) -> Iterator[tuple[int, slice, Array, NDArray[np.bool_] | None]]:
        """Yield what theta (p) leaves of the torque, (B, n), filtered and weighted, block by block.

        Each entry holds the index of the motion, its samples, the residual, and which of it is used, (B, n) or all.
        """
        for k, rows, block in self.placed_blocks(self.model.structure_with(()), theta):
            yield k, rows, block.tau.T, None if block.keep is None else block.keep.T

    @cached_property
    def cache(self) -> dict[Any, Any]:
        """Results that were computed from this regression, by what was asked for."""
        return {}

    def subtract_bias(self, bias: Array) -> Regression:
        """Return the regression whose solution is less by ``bias`` (p), with the factors that follow from these."""
        regression = replace(self, bias=bias if self.bias is None else self.bias + bias)
        return regression.with_factors(self.triangular_factors.subtract_torque(bias))

    def factorise(self) -> Regression:
        """Return the regression with its triangular factors, which pass over all samples; raises their errors."""
        return self.with_factors(self.triangular_factors)

    def with_factors(self, factors: TriangularFactors) -> Regression:
        """Return the regression with its triangular factors, where they are known without its rows."""
        regression = replace(self)
        regression.__dict__["triangular_factors"] = factors
        return regression

    def weighted_products(
        self, torques: Sequence[Array], weights: Array | None = None, *, filtered: bool = False
    ) -> Array:
        """Return sum w_j^2 Y_j' c_j (p, k) of other torques c, for each motion (N, n, k), with ``weights`` w (n).

        Torques that are ``filtered`` already are those of the rows.
        """
        w2 = np.ones(len(self.model.joints)) if weights is None else np.square(weights)
        p = len(self.model.parameters)
        total = np.zeros((p, torques[0].shape[2]))
        series = torques if filtered else [self._filter_torques(k, c) for k, c in enumerate(torques)]
        for _, _, block in self.placed_blocks(self.model.structure, extra_torques=series):
            for j, (columns, maps) in enumerate(zip(block.structure.columns, block.structure.maps, strict=True)):
                rows, of_model = block.joint_rows(j)[:-1], columns < p
                # the torques are the last columns of the block, after the entries of the model
                total += w2[j] * maps[of_model][:, :p].T @ (rows[of_model] @ rows[~of_model].T)
        return total

    def _filter_torques(self, k: int, c: Array) -> Array:
        """Return torques (N, n, k) of the k-th motion, filtered as its rows are."""
        if self.filter is None:
            return c
        # as far as it matters: the ends of a stretch are not treated apart
        return self.filter.apply(self.filter.sections(self.motions[k]), c)

    def placed_blocks(
        self,
        structure: Structure,
        theta: Array | None = None,
        within: tuple[int, slice] | None = None,
        extra_torques: Sequence[Array] = (),
    ) -> Iterator[PlacedBlock]:
        """Yield each block with the index of its motion and its rows in this motion.

        ``extra_torques`` holds other torques (N, n, k) of each motion, which become columns after all others.
        """
        blocks, extended = self._unweighted_blocks(structure, theta, within), structure
        if extra_torques:
            extended = structure.append_columns(extra_torques[0].shape[2])
            blocks = ((k, rows, _append_torques(block, extra_torques[k][rows], extended)) for k, rows, block in blocks)
        if self.whitening is not None:
            mixed_structure = self.structure if extended is self.model.structure else self.whitening.structure(extended)
            # weights come after whitening, which mixes rows of unlike weights otherwise
            blocks = whiten_blocks(blocks, self.whitening, mixed_structure, 0 if within is None else within[1].start)
        for k, rows, block in blocks:
            yield k, rows, block.scale_rows(self.weights[k][rows].T) if self.weights else block

    def _unweighted_blocks(
        self, structure: Structure, theta: Array | None, within: tuple[int, slice] | None
    ) -> Iterator[PlacedBlock]:
        """Yield the blocks after the filter alone, including the earlier rows that whitening needs."""
        parameters = [theta_part for theta_part in (self.bias, theta) if theta_part is not None]
        # bias and theta are both subtracted from the torque before it is filtered
        rows = partial(self._entry_block, structure=structure, theta=np.sum(parameters, axis=0) if parameters else None)
        for k, part, samples in self._stretches_to_take(within):
            motion = self.motions[k]
            blocks = (
                _unfiltered_blocks(motion, samples, rows, max(BLOCK, BLOCK_ENTRIES // max(len(structure.joint), 1)))
                if self.filter is None
                else _filtered_blocks(motion, part, samples, rows, self.filter)
            )
            for block_rows, block in blocks:
                yield k, block_rows, block

    def _stretches_to_take(self, within: tuple[int, slice] | None) -> Iterator[tuple[int, slice, slice]]:
        """Yield the index of a motion, an uninterrupted stretch of it, and the samples of the stretch to take."""
        # whitening needs the rows before, of the decimated rate
        before = 0 if self.whitening is None else self.whitening.span * (self.filter.decimate if self.filter else 1)
        for k, motion in enumerate(self.motions):
            if within is None or within[0] == k:
                rows = slice(0, len(motion)) if within is None else within[1]
                for part in stretches(motion.mask):
                    if (start := max(part.start, rows.start)) < (stop := min(part.stop, rows.stop)):
                        yield k, part, slice(max(part.start, start - before), stop)

    @cached_property
    def triangular_factors(self) -> TriangularFactors:
        """The triangular factors; InputError where there are not more rows than parameters."""
        unknowns = len(self.model.parameters)
        if not unknowns:
            raise ConfigError(f"{self.model.name}: the model has no parameters to estimate.")
        factors = factorise(self.entries(), self.structure)
        if factors.total <= unknowns:
            raise InputError(
                f"{', '.join(motion.source for motion in self.motions)}: {factors.samples} usable samples of "
                f"{len(self.model.joints)} joints are too few for {unknowns} parameters; "
                f"{self._remedy_of_few_samples()}."
            )
        return factors

    def _remedy_of_few_samples(self) -> str:
        """Return what to do where few samples are used: those slower than ``min_speed`` are left out by a setting."""
        speeds = self.min_speed
        if not speeds or not any(speeds):
            return "record longer"
        fastest = [max(float(np.abs(motion.dq[motion.mask, j]).max(initial=0.0)) for motion in self.motions)
                   for j in range(len(speeds))]  # fmt: skip
        pairs = zip(self.model.joints, speeds, fastest, strict=True)
        names = [f"{joint.name} at {speed:g}, which reaches {reached:.2g}" for joint, speed, reached in pairs if speed]
        return f"lower `min_speed` (rad/s, m/s: {', '.join(names[:5])}), or record faster motion"

    def _entry_block(self, motion: Motion, rows: slice, structure: Structure, theta: Array | None) -> EntryBlock:
        states = motion.states(rows)
        entries = self.model.entries(**states, joint=structure.joint, parameter=structure.parameter)
        tau = motion.tau[rows] if theta is None else motion.tau[rows] - self.model.torque(**states, theta=theta)
        keep = fitted_rows(motion, self.min_speed, rows)
        return EntryBlock(structure, entries, np.ascontiguousarray(tau.T), None if keep is None else keep.T)


def _append_torques(block: EntryBlock, torques: Array, wider: Structure) -> EntryBlock:
    """Return a block with torques (B, n, k) as the last columns of its joints, of the structure ``wider``."""
    parts = [x for j, part in enumerate(block.structure.parts) for x in (block.entries[part], torques[:, j].T)]
    return EntryBlock(wider, np.concatenate(parts), block.tau, block.keep)


RowFunction = Callable[[Motion, slice], EntryBlock]


def _unfiltered_blocks(motion: Motion, part: slice, rows: RowFunction, size: int) -> Iterator[tuple[slice, EntryBlock]]:
    for start in range(part.start, part.stop, size):
        block_rows = slice(start, min(start + size, part.stop))
        yield block_rows, rows(motion, block_rows)


def _filtered_blocks(
    motion: Motion, part: slice, samples: slice, rows: RowFunction, parallel_filter: ParallelFilter
) -> Iterator[tuple[slice, EntryBlock]]:
    """Filter pieces of ``samples`` of a stretch ``part``, which overlap by the filter's response time.

    The pieces therefore join exactly.
    """
    sections, step = parallel_filter.sections(motion), parallel_filter.decimate
    pad = parallel_filter.pad_samples(sections)
    # a whole number of steps of the decimation, and long enough that the overlaps cost little
    size = -(-max(BLOCK, 4 * pad) // step) * step
    # decimation counts from the start of the stretch, wherever the samples to take begin
    for start in range(samples.start + (part.start - samples.start) % step, samples.stop, size):
        stop = min(start + size, samples.stop)
        padded_start, padded_stop = max(part.start, start - pad), min(part.stop, stop + pad)
        if padded_stop - padded_start < 2:
            continue
        block = rows(motion, slice(padded_start, padded_stop))
        inner = slice(start - padded_start, stop - padded_start, step)
        entries, tau = (
            np.ascontiguousarray(parallel_filter.apply(sections, x, 1)[:, inner]) for x in (block.entries, block.tau)
        )
        keep = None if block.keep is None else block.keep[:, inner]
        yield slice(start, stop, step), EntryBlock(block.structure, entries, tau, keep)


def fitted_rows(
    motion: Motion, min_speed: tuple[float, ...] | None, rows: slice | NDArray[np.intp] = slice(None)
) -> NDArray[np.bool_] | None:
    """Return which torque equations (B, n) of these samples are fitted; None for all.

    They are those of joints that are fast enough, where the motion keeps them.
    """
    fast = None if min_speed is None else np.abs(motion.dq[rows]) >= np.array(min_speed)
    if motion.keep is None:
        return fast
    return motion.keep[rows] if fast is None else fast & motion.keep[rows]


def fitted_mask(
    motion: Motion, min_speed: tuple[float, ...] | None = None, rows: slice | NDArray[np.intp] = slice(None)
) -> NDArray[np.bool_]:
    """Return which torque equations (B, n) of these samples are fitted: ``fitted_rows`` inside the motion's mask."""
    keep = fitted_rows(motion, min_speed, rows)
    inside = np.broadcast_to(motion.mask[rows, None], motion.q[rows].shape)
    return inside if keep is None else inside & keep


@dataclass(frozen=True)
class RegressionPart:
    """The samples from ``start`` up to ``stop`` of a regression's motion number ``motion``."""

    motion: int
    start: int
    stop: int

    @property
    def rows(self) -> slice:
        """The samples."""
        return slice(self.start, self.stop)


def divide_regression(regression: Regression, samples: int) -> tuple[RegressionPart, ...]:
    """Return parts of about ``samples`` usable consecutive samples, in order of time, which cover all samples.

    No part reaches over a gap of the mask.
    """
    parts: list[RegressionPart] = []
    for k, motion in enumerate(regression.motions):
        for stretch in stretches(motion.mask):
            length = stretch.stop - stretch.start
            # parts of equal length, none much longer than asked for
            count = max(1, round(length / samples))
            edges = [stretch.start + length * i // count for i in range(count + 1)]
            parts += [RegressionPart(k, a, b) for a, b in pairwise(edges)]
    return tuple(parts)


def factors_of_parts(
    regression: Regression, parts: Sequence[RegressionPart], executor: Executor | None = None
) -> tuple[TriangularFactors, ...]:
    """Return the factors of each part, in their order; the rows are filtered and weighted as in the whole.

    Raises InputError where a worker fails.
    """
    factors: list[TriangularFactors | None] = [None] * len(parts)
    bare = replace(regression)  # what is cached stays here
    for result in run_jobs(partial(_factors_of_part, bare, tuple(parts)), range(len(parts)), executor):
        if result.status is not Status.OK:
            part = parts[result.job]
            source = regression.motions[part.motion].source
            raise InputError(f"{source}: samples {part.start} to {part.stop} could not be reduced: {result.reason}")
        factors[result.job] = result.value
    return tuple(part_factors for part_factors in factors if part_factors is not None)


def _factors_of_part(regression: Regression, parts: Sequence[RegressionPart], k: int) -> TriangularFactors:
    within = parts[k].motion, parts[k].rows
    return factorise(regression.entries(within=within), regression.structure)
