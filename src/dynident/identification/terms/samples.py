"""The samples on which terms are chosen: thinned, divided into blocks of time, and the columns of a term on them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.identification.terms.grams import JointGrams
from dynident.log import Motion
from dynident.models import HasMemory, Loads, Model, Past, Selective, Term, declares
from dynident.regression import fitted_rows

__all__ = ["BLOCKS", "Rows", "Samples", "columns_of", "correlation", "samples_of"]

Array = NDArray[np.float64]
SAMPLES = 20_000  # of all motions together: the choice needs no more
BLOCKS = 16  # of time, of all motions together; at least one of each motion
FAST, OUTER = 0.6, 0.7  # quantiles of speed and of the distance from the middle that divide the samples of a joint
CLASSES = 4  # slow inner, slow outer, fast inner, fast outer
GAP = 1 / 8  # of a block at most


@dataclass(frozen=True, eq=False)
class Samples:
    """``motions`` of a ``model``, thinned evenly, with the usable ``rows`` of each, N in all; ``block`` (N) of each
    sample, and the motion ``of_block`` (F) that each is of."""

    model: Model
    motions: tuple[Motion, ...]
    rows: tuple[NDArray[np.intp], ...]
    block: NDArray[np.intp]
    of_block: NDArray[np.intp]
    min_speed: tuple[float, ...] | None = None

    __repr__ = brief

    def __len__(self) -> int:
        return len(self.block)

    @property
    def blocks(self) -> int:
        """Number F of blocks."""
        return len(self.of_block)

    @cached_property
    def states(self) -> dict[str, Array]:
        """The states (N, n) by name, with the memory of the model where it has one."""
        found = [one.states(rows) for one, rows in zip(self.motions, self.rows, strict=True)]
        return {name: np.concatenate([one[name] for one in found]) for name in found[0]}

    @cached_property
    def used(self) -> tuple[tuple[Array, Array, Array], ...]:
        """The q, dq, ddq of each motion at its usable samples."""
        pairs = zip(self.motions, self.rows, strict=True)
        return tuple((one.q[rows], one.dq[rows], one.ddq[rows]) for one, rows in pairs)

    @cached_property
    def tau(self) -> Array:
        """The measured torque (N, n)."""
        return np.concatenate([one.tau[rows] for one, rows in zip(self.motions, self.rows, strict=True)])

    @cached_property
    def keep(self) -> NDArray[np.bool_]:
        """Which torque equations (N, n) are fitted."""
        found = [fitted_rows(one, self.min_speed) for one in self.motions]
        shapes = [np.ones(one.q.shape, dtype=bool) for one in self.motions]
        kept = [every if one is None else one for one, every in zip(found, shapes, strict=True)]
        return np.concatenate([one[rows] for one, rows in zip(kept, self.rows, strict=True)])

    def loads(self, load: tuple[float, ...] | None) -> tuple[Array, ...]:
        """Return the torque of the bodies (N, n) with the parameters ``load`` on each motion, zero for None."""
        if load is None:
            return tuple(np.zeros_like(one.q) for one in self.motions)
        bodies = Model(tuple(term for term in self.model.terms if isinstance(term, Loads) and term.loads))
        return tuple(bodies.torque(one.q, one.dq, one.ddq, load) for one in self.motions)

    def inside(self, gap: int) -> NDArray[np.bool_]:
        """Return which samples (N) lie more than ``gap`` samples from the border to another block of their motion."""
        gap = min(gap, int(GAP * len(self) / self.blocks))
        found = np.ones(len(self), dtype=bool)
        for border in np.flatnonzero(np.diff(self.block)) + 1:
            if self.of_block[self.block[border]] == self.of_block[self.block[border - 1]]:
                found[max(border - gap, 0) : border + gap] = False
        return found

    def classes(self, j: int) -> NDArray[np.intp]:
        """Return the class (N) of each sample of a joint, by its speed and by how far out it is."""
        return self.classes_of(self.states["q"][:, j], self.states["dq"][:, j])

    @staticmethod
    def classes_of(q: Array, dq: Array) -> NDArray[np.intp]:
        """Return the same of a coordinate q (N) with its velocity."""
        speed = np.abs(dq)
        away = np.abs(q - 0.5 * (q.min() + q.max()))
        return np.asarray(2 * (speed >= np.quantile(speed, FAST)) + (away >= np.quantile(away, OUTER)))


def samples_of(
    model: Model, motions: Sequence[Motion], min_speed: tuple[float, ...] | None = None, most: int = SAMPLES
) -> Samples:
    """Return the samples of motions, at most ``most``, every k-th; motions without two usable ones are left out."""
    usable = [one for one in motions if one.mask.sum() > 1]
    every = -(-sum(int(one.mask.sum()) for one in usable) // most)
    thin = tuple(model.remembering(one.shifted(0.0, np.arange(0, len(one), every))) for one in usable)
    thin = tuple(one for one in thin if one.mask.sum() > 1)
    rows = tuple(np.flatnonzero(one.mask) for one in thin)
    total = sum(map(len, rows))
    counts = [max(1, round(BLOCKS * len(one) / total)) for one in rows]
    if len(counts) == 1:
        counts = [BLOCKS]
    first = np.concatenate([[0], np.cumsum(counts)[:-1]])
    parts = zip(first, counts, map(len, rows), strict=True)
    block = [start + np.arange(size) * count // size for start, count, size in parts]
    return Samples(model, thin, rows, np.concatenate(block), np.repeat(np.arange(len(counts)), counts), min_speed)


def columns_of(samples: Samples, term: Term, j: int, loads: Sequence[Array]) -> Array:
    """Return the columns (w, N) of a term in the equation of joint j; ``loads`` (N, n) are those of each motion."""
    found, w = [], len(term.parameters)
    for motion, rows, used, load in zip(samples.motions, samples.rows, samples.used, loads, strict=True):
        states = motion.q, motion.dq, motion.ddq
        memory = (term.remember(Past(motion.t, *states, load))[rows],) if isinstance(term, HasMemory) else ()
        q, dq, ddq = used
        if isinstance(term, Selective) and declares(term, "entries"):
            found.append(np.asarray(term.entries(q, dq, ddq, np.full(w, j), np.arange(w), *memory)))
        else:
            found.append(np.asarray(term.regressor(q, dq, ddq, *memory))[:, j].T)
    return np.concatenate(found, axis=1)


@dataclass(frozen=True, eq=False)
class Rows:
    """The equation of joint ``j`` in all samples: ``entries`` (b, N) of the model given with their ``maps`` (b, p),
    torque ``tau`` (N) without that of the prior, and which samples are used."""

    j: int
    entries: Array
    maps: Array
    tau: Array
    used: NDArray[np.bool_]

    __repr__ = brief

    @classmethod
    def of(cls, samples: Samples, j: int, prior: Array) -> Rows:
        """Return the rows of a joint, with the torque less that of the prior (p)."""
        structure = samples.model.structure
        columns, maps = structure.columns[j], structure.maps[j]
        entries = samples.model.entries(**samples.states, joint=np.full(len(columns), j), parameter=columns)
        return cls(j, entries, maps, samples.tau[:, j] - (maps @ prior) @ entries, samples.keep[:, j])

    def residual(self, theta: Array, columns: Array, values: Array) -> Array:
        """Return what theta (p) and columns (m, N) with their values (m) leave of the torque (N)."""
        return np.asarray(self.tau - (self.maps @ theta) @ self.entries - values @ columns)

    def grams(
        self, columns: Array, block: NDArray[np.intp], label: NDArray[np.intp], shape: tuple[int, int]
    ) -> JointGrams:
        """Return the Gram matrices with columns (m, N) by block and label (N), of which there are ``shape``."""
        key = np.where(self.used & (block >= 0) & (label >= 0), block * shape[1] + label, -1)
        order = np.argsort(key, kind="stable")
        ends = np.searchsorted(key[order], np.arange(shape[0] * shape[1] + 1))
        X = np.concatenate([self.entries, columns, self.tau[None]])
        parts = (X[:, order[first:last]] for first, last in pairwise(ends))
        return JointGrams(np.stack([one @ one.T for one in parts]).reshape(*shape, len(X), len(X)), self.maps)


def correlation(residual: Array, most: int) -> int:
    """Return the lag (samples) at which the autocorrelation of a residual (N) falls below 1/e, ``most`` at most."""
    size = len(residual)
    spectrum = np.fft.rfft(residual - residual.mean(), 2 * size)
    auto = np.fft.irfft(np.square(np.abs(spectrum)))[: max(most // 2, 2)]
    below = np.flatnonzero(auto < np.exp(-1) * auto[0])
    return int(below[0]) if len(below) else len(auto)
