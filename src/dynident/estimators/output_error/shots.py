"""What is simulated of a recording: one piece in the loop of its controller, or segments that begin anew."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError, brief
from dynident.estimators.estimator import Problem
from dynident.log import Controller, Motion
from dynident.models import Model
from dynident.regression import stretches
from dynident.simulation import Failure, Sensitivity, Simulated, sensitivities, simulated

__all__ = ["Shots", "Simulation", "shots_of"]

Array = NDArray[np.float64]
SEGMENT = 1.0  # s, of a measured torque: its noise moves the model more than sensors of positions have noise
KNOWN = 5.0  # s, of a commanded torque, which has none


@dataclass(frozen=True, eq=False)
class Simulation:
    """A simulated recording: the ``run``, its residuals e (B, K, n) of the positions, and its ``slopes``, once asked."""

    run: Simulated
    e: Array

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class Shots:
    """A recording to be simulated: ``motion`` begins the pieces, with the torque that drives it; ``measured`` (N, n) are
    the positions to be met. With a ``controller`` it is one piece, else pieces of ``segment`` s.
    """

    motion: Motion
    measured: Array
    rows: slice
    segment: float
    controller: Controller | None = None

    __repr__ = brief

    def opened(self) -> Shots:
        """Return the same to be driven by the torque."""
        return replace(self, controller=None)

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
        if run.failure is not None:
            return run.failure
        e = self.measured[run.rows] - run.q.reshape(*run.rows.shape, -1)
        if self.controller is None and len(run.rows) > 1:
            e[:-1, -1] = 0.0  # the first of the next piece
        return Simulation(run, e)

    def slopes(self, model: Model, theta: Array, of: Simulation, directions: Array) -> tuple[Array, Array]:
        """Return the derivatives of the positions (B, K, n, r) by ``directions`` (p, r), and by the start (.., 2 n)."""
        found = sensitivities(model, theta, of.run, self.controller, directions)
        start = found.start
        assert isinstance(start, Sensitivity)  # noqa: S101
        shape = (*of.run.rows.shape, self.motion.q.shape[1], -1)
        by_theta, by_start = found.q.reshape(shape), start.q.reshape(shape)
        if self.controller is None and len(of.run.rows) > 1:
            by_theta, by_start = by_theta.copy(), by_start.copy()
            by_theta[:-1, -1], by_start[:-1, -1] = 0.0, 0.0
        return by_theta, by_start


def shots_of(problem: Problem, k: int, segment: float | None) -> Shots:
    """Return what is to be simulated of the k-th recording: its longest uninterrupted stretch.

    Positions are simulated when they are stamped, the torque that drives the model is then that of the same moment.
    """
    motion = problem.motions[k]
    logs = problem.logs
    log = logs[k] if len(logs) == len(problem.motions) and len(logs[k]) == len(motion) else None
    stamped = motion.shifted(-motion.time_offset)
    usable = max(stretches(stamped.mask), key=lambda one: one.stop - one.start, default=slice(0, 0))
    if usable.stop - usable.start < 3:
        raise InputError(f"{motion.source}: too few usable samples in a row to simulate.")
    command = None if log is None else log.command
    if command is not None:
        stamped = replace(stamped, tau=command)
    elif motion.time_offset:
        stamped = replace(stamped, tau=_late(motion))
    measured = stamped.q if log is None else log.q
    length = segment or (SEGMENT if command is None else KNOWN)
    return Shots(stamped, measured, usable, length, None if log is None else log.controller)


def _late(motion: Motion) -> Array:
    """Return the torque when the positions are stamped: they are stamped later by the time offset."""
    t = motion.t - motion.time_offset
    found = np.column_stack([np.interp(t, motion.t, one) for one in motion.tau.T])
    found.flags.writeable = False
    return found
