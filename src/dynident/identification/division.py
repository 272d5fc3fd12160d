"""How recordings too long for the memory are divided: excerpts on which all is chosen, pieces that are fitted."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dynident.errors import Step
from dynident.log import Log

__all__ = ["USUAL", "Division", "LongRecording", "Span", "Stretch", "excerpts_of", "spans_of"]

TRIES = 4  # places at which an excerpt is looked for, of which that with the most motion is taken
LEAST = 4  # times the overlap: the shortest piece


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
class Division:
    """How recordings are divided: ``excerpts`` of ``excerpt`` samples; pieces of at most ``piece`` samples, and at
    least ``pieces`` of them, where these are not shorter than ``shortest``."""

    excerpts: int = 6
    excerpt: int = 20_000
    piece: int = 100_000
    pieces: int = 200
    shortest: int = 10_000


USUAL = Division()


@dataclass(frozen=True)
class Span:
    """A piece: the rows ``start`` to ``stop`` of recording number ``recording``, those from ``first`` to ``last`` being
    read."""

    recording: int
    start: int
    stop: int
    first: int
    last: int


def excerpts_of(
    recordings: Sequence[LongRecording], division: Division, progress: Callable[[str], None]
) -> Iterator[Log]:
    """Yield excerpts spread over the recordings, in each of as many shares of the time that of several with the most
    motion; all stretches as they are where they are not longer."""
    each = [(one, part) for one in recordings for part in one.stretches]
    total = sum(part.stop - part.start for _, part in each)
    if total <= division.excerpts * division.excerpt:
        for k, (one, part) in enumerate(each, start=1):
            log, _ = one.read(slice(part.start, part.stop))
            yield log if len(each) == 1 else replace(log, source=f"{one.label} excerpt {k}")
        return
    longest = max(part.stop - part.start for _, part in each)
    each = [(one, part) for one, part in each if part.stop - part.start >= min(division.excerpt, longest)]
    total = sum(part.stop - part.start for _, part in each)
    places = np.linspace(0, total, division.excerpts * TRIES, endpoint=False).astype(int)
    for k, share in enumerate(places.reshape(division.excerpts, TRIES)):
        progress(Step("reading excerpts", k, division.excerpts))
        tried = [_excerpt(each, int(place), division.excerpt) for place in share]
        best = max(tried, key=lambda log: float(np.abs(np.diff(log.q, axis=0)).mean() / np.diff(log.t).mean()))
        yield replace(best, source=f"{best.source} excerpt {k + 1}")


def _excerpt(each: Sequence[tuple[LongRecording, Stretch]], place: int, samples: int) -> Log:
    """Return the log of about so many samples from a place, counted over all stretches."""
    for one, part in each:
        length = part.stop - part.start
        if place < length:
            start = max(part.start, min(part.start + place, part.stop - samples))
            log, _ = one.read(slice(start, min(start + samples, part.stop)))
            return log
        place -= length
    raise ValueError(f"there is no sample {place}")


def spans_of(recordings: Sequence[LongRecording], division: Division, around: int) -> tuple[tuple[Span, ...], int]:
    """Return the pieces of all stretches, and the number of samples of those that are too short to be smoothed."""
    total = sum(part.stop - part.start for one in recordings for part in one.stretches)
    size = min(division.piece, max(total // division.pieces, division.shortest, LEAST * around))
    found: list[Span] = []
    lost = 0
    for k, one in enumerate(recordings):
        for part in one.stretches:
            length = part.stop - part.start
            if length <= around // 2:
                lost += length
                continue
            count = max(1, round(length / size))
            edges = [part.start + length * i // count for i in range(count + 1)]
            found += [
                Span(k, a, b, max(a - around, part.start), min(b + around, part.stop)) for a, b in pairwise(edges)
            ]
    return tuple(found), lost
