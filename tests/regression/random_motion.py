"""Random motion of the two-link arm, and the rows that a regression makes of it."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dynident.models.lagrangian import two_link_arm
from dynident.motion.log import Motion
from dynident.regression import ParallelFilter, Regression, Selection

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
ARM = two_link_arm()
THETA = ARM.values
RATE = 100.0


def motion(
    samples: int = 1000, noise: float = 0.1, mask: Mask | None = None, seed: int = 0, source: str = "made"
) -> Motion:
    """Random states, so that no column is smooth, with noise on the torque."""
    rng = np.random.default_rng(seed)
    q, dq, ddq = rng.normal(size=(3, samples, 2)) * np.array([1.0, 2.0, 10.0])[:, None, None]
    tau = ARM.torque(q, dq, ddq, THETA) + noise * rng.normal(size=(samples, 2))
    mask = np.ones(samples, dtype=bool) if mask is None else mask
    return Motion(np.arange(samples) / RATE, q, dq, ddq, tau, ("joint1", "joint2"), mask, source)


def holes(samples: int = 1000) -> Mask:
    """Usable runs of 1, 96, 299 and all further samples; the first sample is not usable."""
    mask = np.ones(samples, dtype=bool)
    mask[[0, 2, 499]] = mask[99:200] = False
    return mask


def drawn(motions: Sequence[Motion], parallel_filter: ParallelFilter | None = None) -> tuple[Array, Array]:
    """All blocks in one."""
    blocks = list(Regression(ARM, tuple(motions), Selection(parallel_filter)).blocks())
    return np.concatenate([block.Y for block in blocks]), np.concatenate([block.tau for block in blocks])
