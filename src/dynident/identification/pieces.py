"""Reduction of the pieces of a long recording: each is read, smoothed and reduced to factors, by any process."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dynident.identification.motion_errors import RepetitionFactors, repeat_piece
from dynident.identification.outliers import mask_outliers
from dynident.identification.recipe import Recipe, arm_rests, keep_moving, rest_blocks
from dynident.identification.repetition import PIECE, pieces_of
from dynident.models import Model, Structure
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import smooth_log
from dynident.regression import Regression, factorise, one_thread, pack_factors, unpack_factors
from dynident.runtime import InputError, Noun, Step, report_progress
from dynident.runtime.arrays import Array

TRIAL_PLACES = 4  # places at which an excerpt is looked for, of which that with the most motion is taken
MIN_PIECE_OVERLAPS = 4  # times the overlap: the shortest piece


@dataclass(frozen=True)
class Stretch:
    """Rows ``start`` to ``stop`` of a recording without a gap, and their times (s)."""

    start: int
    stop: int
    begins: float
    ends: float


class LongRecording(Protocol):
    """A recording that stays in its files. It is picklable."""

    @property
    def label(self) -> str:
        """Its name."""

    @property
    def stretches(self) -> tuple[Stretch, ...]:
        """The rows to use, in stretches without gaps."""

    def read(self, rows: slice) -> tuple[Log, NDArray[np.intp]]:
        """Return the log of some rows of a stretch, and which of them it has."""


@dataclass(frozen=True)
class DivisionSettings:
    """How recordings are divided: ``excerpts`` of ``excerpt`` samples; pieces of at most ``piece`` samples, and at
    least ``pieces`` of them, where these are not shorter than ``shortest``."""

    excerpts: int = 6
    excerpt: int = 20_000
    piece: int = 100_000
    pieces: int = 200
    shortest: int = 10_000


DEFAULT_DIVISION = DivisionSettings()


@dataclass(frozen=True)
class Span:
    """A piece: rows ``start`` to ``stop`` of recording number ``recording``.

    Rows ``read_start`` to ``read_stop`` are read, with the overlap that smoothing needs.
    """

    recording: int
    start: int
    stop: int
    read_start: int
    read_stop: int


def read_excerpts(recordings: Sequence[LongRecording], division: DivisionSettings) -> Iterator[Log]:
    """Yield excerpts spread over the recordings.

    The time is divided into as many shares as there are excerpts; in each share the excerpt with the most motion
    among a few places is taken. All stretches are yielded whole where they are not longer than the excerpts.
    """
    stretches = [(recording, stretch) for recording in recordings for stretch in recording.stretches]
    total = sum(stretch.stop - stretch.start for _, stretch in stretches)
    if total <= division.excerpts * division.excerpt:
        for k, (recording, stretch) in enumerate(stretches, start=1):
            log, _ = recording.read(slice(stretch.start, stretch.stop))
            yield log if len(stretches) == 1 else replace(log, source=f"{recording.label} excerpt {k}")
        return
    longest = max(stretch.stop - stretch.start for _, stretch in stretches)
    # Drop short stretches unless all are short: an excerpt must fit into its stretch.
    stretches = [
        (recording, stretch)
        for recording, stretch in stretches
        if stretch.stop - stretch.start >= min(division.excerpt, longest)
    ]
    total = sum(stretch.stop - stretch.start for _, stretch in stretches)
    places = np.linspace(0, total, division.excerpts * TRIAL_PLACES, endpoint=False).astype(int)
    for k, share in enumerate(places.reshape(division.excerpts, TRIAL_PLACES)):
        report_progress(Step("reading excerpts", k, division.excerpts))
        candidates = [_excerpt(stretches, int(place), division.excerpt) for place in share]
        # The fastest motion excites most parameters: rank places by the mean speed over all joints.
        best = max(candidates, key=lambda log: float(np.abs(np.diff(log.q, axis=0)).mean() / np.diff(log.t).mean()))
        yield replace(best, source=f"{best.source} excerpt {k + 1}")


def _excerpt(stretches: Sequence[tuple[LongRecording, Stretch]], place: int, samples: int) -> Log:
    """Return the log of about ``samples`` rows from a ``place``, counted over all stretches."""
    for recording, stretch in stretches:
        length = stretch.stop - stretch.start
        if place < length:
            # Shift the excerpt back where the stretch ends before it is complete.
            start = max(stretch.start, min(stretch.start + place, stretch.stop - samples))
            log, _ = recording.read(slice(start, min(start + samples, stretch.stop)))
            return log
        place -= length
    raise ValueError(f"there is no sample {place}")


def plan_spans(
    recordings: Sequence[LongRecording], division: DivisionSettings, overlap: int
) -> tuple[tuple[Span, ...], int]:
    """Return the pieces of all stretches, and the number of samples in stretches too short to be smoothed."""
    total = sum(stretch.stop - stretch.start for recording in recordings for stretch in recording.stretches)
    size = min(division.piece, max(total // division.pieces, division.shortest, MIN_PIECE_OVERLAPS * overlap))
    spans: list[Span] = []
    lost_samples = 0
    for k, recording in enumerate(recordings):
        for stretch in recording.stretches:
            length = stretch.stop - stretch.start
            if length <= overlap // 2:
                lost_samples += length
                continue
            count = max(1, round(length / size))
            edges = [stretch.start + length * i // count for i in range(count + 1)]
            spans += [
                Span(k, a, b, max(a - overlap, stretch.start), min(b + overlap, stretch.stop))
                for a, b in pairwise(edges)
            ]
    return tuple(spans), lost_samples


class PieceFactors(Noun):
    """What is kept of a piece: its times (s), the number of rows of each joint, and its factors as ``packed``.

    ``repetition`` has the rows and factors of the rows that were repeated, once and twice.
    """

    begins: float
    ends: float
    rows: tuple[int, ...]
    factors: bytes
    repetition: tuple[tuple[int, ...], bytes, bytes]

    def repetitions(self, structure: Structure) -> RepetitionFactors:
        """Return the factors of the repetition."""
        rows, *contents = self.repetition
        return RepetitionFactors(*(unpack_factors(content, rows, structure) for content in contents))


class Reducer(Noun):
    """Reduces a piece to its factors, with the same motion, rows and equations as in the whole recording.

    Some of its samples are repeated, with the torque of ``theta`` (p) and the credible ``noise_share`` of the
    noise.
    """

    model: Model
    recipe: Recipe
    recordings: tuple[LongRecording, ...]
    without_rests: bool
    theta: Array
    noise_share: float

    def __call__(self, span: Span) -> PieceFactors:
        """Read, smooth and reduce a piece. Raises the errors of reading and smoothing."""
        log, read_rows = self.recordings[span.recording].read(slice(span.read_start, span.read_stop))
        # Rows of the log that was read include the overlap; gaps may have removed some of them.
        start, stop = (
            int(k) for k in np.searchsorted(read_rows, (span.start - span.read_start, span.stop - span.read_start))
        )
        with one_thread():
            motion = self.motion(log)
            regression = Regression(self.model, (motion,), self.recipe.selection(self.model.joints))
            structure = self.model.structure
            factors = factorise(regression.entries(within=(0, slice(start, stop))), structure)
            # The middle of the piece is repeated: enough for the bias, and away from the ends of the smoother.
            middle_start = start + max(0, (stop - start - PIECE) // 2)
            middle = slice(middle_start, min(middle_start + PIECE, stop))
            repetition = self.repeat_rows(log, regression, middle, np.random.default_rng([span.recording, span.start]))
        begins, ends = float(log.t[start]), float(log.t[stop - 1])
        packed_repetition = (
            tuple(repetition.once.rows.tolist()),
            pack_factors(repetition.once, structure),
            pack_factors(repetition.twice, structure),
        )
        return PieceFactors(
            begins, ends, tuple(factors.rows.tolist()), pack_factors(factors, structure), packed_repetition
        )

    def repeat_rows(self, log: Log, regression: Regression, rows: slice, rng: np.random.Generator) -> RepetitionFactors:
        """Return the factors of a repetition of some rows; empty where they cannot be smoothed alone."""
        (motion,), (smoother,), theta = regression.motions, self.recipe.smoothers, self.theta
        cut = motion.shift(0.0, np.arange(rows.start, rows.stop))
        with suppress(InputError):
            cut_log = self.recipe.repair(log).rows(rows, log.source)  # outliers of the piece are sought only once
            for piece in pieces_of(self.model, cut_log, cut, smoother, theta, 1.0):
                # One piece only: the rows are cut to the length of one.
                return repeat_piece(
                    self.model, replace(piece, sigma=piece.sigma * self.noise_share), theta, regression, rng
                )
        empty = factorise((), self.model.structure)
        return RepetitionFactors(empty, empty)

    def motion(self, log: Log) -> Motion:
        """Return the motion of a piece, with the same samples left out of the fit as in a whole log."""
        recipe = self.recipe
        motion = self.model.remembering(smooth_log(recipe.smoothers[0], recipe.repair(log, torque=True)))
        if recipe.outliers == "mask":
            selection = recipe.selection(self.model.joints)
            motion = mask_outliers(self.model, {"train": {"": motion}}, {"train": {"": log}}, selection)["train"][""]
        if self.without_rests and (is_resting := _rest_mask(log)).any():
            motion = keep_moving(motion, is_resting)
        return self.model.remembering(recipe.drop_unfitted(motion))


def _rest_mask(log: Log) -> NDArray[np.bool_]:
    """Return which samples (N) belong to a rest of the whole arm; all where it never moves."""
    out = np.zeros(len(log), dtype=bool)
    if rest_blocks(log).all():
        return ~out
    for rest in arm_rests(log):
        out[rest] = True
    return out
