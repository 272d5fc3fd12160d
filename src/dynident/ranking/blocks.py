"""Blocks of time of several logs, over which errors are summed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.log import Log

__all__ = ["Blocks", "blocks_of"]

Array = NDArray[np.float64]
MOST = 400  # blocks of all logs together


@dataclass(frozen=True, eq=False)
class Blocks:
    """K blocks of equal time: of each its ``log`` (K) by number, and their length in ``seconds``; ``of`` has the block
    (N) of each sample by log."""

    log: NDArray[np.intp]
    seconds: float
    of: Mapping[str, NDArray[np.intp]]

    __repr__ = brief

    def __len__(self) -> int:
        return len(self.log)

    def sums(self, values: Mapping[str, Array]) -> Array:
        """Return the sums (K, n) of values (N, n) by log in each block; zero in blocks of logs that are not given."""
        n = next((one.shape[1] for one in values.values()), 0)
        found = np.zeros((len(self), n))
        for name, one in values.items():
            for j in range(n):
                found[:, j] += np.bincount(self.of[name], one[:, j], len(self))
        return found


def blocks_of(logs: Mapping[str, Log]) -> Blocks:
    """Return up to 400 blocks of logs, all of the same time; none holds samples of two logs."""
    spans = {name: float(log.t[-1] - log.t[0]) for name, log in logs.items()}
    steps = [float(np.diff(log.t).mean()) for log in logs.values()]
    seconds = max(sum(spans.values()) / MOST, 2.0 * max(steps, default=1.0))
    found: dict[str, NDArray[np.intp]] = {}
    owner: list[int] = []
    for k, (name, log) in enumerate(logs.items()):
        count = max(1, round(spans[name] / seconds))
        share = (log.t - log.t[0]) / max(spans[name], seconds * 1e-9)
        found[name] = len(owner) + np.minimum((share * count).astype(np.intp), count - 1)
        owner += [k] * count
    return Blocks(np.array(owner, dtype=np.intp), seconds, found)
