"""The steps of a free simulation: the midpoint rule, with friction that can hold a joint at rest (Moreau, 1988)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dynident.log import Controller, HasState, Motion
from dynident.simulation.machine import Machine
from dynident.simulation.one_joint import OneJoint
from dynident.simulation.trace import FAR, Trace, begun, divided, gaps_of, held

__all__ = ["in_arrays", "integrate"]

Array = NDArray[np.float64]


def integrate(machine: Machine, motion: Motion, rows: NDArray[np.intp], controller: Controller | None) -> Trace:
    """Simulate pieces of a motion, the samples ``rows`` (B, K); with a controller, of one piece.

    Positions are infinite after a sample at which they are beyond ``FAR``.
    """
    machine.begin(motion, rows[:, 0])
    if len(rows) == len(motion.joints) == 1 and not machine.remembers:
        return OneJoint(machine, motion, rows[0], controller).run()
    return in_arrays(machine, motion, rows, controller)


def in_arrays(machine: Machine, motion: Motion, rows: NDArray[np.intp], controller: Controller | None) -> Trace:
    """Return what ``integrate`` does, for any number of joints and pieces."""
    t = motion.t[rows]
    h, begins = divided(np.diff(t).mean(axis=0))
    q, dq = np.full((2, len(h) + 1, len(rows), len(motion.joints)), np.inf)
    q[0], dq[0] = motion.q[rows[:, 0]], motion.dq[rows[:, 0]]
    drive = None if controller is None else _Drive(controller, motion, rows[0])
    tau = held(motion, rows) if drive is None else np.full((rows.shape[1], 1, q.shape[2]), np.nan)
    ddq = np.zeros_like(q[0])
    for s, k in enumerate(begins.tolist()):
        if k >= 0:
            if drive is not None:
                tau[k, 0] = drive(k, q[s, 0])
            if s == len(h) or not (np.abs(q[s]) < FAR).all():
                break
            now = tau[k]
        q[s + 1], dq[s + 1] = machine.step(q[s], dq[s], ddq, now, float(h[s]))
        ddq = (dq[s + 1] - dq[s]) / h[s]
    return Trace(h, begins, q, dq, tau, np.zeros((len(tau), 0)) if drive is None else np.array(drive.states))


class _Drive:
    """A controller in its loop: it sees the difference quotient of the positions, and may have a state."""

    def __init__(self, controller: Controller, motion: Motion, row: NDArray[np.intp]) -> None:
        t = motion.t[row]
        self._controller = controller
        self._with_state = controller if isinstance(controller, HasState) else None  # asked once: that takes long
        self._t, self._gaps = t.tolist(), gaps_of(t).tolist()
        self._before = motion.q[row[0]] - motion.dq[row[0]] * self._gaps[0]
        self.states = np.zeros((len(row), len(start := begun(controller, motion, row))))
        self._state = start

    def __call__(self, k: int, q: Array) -> Array:
        """Return the torque (n) from sample k on, at the positions q (n)."""
        self.states[k] = self._state
        rate, self._before = (q - self._before) / self._gaps[k], q
        if self._with_state is None:
            return self._controller(self._t[k], q, rate)
        tau, self._state = self._with_state.advance(self._t[k], self._gaps[k], q, rate, self._state)
        return tau
