"""A recording simulated: its motion in the loop of the controller, or by the measured torque in pieces."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.errors import ConfigError, DynidentError, InputError, brief
from dynident.log import Controller, Motion
from dynident.models import Model
from dynident.simulation.failure import Broken, Failure, RunsAway, Singular
from dynident.simulation.machine import Machine
from dynident.simulation.stepper import integrate
from dynident.simulation.ticks import longest
from dynident.simulation.trace import FAR, Trace

__all__ = ["Simulated", "simulated"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Simulated:
    """A simulated recording: t (N) s; q, dq, ddq and the tau that drove the model from each sample on, (N, n), SI.

    ``rows`` (B, K) are the samples of the measured motion that were simulated, N = B K, piece after piece; each begins
    with the last sample of the one before, at its measured state. ``ddq`` is the difference quotient of dq over the
    steps beside a sample; ``measured`` (n) the measured torque at the start. Where the simulation ends early,
    ``failure`` says why, and what follows is not finite; ``trace`` are the steps, None where the model could not be
    evaluated.
    """

    joints: tuple[str, ...]
    rows: NDArray[np.intp]
    t: Array
    q: Array
    dq: Array
    ddq: Array
    tau: Array
    measured: Array
    failure: Failure | None = None
    trace: Trace | None = None

    __repr__ = brief

    @property
    def motion(self) -> Motion:
        """The simulated motion of a single piece; InputError where it failed, or has several."""
        if self.failure is not None or len(self.rows) > 1:
            raise InputError("only the simulation of one piece that did not fail is a motion.")
        usable = np.ones(len(self.t), dtype=bool)
        method = {"method": "simulated"}
        return Motion(self.t, self.q, self.dq, self.ddq, self.tau, self.joints, usable, "simulation", method)


def simulated(
    model: Model,
    theta: ArrayLike,
    start: Motion,
    controller: Controller | None = None,
    *,
    rows: slice | None = None,
    restart: float | None = None,
) -> Simulated:
    """Simulate a motion with the parameters theta (p), from the state at its first sample on.

    With a ``controller`` the loop is closed around the model: the torque of each sample is held to the next, and the
    velocity fed back is the backward difference of the simulated position, as in a drive (of one that is faster than
    the samples simulate those of ``ticks``). Otherwise the measured torque
    drives the model, each ``restart`` s again from the measured state (None: never), all pieces together. ``rows`` are
    the samples, by default the longest stretch of usable ones; a rest shorter than ``restart`` is left out. The steps
    are at most 1 ms. A loop that runs away, a singular mass matrix and a model without a value are a ``failure``.
    Raises InputError where the controller has other joints, or where there are fewer than three samples.
    """
    start = model.remembering(start)
    at = _pieces(start, controller, rows, restart)
    shape, first = (at.size, len(start.joints)), start.tau[at[0, 0]]
    try:
        with np.errstate(all="ignore"):  # a diverging run is reported below
            trace = integrate(Machine(model, theta), start, at, controller)
            q, dq, ddq, tau = (one.swapaxes(0, 1).reshape(shape) for one in _sampled(trace))
    except (DynidentError, np.linalg.LinAlgError) as fault:
        failure: Failure = Broken(str(fault)) if isinstance(fault, DynidentError) else Singular()
        nowhere = np.full(shape, np.inf)
        tau = start.tau[at].reshape(shape)
        return Simulated(start.joints, at, start.t[at.ravel()], nowhere, nowhere, nowhere, tau, first, failure)
    t = start.t[at.ravel()]
    far = np.flatnonzero(~(np.abs(q.reshape(*at.shape, -1)) < FAR).all(axis=(0, 2)))
    away = RunsAway(float(start.t[at[0, far[0]]] - start.t[at[0, 0]])) if len(far) else None
    return Simulated(start.joints, at, t, q, dq, ddq, tau, first, away, trace)


def _pieces(
    motion: Motion, controller: Controller | None, rows: slice | None, restart: float | None
) -> NDArray[np.intp]:
    """Return the samples (B, K) to simulate; with a controller, one piece.

    The last sample of each piece is the first of the next.
    """
    if controller is not None and controller.joints != motion.joints:
        raise InputError(f"{motion.source}: the controller has joints {controller.joints}, the log {motion.joints}.")
    if restart is not None and not restart > 0:
        raise ConfigError(f"restart is {restart}; give a positive time (s).")
    if rows is None:
        rows = longest(motion)
    first, stop, step = rows.indices(len(motion))
    if step != 1 or stop - first < 3:
        raise InputError(f"{motion.source}: too few usable samples in a row to simulate.")
    last, apart = stop - first - 1, float(np.diff(motion.t[first:stop]).mean())
    length = last if controller or restart is None else min(max(round(restart / apart), 1), last)
    starts = np.arange(first, stop - length, length)
    return np.asarray(starts[:, None] + np.arange(length + 1))


def _sampled(trace: Trace) -> tuple[Array, ...]:
    """Return q, dq, ddq and tau (K, B, n) at the samples."""
    at = trace.samples
    before, after = np.maximum(at - 1, 0), np.minimum(at + 1, len(trace.h))
    times = np.append(0.0, np.cumsum(trace.h))
    ddq = (trace.dq[after] - trace.dq[before]) / (times[after] - times[before])[:, None, None]
    return trace.q[at], trace.dq[at], ddq, trace.tau
