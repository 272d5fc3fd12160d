"""How many jobs go together: as many as make what a batch costs besides small."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Hashable
from statistics import median

__all__ = ["Pace"]

FASTEST, SLOWEST = 0.2, 10.0  # s: least and most work of a batch, of which two for each worker are lost when all stops
MOST = 1000  # jobs in a batch
SHARE = 0.05  # of the time that may be lost between jobs
FORGET = 0.8  # what is measured counts that much less with each further batch
LATEST = 31  # batches that show what one costs
AHEAD = 2  # batches of each worker that are under way


class Pace:
    """Sizes of batches, from 1 by doubling up to a work of 20 times what is lost with each.

    ``workers`` is how many there may be; those that are ``seen`` count when they are more.
    """

    def __init__(self, workers: int) -> None:
        self._workers, self._seen = workers, set[Hashable]()
        self._largest, self._jobs, self._seconds = 1, 0.0, 0.0
        self._lost: deque[float] = deque(maxlen=LATEST)

    @property
    def workers(self) -> int:
        """How many there are."""
        return max(self._workers, len(self._seen))

    @property
    def ahead(self) -> int:
        """How many batches are under way at a time."""
        return AHEAD * self.workers

    def size(self, rest: int | None = None) -> int:
        """Return how many jobs go into the next batch, where ``rest`` (None: unknown) are left."""
        if not self._jobs:
            return 1
        lost = median(self._lost) if self._lost else 0.0
        work = min(max(lost * (1 / SHARE - 1), FASTEST), SLOWEST)
        mean = max(self._seconds / self._jobs, 1e-9)
        share = MOST if rest is None else math.ceil(rest / self.ahead)
        return max(1, min(MOST, 2 * self._largest, int(work / mean), share))

    def saw(self, worker: Hashable, jobs: int, seconds: float, lost: float | None) -> None:
        """Take in a batch that has ended, whose jobs took ``seconds``, beside which others were ``lost``."""
        self._seen.add(worker)
        self._largest = max(self._largest, jobs)
        self._jobs = FORGET * self._jobs + jobs
        self._seconds = FORGET * self._seconds + seconds
        if lost is not None:
            self._lost.append(lost)
