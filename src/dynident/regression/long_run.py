"""The long-run covariance of correlated series, by Newey and West (1987), with the bandwidth of Andrews (1991)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

__all__ = ["bandwidth", "bartlett", "long_run"]

Array = NDArray[np.float64]


def bandwidth(series: Iterator[Iterator[Array]]) -> int:
    """Return Andrews' (1991, eqs. 5.3 and 6.4) L in samples for Bartlett's kernel, each column fitted as AR(1).

    ``series`` holds for each uninterrupted stretch its blocks (B, r). All columns count alike; L is at most a tenth of
    the samples.
    """
    now: Array | float = 0.0
    lagged: Array | float = 0.0
    rows = 0
    for blocks in series:
        last = None
        for u in blocks:
            joined = u if last is None else np.concatenate((last, u))
            now, lagged = now + np.square(u).sum(axis=0), lagged + (joined[1:] * joined[:-1]).sum(axis=0)
            last, rows = u[-1:], rows + len(u)
    rho = np.clip(lagged / np.where(np.asarray(now) > 0, now, 1.0), -0.9999, 0.9999)
    spread = (1 - rho**2) ** 2  # squared innovation variance of a series of unit variance
    alpha = np.sum(4 * rho**2 * spread / ((1 - rho) ** 6 * (1 + rho) ** 2)) / np.sum(spread / (1 - rho) ** 4)
    return int(np.clip(np.ceil(1.1447 * (alpha * rows) ** (1 / 3)), 1, max(rows // 10, 1)))


def long_run(series: Sequence[Array]) -> Array:
    """Return S = sum_ts max(0, 1 - |t - s| / L) u_t u_s' (r, r) of scores u (N, r), a series for each stretch."""
    length = bandwidth(iter([u]) for u in series)
    return np.asarray(sum(bartlett(iter([u]), length, u.shape[1])[1] for u in series))


def bartlett(blocks: Iterator[Array], length: int, width: int) -> tuple[int, Array]:
    """Return the number of rows and (1/L) sum b_t b_t', the running sums b reaching past both ends."""
    held, rows, total = np.zeros((length - 1, width)), 0, np.zeros((width, width))

    def add(u: Array) -> None:
        """Add the next rows to the sums that are still running, and those that end to the total."""
        nonlocal held, total
        sums = np.cumsum(np.concatenate((np.zeros((1, width)), held, u)), axis=0)
        b = sums[length:] - sums[:-length]
        total = total + b.T @ b
        held = np.concatenate((held, u))[len(u) :]

    for u in blocks:
        add(u)
        rows += len(u)
    add(np.zeros((length - 1, width)))
    return rows, total / length
