"""The linear problem y = X theta + e, eqs. (9)-(10): streamed block by block to one triangular factor per joint."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any
from weakref import WeakKeyDictionary, ref

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError, InputError, brief
from dynident.log import Motion
from dynident.models import Model, Structure
from dynident.models.memory import memory_of
from dynident.regression.parallel_filter import ParallelFilter
from dynident.regression.triangular import EntryBlock, TriangularFactors, factorise, one_thread
from dynident.regression.whitening import Placed, Whitening, whitened
from dynident.splines import stretches

__all__ = [
    "BLOCK",
    "ParallelFilter",
    "Regression",
    "RegressorBlock",
    "TriangularFactors",
    "fast_enough",
    "fitted_rows",
    "one_thread",
    "stretches",
    "triangularise",
]

Array = NDArray[np.float64]
BLOCK = 2048  # samples whose entries stay in the cache while they are factorised


@dataclass(frozen=True, eq=False)
class RegressorBlock:
    """Some rows of the problem: ``Y`` (B, n, p), ``tau`` (B, n), and which of them to use, ``keep`` (B, n) or all."""

    Y: Array
    tau: Array
    keep: NDArray[np.bool_] | None = None

    __repr__ = brief

    def entries(self, whole: Structure) -> EntryBlock:
        """Return the block by all of its entries."""
        samples, joints, parameters = self.Y.shape
        rows = self.Y.transpose(1, 2, 0).reshape(joints * parameters, samples)
        return EntryBlock(whole, rows, self.tau.T, None if self.keep is None else self.keep.T)


@dataclass(frozen=True, eq=False)
class Regression:
    """The torque equation of a model over any number of motions; only samples inside the masks are used.

    The matrix is never formed whole: ``blocks`` computes it a few thousand samples at a time, on every call;
    ``triangular_factors`` caches its triangular factors. ``min_speed`` (n), in rad/s or m/s, leaves out of each joint's
    equation the samples at which that joint is slower, where the friction model is poor; None leaves none out.
    ``whitening`` makes the rows independent where their noise is not, after any filter; row j is then no longer of
    joint j alone. ``weights`` multiply the rows of each motion, one (N, n) for each, after that; empty: all rows count
    the same.
    ``bias`` (p) is taken off the solution: the torque is that of the motions less Y bias.
    """

    model: Model
    motions: tuple[Motion, ...]
    filter: ParallelFilter | None = None
    min_speed: tuple[float, ...] | None = None
    weights: tuple[Array, ...] = ()
    bias: Array | None = None
    whitening: Whitening | None = None

    __repr__ = brief

    def __post_init__(self) -> None:
        names = tuple(joint.name for joint in self.model.joints)
        for motion in self.motions:
            if motion.joints != names:
                raise InputError(f"{motion.source}: has the joints {motion.joints}, the model {names}.")
            memory_of(self.model, motion.memory, len(motion))
        self._check_min_speed(names)
        shapes = [motion.q.shape for motion in self.motions]
        if self.weights and [weight.shape for weight in self.weights] != shapes:
            raise ConfigError(f"weights have shapes {[w.shape for w in self.weights]}, the motions {shapes}.")
        if self.whitening is not None and len(self.whitening.coefficients) != len(names):
            raise ConfigError(f"whitening is of {len(self.whitening.coefficients)} joints, the model has {len(names)}.")

    def _check_min_speed(self, names: tuple[str, ...]) -> None:
        if self.min_speed is not None and (
            len(self.min_speed) != len(names) or not all(v >= 0 for v in self.min_speed)
        ):
            raise ConfigError(
                f"min_speed = {self.min_speed}: give a speed >= 0 for each of the joints {', '.join(names)}."
            )

    def blocks(self) -> Iterator[RegressorBlock]:
        """Yield the rows block by block, filtered and decimated where ``filter`` says so, and weighted."""
        for one in self.entries():
            yield RegressorBlock(one.regressor(), one.tau.T, None if one.keep is None else one.keep.T)

    def entries(
        self, structure: Structure | None = None, theta: Array | None = None, within: tuple[int, slice] | None = None
    ) -> Iterator[EntryBlock]:
        """Yield the same rows by the entries of a ``structure``, by default that of the model.

        The torque is less Y theta, where ``theta`` (p) is given. ``within`` are the place of a motion and its samples
        to take: those around them still count in the filter.
        """
        for _, _, block in self.placed(structure or self.model.structure, theta, within):
            yield block

    @cached_property
    def structure(self) -> Structure:
        """The structure of the rows: that of the model, or what whitening makes of it."""
        plain = self.model.structure
        return plain if self.whitening is None else self.whitening.structure(plain)

    def residuals(self, theta: Array) -> Iterator[tuple[int, slice, Array, NDArray[np.bool_] | None]]:
        """Yield what theta (p) leaves of the torque, (B, n), filtered and weighted, block by block: the place of the
        motion, its samples, the residual, and which of it is used, (B, n) or all."""
        for k, rows, one in self.placed(self.model.structure_with(()), theta):
            yield k, rows, one.tau.T, None if one.keep is None else one.keep.T

    @cached_property
    def known(self) -> dict[Any, Any]:
        """What is known of this regression from before, by what was asked."""
        return {}

    def unbiased(self, bias: Array) -> Regression:
        """Return the regression whose solution is less by ``bias`` (p), with the factors that follow from these."""
        found = replace(self, bias=bias if self.bias is None else self.bias + bias)
        return found.with_factors(self.triangular_factors.less(bias))

    def with_factors(self, factors: TriangularFactors) -> Regression:
        """Return the regression with its triangular factors, where they are known without its rows."""
        found = replace(self)
        found.__dict__["triangular_factors"] = factors
        return found

    def pulls(self, torques: Sequence[Array], weights: Array | None = None, *, filtered: bool = False) -> Array:
        """Return sum w_j^2 Y_j' c_j (p, k) of other torques c, for each motion (N, n, k), with ``weights`` w (n).

        Torques that are ``filtered`` already are those of the rows.
        """
        w2 = np.ones(len(self.model.joints)) if weights is None else np.square(weights)
        p = len(self.model.parameters)
        total = np.zeros((p, torques[0].shape[2]))
        series = torques if filtered else [self._passed(k, c) for k, c in enumerate(torques)]
        for _, _, block in self.placed(self.model.structure, beside=series):
            for j, (columns, maps) in enumerate(zip(block.structure.columns, block.structure.maps, strict=True)):
                rows, own = block.used(j)[:-1], columns < p
                total += w2[j] * maps[own][:, :p].T @ (rows[own] @ rows[~own].T)
        return total

    def _passed(self, k: int, c: Array) -> Array:
        """Return torques (N, n, k) of the k-th motion, filtered as its rows are."""
        if self.filter is None:
            return c
        # as far as it matters: the ends of a stretch are not treated apart
        return self.filter.apply(self.filter.sections(self.motions[k]), c)

    def placed(
        self,
        structure: Structure,
        theta: Array | None = None,
        within: tuple[int, slice] | None = None,
        beside: Sequence[Array] = (),
    ) -> Iterator[Placed]:
        """Yield each block with the place of its motion, and of its rows in this motion; ``beside`` holds other torques
        (N, n, k) of each motion that become columns after all others."""
        blocks, made = self._unweighted(structure, theta, within), structure
        if beside:
            made = structure.beside(beside[0].shape[2])
            blocks = ((k, kept, _beside(block, beside[k][kept], made)) for k, kept, block in blocks)
        if self.whitening is not None:
            mixed = self.structure if made is self.model.structure else self.whitening.structure(made)
            blocks = whitened(blocks, self.whitening, mixed, 0 if within is None else within[1].start)
        for k, kept, block in blocks:
            yield k, kept, block.times(self.weights[k][kept].T) if self.weights else block

    def _unweighted(
        self, structure: Structure, theta: Array | None, within: tuple[int, slice] | None
    ) -> Iterator[Placed]:
        """Yield the blocks filtered alone, with the rows before those to take that count in whitening."""
        given = [one for one in (self.bias, theta) if one is not None]
        rows = partial(self._rows, structure=structure, theta=np.sum(given, axis=0) if given else None)
        for k, part, some in self._stretches(within):
            motion = self.motions[k]
            blocks = (
                _plain(motion, some, rows) if self.filter is None else _filtered(motion, part, some, rows, self.filter)
            )
            for kept, block in blocks:
                yield k, kept, block

    def _stretches(self, within: tuple[int, slice] | None) -> Iterator[tuple[int, slice, slice]]:
        """Yield the place of a motion, an uninterrupted stretch of it, and the samples to take of this."""
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
        found = self._remembered() or factorise(self.entries(), self.structure)
        if self.motions and self._plain:
            key = tuple(map(ref, self.motions)), self.model, self.filter, self.min_speed
            _KNOWN[self.motions[0]] = key, found
        if found.total <= unknowns:
            raise InputError(
                f"{', '.join(motion.source for motion in self.motions)}: {found.samples} usable samples of "
                f"{len(self.model.joints)} joints are too few for {unknowns} parameters; record longer."
            )
        return found

    @property
    def _plain(self) -> bool:
        """Whether the rows are those of model and motions, by nothing that an estimate says."""
        return not self.weights and self.bias is None and self.whitening is None

    def _remembered(self) -> TriangularFactors | None:
        """Return the factors of the same rows, where they are known from before."""
        if not self.motions or not self._plain or self.motions[0] not in _KNOWN:
            return None
        (motions, *how), found = _KNOWN[self.motions[0]]
        same = len(motions) == len(self.motions) and all(a() is b for a, b in zip(motions, self.motions, strict=True))
        return found if same and how[0] is self.model and how[1:] == [self.filter, self.min_speed] else None

    def _rows(self, motion: Motion, rows: slice, structure: Structure, theta: Array | None) -> EntryBlock:
        states = motion.states(rows)
        entries = self.model.entries(**states, joint=structure.joint, parameter=structure.parameter)
        tau = motion.tau[rows] if theta is None else motion.tau[rows] - self.model.torque(**states, theta=theta)
        keep = fitted_rows(motion, self.min_speed, rows)
        return EntryBlock(structure, entries, np.ascontiguousarray(tau.T), None if keep is None else keep.T)


def _beside(block: EntryBlock, torques: Array, wider: Structure) -> EntryBlock:
    """Return a block with torques (B, n, k) as the last columns of its joints, of the structure ``wider``."""
    own = [x for j, part in enumerate(block.structure.parts) for x in (block.entries[part], torques[:, j].T)]
    return EntryBlock(wider, np.concatenate(own), block.tau, block.keep)


Rows = Callable[[Motion, slice], EntryBlock]
Known = tuple[tuple[Any, ...], TriangularFactors]
# the factors of the last regression on each motion, for as long as it lives: the checks ask for those of the fit again
_KNOWN: WeakKeyDictionary[Motion, Known] = WeakKeyDictionary()


def _plain(motion: Motion, part: slice, rows: Rows) -> Iterator[tuple[slice, EntryBlock]]:
    for start in range(part.start, part.stop, BLOCK):
        some = slice(start, min(start + BLOCK, part.stop))
        yield some, rows(motion, some)


def _filtered(
    motion: Motion, part: slice, some: slice, rows: Rows, parallel_filter: ParallelFilter
) -> Iterator[tuple[slice, EntryBlock]]:
    """Filter pieces of ``some`` samples of a stretch ``part`` that overlap by the filter's response time, so that the
    pieces join exactly."""
    sections, step = parallel_filter.sections(motion), parallel_filter.decimate
    pad = parallel_filter.pad(sections)
    size = -(-max(BLOCK, 4 * pad) // step) * step
    for start in range(some.start + (part.start - some.start) % step, some.stop, size):
        stop = min(start + size, some.stop)
        first, last = max(part.start, start - pad), min(part.stop, stop + pad)
        if last - first < 2:
            continue
        one = rows(motion, slice(first, last))
        kept = slice(start - first, stop - first, step)
        entries, tau = (
            np.ascontiguousarray(parallel_filter.apply(sections, x, 1)[:, kept]) for x in (one.entries, one.tau)
        )
        keep = None if one.keep is None else one.keep[:, kept]
        yield slice(start, stop, step), EntryBlock(one.structure, entries, tau, keep)


def fast_enough(dq: Array, min_speed: tuple[float, ...] | None) -> NDArray[np.bool_] | None:
    """Return where each joint (N, n) is at least as fast as ``min_speed`` (n); None for everywhere."""
    return None if min_speed is None else np.abs(dq) >= np.array(min_speed)


def fitted_rows(
    motion: Motion, min_speed: tuple[float, ...] | None, rows: slice = slice(None)
) -> NDArray[np.bool_] | None:
    """Return which torque equations (B, n) of these samples are fitted: of joints that are fast enough, where the
    motion keeps them; None for all."""
    fast = fast_enough(motion.dq[rows], min_speed)
    if motion.keep is None:
        return fast
    return motion.keep[rows] if fast is None else fast & motion.keep[rows]


def triangularise(blocks: Iterable[RegressorBlock], joints: int, parameters: int) -> TriangularFactors:
    """Reduce blocks of a regressor of which nothing is known to triangular factors."""
    whole = Structure.whole(joints, parameters)
    return factorise((block.entries(whole) for block in blocks), whole)
