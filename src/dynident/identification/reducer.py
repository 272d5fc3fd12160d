"""Pieces of a recording too long for the memory: each is read, smoothed and reduced to factors, by any process."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError, brief
from dynident.identification.division import LongRecording, Span
from dynident.identification.outliers import masked
from dynident.identification.recipe import Recipe
from dynident.identification.repetition import PIECE, pieces_of
from dynident.identification.rests import resting, whole_rests
from dynident.identification.sampled_bias import Repeated, repeat
from dynident.log import Log, Motion
from dynident.models import Model, Structure
from dynident.regression import Regression, factorise, one_thread, packed, unpacked
from dynident.smoothers import motion_of

__all__ = ["Reduced", "Reducer"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Reduced:
    """What is kept of a piece: its times (s), the number of rows of each joint, and its factors as ``packed``; the same
    of what was ``repeated`` of it, once and twice."""

    begins: float
    ends: float
    rows: tuple[int, ...]
    factors: bytes
    repeated: tuple[tuple[int, ...], bytes, bytes]

    __repr__ = brief

    def repetitions(self, structure: Structure) -> Repeated:
        """Return the factors of what was repeated."""
        rows, *contents = self.repeated
        return Repeated(*(unpacked(one, rows, structure) for one in contents))


@dataclass(frozen=True, eq=False)
class Reducer:
    """Reduces a piece to its factors, with everything chosen: the same motion, rows and equations as of the whole.

    Some samples of it are repeated, with the torque of ``theta`` (p) and this ``credible`` share of the noise.
    """

    model: Model
    recipe: Recipe
    recordings: tuple[LongRecording, ...]
    without_rests: bool
    theta: Array
    credible: float

    __repr__ = brief

    def __call__(self, span: Span) -> Reduced:
        """Read, smooth and reduce a piece. Raises the errors of reading and smoothing."""
        log, kept = self.recordings[span.recording].read(slice(span.first, span.last))
        start, stop = (int(k) for k in np.searchsorted(kept, (span.start - span.first, span.stop - span.first)))
        with one_thread():
            motion = self.motion(log)
            speeds = self.recipe.min_speeds(motion.joints)
            regression = Regression(self.model, (motion,), self.recipe.filter, speeds)
            structure = self.model.structure
            found = factorise(regression.entries(within=(0, slice(start, stop))), structure)
            first = start + max(0, (stop - start - PIECE) // 2)
            some = slice(first, min(first + PIECE, stop))
            again = self.repeated(log, regression, some, np.random.default_rng([span.recording, span.start]))
        begins, ends = float(log.t[start]), float(log.t[stop - 1])
        repeated = tuple(again.once.rows.tolist()), packed(again.once, structure), packed(again.twice, structure)
        return Reduced(begins, ends, tuple(found.rows.tolist()), packed(found, structure), repeated)

    def repeated(self, log: Log, regression: Regression, rows: slice, rng: np.random.Generator) -> Repeated:
        """Return the factors of some rows of a piece that are repeated; of none where they cannot be smoothed alone."""
        (motion,), (smoother,), theta = regression.motions, self.recipe.smoothers, self.theta
        cut = motion.shifted(0.0, np.arange(rows.start, rows.stop))
        with suppress(InputError):
            alone = self.recipe.repaired(log.rows(rows, log.source), torque=False)
            for one in pieces_of(self.model, alone, cut, smoother, theta, 1.0):
                return repeat(self.model, replace(one, sigma=one.sigma * self.credible), theta, regression, rng)
        none = factorise((), self.model.structure)
        return Repeated(none, none)

    def motion(self, log: Log) -> Motion:
        """Return the motion of a piece, of which the fit keeps what it keeps of a whole log."""
        recipe = self.recipe
        motion = self.model.remembering(motion_of(recipe.smoothers[0], recipe.repaired(log, torque=True)))
        if recipe.outliers == "mask":
            speeds = recipe.min_speeds(motion.joints)
            motion = masked(self.model, {"train": {"": motion}}, {"train": {"": log}}, speeds)["train"][""]
        if self.without_rests and (still := _still(log)).any():
            moving = np.broadcast_to(~still[:, None], motion.q.shape)
            motion = replace(motion, keep=moving if motion.keep is None else moving & motion.keep)
        return self.model.remembering(recipe.fitting(motion))


def _still(log: Log) -> NDArray[np.bool_]:
    """Return which samples (N) are of a rest of the whole arm; all where it never moves."""
    out = np.zeros(len(log), dtype=bool)
    if resting(log).all():
        return ~out
    for one in whole_rests(log):
        out[one] = True
    return out
