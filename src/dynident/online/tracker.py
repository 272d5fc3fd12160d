"""A result followed on a stream of samples: motion with a fixed lag, torque equations, recursive least squares."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.errors import brief
from dynident.estimators import Estimate, Estimator
from dynident.identification import Identification
from dynident.log import Motion
from dynident.online.recursive import RecursiveLeastSquares
from dynident.regression import EntryBlock, GroupKind

__all__ = ["Block", "Tracker"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Block:
    """Consecutive samples whose motion is final, in the order of time, none twice.

    ``motion`` has their derivatives, its mask False where these are not reliable; ``entries`` are the torque equations
    of the usable samples as a fit has them: filtered, decimated, without joints that are too slow.
    """

    motion: Motion
    entries: tuple[EntryBlock, ...]

    __repr__ = brief


class Tracker:
    """Follows the parameters of a robot by a result and a stream of positions and torques."""

    fit: RecursiveLeastSquares

    def __init__(
        self,
        result: Identification,
        memory: float | Mapping[GroupKind, float] = np.inf,
        lag: float | None = None,
        bandwidth: ArrayLike | None = None,
    ) -> None:
        raise NotImplementedError

    def push(self, t: ArrayLike, q: ArrayLike, tau: ArrayLike) -> tuple[Block, ...]:
        """Take samples, t (B) s, q and tau (B, n), as many as there are, and return the blocks that they complete."""
        raise NotImplementedError

    def finish(self) -> tuple[Block, ...]:
        """Return what is left at the end of the data, or before a gap."""
        raise NotImplementedError

    def estimate(self, estimator: Estimator | None = None) -> Estimate:
        """Return the estimate as it is now."""
        raise NotImplementedError

    @property
    def state(self) -> dict[str, Array]:
        """All that it knows, as plain arrays."""
        raise NotImplementedError

    def restore(self, state: Mapping[str, Array]) -> None:
        """Continue from a saved state of a tracker of the same result."""
        raise NotImplementedError
