"""What is simulated of a recording: stretches in the loop of its controller, or segments that begin anew."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.estimators.loops import failure_of
from dynident.log import Controller, Motion
from dynident.models import Model
from dynident.simulation import Failure, Sensitivity, Simulated, sensitivities, simulated

__all__ = ["Output", "Shots", "Simulation"]

Array = NDArray[np.float64]
Output = Literal["q", "tau"]
AT_ONCE = 2048  # samples


@dataclass(frozen=True, eq=False)
class Simulation:
    """A simulated stretch: the ``run``, its residuals ``e`` (B, K, n) and which of them ``count`` (B, K, n), 0 or 1."""

    run: Simulated
    e: Array
    count: Array

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class Shots:
    """A stretch of a recording to be simulated: ``rows`` of a ``motion``, which begins the pieces and drives the model
    with its torque; with a ``controller`` it is one piece, else pieces of ``segment`` s.

    ``measured`` (N, n) are the positions to be met, rad or m, or the torque ``after`` s after the positions, N m or N;
    ``count`` (N, n) is 0 where it does not count, else 1.
    """

    motion: Motion
    measured: Array
    count: Array
    rows: slice
    segment: float
    controller: Controller | None = None
    output: Output = "q"
    after: float = 0.0

    __repr__ = brief

    @property
    def samples(self) -> int:
        """The number of samples that are simulated."""
        return len(range(*self.rows.indices(len(self.motion))))

    @property
    def restart(self) -> float | None:
        """The time (s) after which the simulation begins anew."""
        return None if self.controller is not None else self.segment

    def moved(self, at: NDArray[np.intp], by: Array) -> Shots:
        """Return the shots with the states at the starts of pieces, samples ``at`` (B), moved by (B, 2 n)."""
        q, dq = self.motion.q.copy(), self.motion.dq.copy()
        n = q.shape[1]
        q[at] += by[:, :n]
        dq[at] += by[:, n:]
        return replace(self, motion=replace(self.motion, q=q, dq=dq))

    def simulated(self, model: Model, theta: Array) -> Simulation | Failure:
        """Simulate with the parameters theta (p)."""
        run = simulated(model, theta, self.motion, self.controller, rows=self.rows, restart=self.restart)
        failure = run.failure if self.controller is None else failure_of(run, self.motion.q[self.rows])
        if failure is not None:
            return failure
        count = self.count[run.rows]
        count[:-1, -1] = 0.0  # the first of the next piece
        if self.output == "tau":
            count *= _between(run.t, self.after)[2][:, None]
        e = self.measured[run.rows] - self._seen(run.t, run).reshape(count.shape)
        return Simulation(run, e * count, count)

    def slopes(self, model: Model, theta: Array, of: Simulation, directions: Array) -> tuple[Array, Array]:
        """Return the derivatives (B, K, n, r) of what is met by ``directions`` (p, r), and by the start (.., 2 n)."""
        found = sensitivities(model, theta, of.run, self.controller, directions, only=self.output)
        assert found.start is not None  # noqa: S101
        both = [self._seen(of.run.t, one) for one in (found, found.start)]
        shaped = [one.reshape(*of.count.shape, one.shape[2]) for one in both]
        for one in shaped:
            one *= of.count[..., None]
        return shaped[0], shaped[1]

    def _seen(self, t: Array, one: Simulated | Sensitivity) -> Array:
        """Return the positions, or the torque when it was measured, of a run or of its derivatives (N, n, ...)."""
        if self.output == "q":
            return one.q
        k, share, _ = _between(t, self.after)
        share, out = share.reshape(-1, *[1] * (one.tau.ndim - 1)), np.empty_like(one.tau)
        for first in range(0, len(k), AT_ONCE):  # derivatives of a long recording are most of the memory
            some = slice(first, first + AT_ONCE)
            out[some] = (1 - share[some]) * one.tau[k[some]] + share[some] * one.tau[k[some] + 1]
        return out


def _between(t: Array, after: float) -> tuple[NDArray[np.intp], Array, NDArray[np.bool_]]:
    """Return the step in whose middle, or after it, each time t (N) + ``after`` is, its share of the way to the middle
    of the next, and whether it is on that way.

    A torque that is held from one sample to the next is on the average that of the middle.
    """
    gaps = np.diff(t)
    middle, at = t + 0.5 * np.append(gaps, gaps[-1]), t + after
    k = np.clip(np.searchsorted(middle, at + 1e-9, side="right") - 1, 0, len(t) - 2)
    share = (at - middle[k]) / (middle[k + 1] - middle[k])
    return k, np.clip(share, 0.0, 1.0), np.abs(share - 0.5) < 0.5 + 1e-6
