"""A controller whose velocity is a difference over several of its steps, as drives smooth coarse encoders."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError, brief
from dynident.log import HasState
from dynident.simulation.controllers import Around, HasTimes
from dynident.simulation.slopes import Seen, Slopes, slopes_of

__all__ = ["Differenced"]

Array = NDArray[np.float64]
MOST = 100


@dataclass(frozen=True, eq=False)
class Differenced(Around):
    """A ``loop`` that sees as velocity the difference of positions ``steps`` of its steps apart over their time.

    That is the mean of the last differences over one step, which it remembers; steps are of equal length. Before the
    first sample the velocity has been that of the start. Raises ConfigError where steps is not from 1 to 100.
    """

    loop: HasTimes
    steps: int

    __repr__ = brief

    def __post_init__(self) -> None:
        if not 1 <= self.steps <= MOST:
            raise ConfigError(f"steps = {self.steps}; give a whole number from 1 to {MOST}.")

    def begin(self, t: float, h: float, q: Array, dq: Array, tau: Array) -> Array:
        """Return the last differences and the state of the loop before the first sample."""
        inner = self.loop.begin(t, h, q, dq, tau) if isinstance(self.loop, HasState) else np.zeros(0)
        return np.concatenate((np.tile(dq, self.steps - 1), inner))

    def advance(self, t: float, h: float, q: Array, dq: Array, state: Array) -> tuple[Array, Array]:
        """Return the torque (n) and the next state."""
        last, inner = np.split(state, [self._kept(len(q))])
        rate = (dq + last.reshape(-1, len(q)).sum(axis=0)) / self.steps
        if isinstance(self.loop, HasState):
            tau, inner = self.loop.advance(t, h, q, rate, inner)
        else:
            tau = self.loop(t, q, rate)
        return tau, np.concatenate((np.concatenate((dq, last))[: len(last)], inner))

    def slopes(self, seen: Seen) -> Slopes:
        """Return the derivatives: those of the loop by its velocity are shared by the differences."""
        rows, n = seen.q.shape
        kept = self._kept(n)
        last, inner = np.split(seen.state, [kept], axis=1)
        rate = (seen.dq + last.reshape(rows, -1, n).sum(axis=1)) / self.steps
        found = slopes_of(self.loop, replace(seen, dq=rate, state=inner))
        tau, then = (
            (
                by_q,
                by_dq / self.steps,
                np.concatenate((np.tile(by_dq / self.steps, (1, 1, self.steps - 1)), by_z), axis=2),
            )
            for by_q, by_dq, by_z in (found.tau, found.state)
        )
        moved = np.broadcast_to(np.eye(kept, n + kept + inner.shape[1]), (rows, kept, n + kept + inner.shape[1]))
        state = (
            np.concatenate((a, b), axis=1)
            for a, b in zip((np.zeros((rows, kept, n)), moved[..., :n], moved[..., n:]), then, strict=True)
        )
        by_q, by_dq, by_z = state
        return Slopes(tau, (by_q, by_dq, by_z))

    def _kept(self, n: int) -> int:
        """Return how many differences of n joints are remembered."""
        return (self.steps - 1) * n
