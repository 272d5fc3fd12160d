"""Triangular factors of parts of a regression, over any executor; merged they are those of the whole, to rounding."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError
from dynident.jobs import Status, run_jobs
from dynident.models import Structure
from dynident.regression.linear_problem import Regression
from dynident.regression.triangular import TriangularFactors, factorise, one_thread
from dynident.splines import stretches

__all__ = ["Part", "divided", "factors_of_parts", "merged", "packed", "unpacked"]

TOGETHER = 16  # factors that are merged at once


@dataclass(frozen=True)
class Part:
    """The samples from ``start`` up to ``stop`` of a regression's motion number ``motion``."""

    motion: int
    start: int
    stop: int

    @property
    def rows(self) -> slice:
        """The samples."""
        return slice(self.start, self.stop)


def divided(regression: Regression, samples: int) -> tuple[Part, ...]:
    """Return parts of about ``samples`` usable consecutive samples, in the order of time: together all of them.

    None reaches over a gap of the mask.
    """
    found: list[Part] = []
    for k, motion in enumerate(regression.motions):
        for one in stretches(motion.mask):
            length = one.stop - one.start
            count = max(1, round(length / samples))
            edges = [one.start + length * i // count for i in range(count + 1)]
            found += [Part(k, a, b) for a, b in pairwise(edges)]
    return tuple(found)


def factors_of_parts(
    regression: Regression, parts: Sequence[Part], executor: Executor | None = None
) -> tuple[TriangularFactors, ...]:
    """Return the factors of each part, in their order; the rows are filtered and weighted as in the whole.

    Raises InputError where a worker fails.
    """
    found: list[TriangularFactors | None] = [None] * len(parts)
    bare = replace(regression)  # what is cached stays here
    for done in run_jobs(partial(_factors, bare, tuple(parts)), range(len(parts)), executor):
        if done.status is not Status.OK:
            part = parts[done.job]
            source = regression.motions[part.motion].source
            raise InputError(f"{source}: samples {part.start} to {part.stop} could not be reduced: {done.reason}")
        found[done.job] = done.value
    return tuple(one for one in found if one is not None)


def _factors(regression: Regression, parts: Sequence[Part], k: int) -> TriangularFactors:
    within = parts[k].motion, parts[k].rows
    return factorise(regression.entries(within=within), regression.structure)


def merged(parts: Iterable[TriangularFactors]) -> TriangularFactors:
    """Return the factors of the rows of all parts, of which there is at least one; they are taken as they come."""
    held: list[TriangularFactors] = []
    for one in parts:
        held.append(one)
        if len(held) == TOGETHER:
            held = [_stacked(held)]
    return _stacked(held)


def _stacked(parts: Sequence[TriangularFactors]) -> TriangularFactors:
    rows = np.concatenate([one.factors for one in parts], axis=1)
    with one_thread():
        factors = np.asarray(np.linalg.qr(rows, mode="r"))
    return TriangularFactors(factors, np.sum([one.rows for one in parts], axis=0))


def packed(factors: TriangularFactors, structure: Structure) -> bytes:
    """Return the entries of factors that a structure does not make zero, as float64."""
    return factors.factors[_filled(structure)].tobytes()


def unpacked(content: bytes, rows: Sequence[int], structure: Structure) -> TriangularFactors:
    """Return the factors of which ``packed`` has made the content; ValueError where it is of another structure."""
    filled = _filled(structure)
    found = np.zeros(filled.shape)
    found[filled] = np.frombuffer(content)
    return TriangularFactors(found, np.array(rows, dtype=int))


def _filled(structure: Structure) -> NDArray[np.bool_]:
    """Return which entries (n, p + 1, p + 1) of the factors can be other than zero."""
    p = structure.maps[0].shape[1]
    out = np.zeros((len(structure.maps), p + 1, p + 1), dtype=bool)
    for filled, one in zip(out, structure.maps, strict=True):
        filled[: len(one), :p] = one.any(axis=0)
        filled[: len(one), p] = filled[p, p] = True
        filled &= np.tri(p + 1, dtype=bool).T
    return out
