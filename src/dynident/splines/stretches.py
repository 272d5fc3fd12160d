"""Uninterrupted stretches of samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["stretches"]


def stretches(mask: NDArray[np.bool_]) -> list[slice]:
    """Return the uninterrupted runs of True in a mask (N) as slices."""
    edges = [0, *(np.flatnonzero(mask[1:] != mask[:-1]) + 1).tolist(), len(mask)]
    first = 0 if len(mask) and mask[0] else 1
    return [slice(a, b) for a, b in zip(edges[first:-1:2], edges[first + 1 :: 2], strict=True)]
