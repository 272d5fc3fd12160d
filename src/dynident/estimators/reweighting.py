"""Rows of a linear problem that are weighted anew many times: along the directions that the data determine.

In these the columns are orthonormal, so that normal equations lose no digits that matter; rows that fit into memory are
computed once.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.regression import Rank, Regression, one_thread

__all__ = ["BaseRows", "RowErrors"]

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
MEMORY = 2**28  # bytes of rows that are kept
NORMAL_MAD = 0.6744897501960817  # median absolute deviation of a standard normal error
ROUNDING = 1e-7  # of the torque: the least scale


@dataclass(frozen=True, eq=False)
class RowErrors:
    """The residuals of each motion (N, n), and which torques are fitted (N, n)."""

    left: tuple[Array, ...]
    used: tuple[Mask, ...]

    __repr__ = brief

    @classmethod
    def of(cls, regression: Regression, blocks: Iterable[tuple[int, slice, Array, Mask | None]]) -> RowErrors:
        """Return what blocks (B, n) hold; where a filter decimates, samples between have the residual before them."""
        left = tuple(np.zeros(one.q.shape) for one in regression.motions)
        used = tuple(np.zeros(one.q.shape, dtype=bool) for one in regression.motions)
        for k, rows, error, keep in blocks:
            every = slice(rows.start, rows.stop)
            left[k][every] = np.repeat(error, rows.step or 1, axis=0)[: len(left[k][every])]
            used[k][rows] = True if keep is None else keep
        return cls(left, used)

    def scale(self, regression: Regression) -> Array:
        """Return the scale (n) of each joint by the median of its absolute residuals, not below rounding."""
        triangular = regression.triangular_factors
        size = np.sqrt(np.square(triangular.factors[:, :, -1]).sum(axis=1) / np.maximum(triangular.rows, 1))
        floor = ROUNDING * np.where(size > 0, size, size.max(initial=0.0) or 1.0)
        found = [np.median(np.abs(own)) / NORMAL_MAD if len(own) else 0.0 for own in self.by_joint(self.left)]
        return np.maximum(found, floor)

    def by_joint(self, values: Sequence[Array]) -> list[Array]:
        """Return those of the values (N, n) of each motion that are fitted, joint by joint."""
        pairs = list(zip(values, self.used, strict=True))
        return [np.concatenate([one[on[:, j], j] for one, on in pairs]) for j in range(values[0].shape[1])]


@dataclass(frozen=True, eq=False)
class _Block:
    """Some ``rows`` of the ``motion``-th motion: the columns ``Q`` (B, n, r), the torque ``y`` (B, n), and which are
    fitted, (B, n) or all."""

    motion: int
    rows: slice
    Q: Array
    y: Array
    keep: Mask | None

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class BaseRows:
    """The rows of a regression along ``directions`` (p, r), with what a ``start`` (p) leaves of the torque.

    ``kept`` are the blocks, where memory holds them; else they are computed on every call.
    """

    regression: Regression
    start: Array
    directions: Array
    kept: tuple[_Block, ...] | None = None

    __repr__ = brief

    @classmethod
    def of(cls, regression: Regression, start: Array, rank: Rank) -> BaseRows:
        """Return the rows along the directions that a rank determines."""
        found = cls(regression, start, rank.determined / rank.values[: rank.rank])
        every = 1 if regression.filter is None else regression.filter.decimate
        size = sum(one.q.size for one in regression.motions) // every * rank.rank * 8
        return found if size > MEMORY else replace(found, kept=tuple(found.blocks()))

    def value(self, z: Array) -> Array:
        """Return the parameters (p) that lie z (r) from the start."""
        return np.asarray(self.start + self.directions @ z)

    def blocks(self) -> Iterator[_Block]:
        """Yield the blocks."""
        if self.kept is not None:
            yield from self.kept
            return
        for k, rows, one in self.regression.placed(self.regression.structure, self.start):
            keep = None if one.keep is None else one.keep.T
            yield _Block(k, rows, np.ascontiguousarray(one.regressor(self.directions)), one.tau.T, keep)

    def errors(self, z: Array) -> RowErrors:
        """Return what the parameters that lie z (r) from the start leave of the torque."""
        found = ((one.motion, one.rows, one.y - one.Q @ z, one.keep) for one in self.blocks())
        return RowErrors.of(self.regression, found)

    def step(self, weights: Sequence[Array], left: Sequence[Array], joints: Array) -> tuple[Array, float]:
        """Return the step (r) to the solution of the rows weighted by ``weights`` (N, n) of each motion and ``joints``
        (n), from what was ``left`` (N, n), and its length in standard errors where the ``joints`` are one over their
        variance."""
        r = self.directions.shape[1]
        normal, pull = np.zeros((r, r)), np.zeros(r)
        with one_thread():
            for one in self.blocks():
                w = weights[one.motion][one.rows] * joints
                w = (w if one.keep is None else w * one.keep).ravel()
                Q = one.Q.reshape(-1, r)
                normal += Q.T @ (Q * w[:, None])
                pull += Q.T @ (w * left[one.motion][one.rows].ravel())
        step: Array = np.asarray(np.linalg.lstsq(normal, pull)[0], dtype=np.float64)
        return step, float(np.sqrt(np.abs(step @ normal @ step)))
