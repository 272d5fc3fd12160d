"""Sums of blocks over windows that end now, of about every length, in memory that does not grow.

Neighbouring sums are merged into longer ones the older they are (the exponential histogram of Datar, Gionis, Indyk and
Motwani, 2002): of each length, a power of two, a few are kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief

__all__ = ["EACH", "Sums", "pushed", "suffixes"]

Array = NDArray[np.float64]
EACH = 4  # sums of the same length that are kept, at most: windows are then known to a quarter of their length


@dataclass(frozen=True, eq=False)
class Sums:
    """Sums over ``count`` blocks from ``start`` to ``stop`` (s), of ``samples``: information (r, r) and score (r).

    ``clipped`` (M) are the scores of the groups' directions beside the reference, those of single blocks limited;
    ``left`` (n) the standardised logarithms of what is left of the torque, of ``left_count`` (n) blocks, and
    ``left_clipped`` (n) the same, limited.
    """

    start: float
    stop: float
    count: int
    samples: int
    information: Array
    score: Array
    clipped: Array
    left: Array
    left_clipped: Array
    left_count: Array

    __repr__ = brief

    def __add__(self, later: Sums) -> Sums:
        """Return the sums over both."""
        sums = {one.name: getattr(self, one.name) + getattr(later, one.name) for one in fields(self)[2:]}
        return Sums(self.start, later.stop, **sums)


def pushed(kept: Sequence[Sums], new: Sums) -> tuple[Sums, ...]:
    """Return the sums with those of one more block: of more than ``EACH`` of one length, the oldest two merge."""
    found, length = [*kept, new], new.count
    while True:
        same = [k for k, one in enumerate(found) if one.count == length]
        if len(same) <= EACH:
            return tuple(found)
        k = same[0]
        found[k : k + 2] = [found[k] + found[k + 1]]
        length *= 2


def suffixes(kept: Sequence[Sums]) -> tuple[Array, dict[str, Array]]:
    """Return the starts (S) of the windows that end now, the shortest first, and their sums by name (S, ...)."""
    back = list(reversed(kept))
    names = [one.name for one in fields(Sums)[2:]]
    sums = {name: np.cumsum([getattr(one, name) for one in back], axis=0) for name in names}
    return np.array([one.start for one in back]), sums
