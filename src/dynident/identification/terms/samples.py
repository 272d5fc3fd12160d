"""The samples for the choice of terms: thinned, divided into blocks of time, with the columns of a term on them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from dynident.identification.terms.grams import JointGrams
from dynident.models import Model, Past, Term
from dynident.motion.log import Motion
from dynident.regression import EVERYTHING, Selection, fitted_mask
from dynident.runtime import Noun
from dynident.runtime.arrays import Array

# of all motions together, and these times the joints: the choice needs no more
MAX_SAMPLES, MAX_ROWS = 20_000, 70_000
BLOCKS = 16  # of time, of all motions together; at least one of each motion
# quantiles of speed and of the distance from the middle that divide the samples of a joint
FAST_QUANTILE, OUTER_QUANTILE = 0.6, 0.7
N_CLASSES = 4  # slow inner, slow outer, fast inner, fast outer
MAX_GAP_SHARE = 1 / 8  # of a block at most
MIN_RETURN_SHARE = 0.02  # of the squared speed of a joint: with less against its main way, friction is like an offset


class TermSamples(Noun):
    """Samples of the ``motions`` of a ``model``, thinned evenly, N in all.

    ``rows`` are the usable ones of each motion, ``block`` (N) is the block of each sample, and ``of_block`` (F)
    the motion of each block. ``interval`` (s) is that between the samples before they were thinned.
    """

    model: Model
    motions: tuple[Motion, ...]
    rows: tuple[NDArray[np.intp], ...]
    block: NDArray[np.intp]
    of_block: NDArray[np.intp]
    interval: float
    selection: Selection = EVERYTHING

    def __len__(self) -> int:
        return len(self.block)

    @property
    def blocks(self) -> int:
        """Number F of blocks."""
        return len(self.of_block)

    @cached_property
    def states(self) -> dict[str, Array]:
        """The states (N, n) by name, with the memory of the model where it has one."""
        motion_states = [motion.states(rows) for motion, rows in zip(self.motions, self.rows, strict=True)]
        return {name: np.concatenate([state[name] for state in motion_states]) for name in motion_states[0]}

    def turning_step(self, j: int) -> float:
        """Return by how much the velocity of a joint changes between two samples where it turns (rad/s, m/s)."""
        steps = []
        for motion in self.motions:
            dq, usable = motion.dq[:, j], motion.mask[:-1] & motion.mask[1:]
            steps.append(np.abs(np.diff(dq))[usable & (dq[:-1] * dq[1:] < 0)])
        return float(np.median(all_steps)) if len(all_steps := np.concatenate(steps)) else 0.0

    @cached_property
    def usable_states(self) -> tuple[tuple[Array, Array, Array], ...]:
        """The q, dq, ddq of each motion at its usable samples."""
        pairs = zip(self.motions, self.rows, strict=True)
        return tuple((motion.q[rows], motion.dq[rows], motion.ddq[rows]) for motion, rows in pairs)

    @cached_property
    def tau(self) -> Array:
        """The measured torque (N, n)."""
        return np.concatenate([motion.tau[rows] for motion, rows in zip(self.motions, self.rows, strict=True)])

    @cached_property
    def keep(self) -> NDArray[np.bool_]:
        """Which torque equations (N, n) are fitted."""
        pairs = zip(self.motions, self.rows, strict=True)
        return np.concatenate([fitted_mask(motion, self.selection.min_speed, rows) for motion, rows in pairs])

    def loads(self, load: tuple[float, ...] | None) -> tuple[Array, ...]:
        """Return the torque of the bodies (N, n) with the parameters ``load`` on each motion, zero for None."""
        if load is None:
            return tuple(np.zeros_like(motion.q) for motion in self.motions)
        bodies = Model(tuple(term for term in self.model.terms if term.loads))
        return tuple(bodies.torque(motion.q, motion.dq, motion.ddq, load) for motion in self.motions)

    def is_inside(self, gap: int) -> NDArray[np.bool_]:
        """Return which samples (N) are more than ``gap`` samples away from another block of their motion."""
        gap = min(gap, int(MAX_GAP_SHARE * len(self) / self.blocks))
        is_inner = np.ones(len(self), dtype=bool)
        for border in np.flatnonzero(np.diff(self.block)) + 1:
            if self.of_block[self.block[border]] == self.of_block[self.block[border - 1]]:
                is_inner[max(border - gap, 0) : border + gap] = False
        return is_inner

    def moves_both_ways(self, j: int) -> bool:
        """Return whether a joint moves both ways where its torque is fitted."""
        dq = self.states["dq"][self.keep[:, j], j]
        forth, back = (float(np.square(dq[way]).sum()) for way in (dq > 0, dq < 0))
        return min(forth, back) > MIN_RETURN_SHARE * (forth + back)

    @staticmethod
    def classes(q: Array, dq: Array) -> NDArray[np.intp]:
        """Return the class (N) of each sample of a coordinate q (N) with velocity dq (N)."""
        speed = np.abs(dq)
        away = np.abs(q - 0.5 * (q.min() + q.max()))
        return np.asarray(
            2 * (speed >= np.quantile(speed, FAST_QUANTILE)) + (away >= np.quantile(away, OUTER_QUANTILE))
        )


def select_samples(
    model: Model, motions: Sequence[Motion], selection: Selection = EVERYTHING, max_samples: int = MAX_SAMPLES
) -> TermSamples:
    """Return at most ``max_samples`` of the motions, every k-th; motions without two usable ones are left out."""
    usable = [motion for motion in motions if motion.mask.sum() > 1]
    most = min(max_samples, MAX_ROWS // len(model.joints))
    step = -(-sum(int(motion.mask.sum()) for motion in usable) // most)
    thinned = tuple(model.remembering(motion.shift(0.0, np.arange(0, len(motion), step))) for motion in usable)
    thinned = tuple(motion for motion in thinned if motion.mask.sum() > 1)
    rows = tuple(np.flatnonzero(motion.mask) for motion in thinned)
    # Blocks in proportion to the samples of a motion, at least one each.
    total = sum(map(len, rows))
    counts = [max(1, round(BLOCKS * len(indices) / total)) for indices in rows]
    if len(counts) == 1:
        counts = [BLOCKS]
    first_block = np.concatenate([[0], np.cumsum(counts)[:-1]])
    parts = zip(first_block, counts, map(len, rows), strict=True)
    block = [start + np.arange(size) * count // size for start, count, size in parts]
    of_block, interval = np.repeat(np.arange(len(counts)), counts), float(np.median(np.diff(usable[0].t)))
    return TermSamples(model, thinned, rows, np.concatenate(block), of_block, interval, selection)


def columns_of(samples: TermSamples, term: Term, j: int, loads: Sequence[Array]) -> Array:
    """Return the columns (w, N) of a term in the equation of joint j; ``loads`` (N, n) are those of each motion."""
    columns, w = [], len(term.parameters)
    for motion, rows, usable, load in zip(samples.motions, samples.rows, samples.usable_states, loads, strict=True):
        states = motion.q, motion.dq, motion.ddq
        memory = (term.remember(Past(motion.t, *states, load))[rows],) if term.memory else ()
        q, dq, ddq = usable
        if term.has_own("entries"):
            columns.append(np.asarray(term.entries(q, dq, ddq, np.full(w, j), np.arange(w), *memory)))
        else:
            columns.append(np.asarray(term.regressor(q, dq, ddq, *memory))[:, j].T)
    return np.concatenate(columns, axis=1)


class JointEquations(Noun):
    """The equation of joint ``j`` in all samples.

    ``entries`` (b, N) are those of the model with their ``maps`` (b, p), ``tau`` (N) is the torque less that of
    the prior, and ``usable`` (N) says which samples are fitted.
    """

    j: int
    entries: Array
    maps: Array
    tau: Array
    usable: NDArray[np.bool_]

    @classmethod
    def of(cls, samples: TermSamples, j: int, prior: Array) -> JointEquations:
        """Return the rows of a joint, with the torque less that of the prior (p)."""
        structure = samples.model.structure
        columns, maps = structure.columns[j], structure.maps[j]
        entries = samples.model.entries(**samples.states, joint=np.full(len(columns), j), parameter=columns)
        return cls(j, entries, maps, samples.tau[:, j] - (maps @ prior) @ entries, samples.keep[:, j])

    def residual(self, theta: Array, columns: Array, values: Array) -> Array:
        """Return the residual torque (N) for theta (p) and columns (m, N) with their values (m)."""
        return np.asarray(self.tau - (self.maps @ theta) @ self.entries - values @ columns)

    def grams(
        self, columns: Sequence[Array], block: NDArray[np.intp], label: NDArray[np.intp], shape: tuple[int, int]
    ) -> JointGrams:
        """Return the Gram matrices with columns (each m, N) by block and label (N), whose numbers are ``shape``."""
        # Sort samples by block and class, so that each Gram matrix is one product of contiguous columns.
        key = np.where(self.usable & (block >= 0) & (label >= 0), block * shape[1] + label, -1)
        order = np.argsort(key, kind="stable")
        ends = np.searchsorted(key[order], np.arange(shape[0] * shape[1] + 1))
        X = np.concatenate([self.entries, *columns, self.tau[None]])
        parts = (X[:, order[start:stop]] for start, stop in pairwise(ends))
        return JointGrams.of(parts, shape, self.maps)


def correlation_length(residual: Array, max_lag: int) -> int:
    """Return the lag (samples) at which the autocorrelation of a residual (N) falls below 1/e, at most ``max_lag``."""
    size = len(residual)
    # Padding to twice the length avoids the wrap-around of the circular correlation.
    spectrum = np.fft.rfft(residual - residual.mean(), 2 * size)
    auto = np.fft.irfft(np.square(np.abs(spectrum)))[: max(max_lag // 2, 2)]
    below = np.flatnonzero(auto < np.exp(-1) * auto[0])
    return int(below[0]) if len(below) else len(auto)
