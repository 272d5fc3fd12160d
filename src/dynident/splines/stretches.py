"""Uninterrupted stretches of samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

__all__ = ["stretches"]


def stretches(mask: NDArray[np.bool_]) -> list[slice]:
    """Return the uninterrupted runs of True in a mask (N) as slices."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], mask.astype(np.int8), [0]))))
    return [slice(int(a), int(b)) for a, b in edges.reshape(-1, 2)]
