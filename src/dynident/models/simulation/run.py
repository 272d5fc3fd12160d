"""A recording simulated: its motion in the loop of the controller, or by the measured torque in pieces."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.models.model import Model
from dynident.models.simulation.controllers import HasTimes
from dynident.models.simulation.steps import integrate
from dynident.models.simulation.trace import MAX_POSITION, Broken, Failure, Machine, RunsAway, Singular, Trace
from dynident.motion.log import Controller, Motion
from dynident.motion.splines import stretches
from dynident.runtime import ConfigError, DynidentError, InputError, Noun
from dynident.runtime.arrays import Array

TIME_TOLERANCE = 0.01  # of a step: times that are as near are the same


class Ticks(Noun):
    """A ``motion`` whose ``rows`` are the times at which a controller works; ``at`` (K) are those of the log's samples
    among these."""

    motion: Motion
    rows: slice
    at: NDArray[np.intp]


def longest_stretch(motion: Motion) -> slice:
    """Return the longest stretch of usable samples, empty where none is usable."""
    return max(stretches(motion.mask), key=lambda stretch: stretch.stop - stretch.start, default=slice(0, 0))


def ticks(motion: Motion, controller: Controller | None, rows: slice) -> Ticks:
    """Return samples ``rows`` of a motion at the times of a controller's references: a drive is often faster than its
    log.

    Between samples the motion is interpolated linearly; only its start matters to a simulation. It stays as it is where
    the controller has no times, no more than the log, or not those of the log among them.
    """
    unchanged = Ticks(motion, rows, np.arange(rows.stop - rows.start))
    if not isinstance(controller, HasTimes) or len(controller.t) < 2 or rows.stop - rows.start < 2:
        return unchanged
    logged = motion.t[rows]
    tolerance = TIME_TOLERANCE * float(np.diff(controller.t).min())
    # references that the log covers
    t = controller.t[(controller.t > logged[0] - tolerance) & (controller.t < logged[-1] + tolerance)]
    # each sample of the log must be one of the times of the references
    at = np.clip(np.searchsorted(t, logged - tolerance), 0, max(len(t) - 1, 0))
    if len(t) <= len(at) or (np.abs(t[at] - logged) > tolerance).any():
        return unchanged
    q, dq, ddq, tau = (
        np.column_stack([np.interp(t, motion.t, column) for column in columns.T])
        for columns in (motion.q, motion.dq, motion.ddq, motion.tau)
    )
    fine = Motion(t, q, dq, ddq, tau, motion.joints, np.ones(len(t), dtype=bool), motion.source)
    return Ticks(fine, slice(0, len(t)), at)


class SimulatedRecording(Noun):
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

    @property
    def motion(self) -> Motion:
        """The simulated motion of a single piece; InputError where it failed, or has several."""
        if self.failure is not None or len(self.rows) > 1:
            raise InputError("only the simulation of one piece that did not fail is a motion.")
        usable = np.ones(len(self.t), dtype=bool)
        method = {"method": "simulated"}
        return Motion(self.t, self.q, self.dq, self.ddq, self.tau, self.joints, usable, "simulation", method)


def simulate_recording(
    model: Model,
    theta: ArrayLike,
    start: Motion,
    controller: Controller | None = None,
    *,
    rows: slice | None = None,
    restart: float | None = None,
) -> SimulatedRecording:
    """Simulate a motion with the parameters theta (p), from the state at its first sample on.

    With a ``controller`` the loop is closed around the model: the torque of each sample is held to the next, and
    the velocity fed back is the backward difference of the simulated position, as in a drive. (For a controller
    that is faster than the samples, simulate the samples of ``ticks``.) Otherwise the measured torque drives the
    model, each ``restart`` s again from the measured state (None: never), all pieces together. ``rows`` are the
    samples, by default the longest stretch of usable ones; a rest shorter than ``restart`` is left out. The steps
    are at most 1 ms. A loop that runs away, a singular mass matrix and a model without a value are a ``failure``.
    Raises InputError where the controller has other joints, or where there are fewer than three samples.
    """
    start = model.remembering(start)
    samples = _split_pieces(start, controller, rows, restart)
    t, shape, measured_torque = start.t[samples.ravel()], (samples.size, len(start.joints)), start.tau[samples[0, 0]]
    try:
        with np.errstate(all="ignore"):  # a diverging run is reported below
            trace = integrate(Machine(model, theta), start, samples, controller)
            q, dq, ddq, tau = (array.swapaxes(0, 1).reshape(shape) for array in _take_samples(trace))
    except (DynidentError, np.linalg.LinAlgError) as fault:
        failure: Failure = Broken(str(fault)) if isinstance(fault, DynidentError) else Singular()
        states = (np.full(shape, np.inf),) * 3
        tau = start.tau[samples].reshape(shape)
        return SimulatedRecording(start.joints, samples, t, *states, tau, measured_torque, failure)
    diverged = np.flatnonzero(~(np.abs(q.reshape(*samples.shape, -1)) < MAX_POSITION).all(axis=(0, 2)))
    divergence = RunsAway(float(start.t[samples[0, diverged[0]]] - start.t[samples[0, 0]])) if len(diverged) else None
    return SimulatedRecording(start.joints, samples, t, q, dq, ddq, tau, measured_torque, divergence, trace)


def _split_pieces(
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
        rows = longest_stretch(motion)
    start, stop, step = rows.indices(len(motion))
    if step != 1 or stop - start < 3:
        raise InputError(f"{motion.source}: too few usable samples in a row to simulate.")
    # the whole number of samples that is nearest to the time of a restart
    last, sampling_period = stop - start - 1, float(np.diff(motion.t[start:stop]).mean())
    length = last if controller or restart is None else min(max(round(restart / sampling_period), 1), last)
    # pieces share their end samples; what is left after the last one is not simulated
    starts = np.arange(start, stop - length, length)
    return np.asarray(starts[:, None] + np.arange(length + 1))


def _take_samples(trace: Trace) -> tuple[Array, ...]:
    """Return q, dq, ddq and tau (K, B, n) at the samples."""
    steps = trace.samples
    # accelerations over the steps on both sides of a sample
    before, after = np.maximum(steps - 1, 0), np.minimum(steps + 1, len(trace.h))
    times = np.append(0.0, np.cumsum(trace.h))
    ddq = (trace.dq[after] - trace.dq[before]) / (times[after] - times[before])[:, None, None]
    return trace.q[steps], trace.dq[steps], ddq, trace.tau
