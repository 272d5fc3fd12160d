"""Free simulation of a recording: the model is driven by the controller, or by the measured torque."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from dynident.models import Model
from dynident.models.simulation import Failure, longest_stretch, simulate_recording, ticks
from dynident.motion.log import Controller, Motion
from dynident.runtime import OMITTED, ConfigError, InputError, Noun
from dynident.runtime.arrays import Array


class Driver(StrEnum):
    """What drives the model in a free simulation: the controller, or the measured torque."""

    CONTROLLER = "controller"
    TORQUE = "torque"


class RunSignals(Noun):
    """``t`` (N) s, ``q`` (N, n) simulated and ``measured`` (N, n), rad or m, and ``tau`` (N, n) that drove the
    model.
    """

    t: Array
    q: Array
    measured: Array
    tau: Array


class FreeRun(Noun):
    """How a simulated recording compares with the measured one.

    ``driver`` is "controller" (from one start) or "torque" (as measured, with a fresh start each ``restart`` s). By
    joint name: ``relative_error`` = 100 |measured - q| / |measured| in %, ``motion_error`` the same in % of the way
    from the latest start, ``rms`` in rad or m; with a controller ``torque_error`` (%), how far its torque is from the
    measured one, which tests the model harder: the loop keeps any model on its way. Where the simulation ends early,
    ``failure`` says why, and the errors are infinite. ``signals`` are None in a result that was loaded from a file.
    """

    name: str
    joints: tuple[str, ...]
    driver: Driver
    restart: float | None
    relative_error: Mapping[str, float]
    motion_error: Mapping[str, float]
    rms: Mapping[str, float]
    torque_error: Mapping[str, float]
    failure: Failure | None = None
    signals: Annotated[RunSignals | None, OMITTED] = None

    @property
    def t(self) -> Array:
        """Time (N) in s; InputError, as of the other signals, in a result that was loaded from a file."""
        return self._signals().t

    @property
    def q(self) -> Array:
        """The simulated positions (N, n)."""
        return self._signals().q

    @property
    def measured(self) -> Array:
        """The measured positions (N, n)."""
        return self._signals().measured

    @property
    def tau(self) -> Array:
        """The torque (N, n) that drove the model."""
        return self._signals().tau

    def _signals(self) -> RunSignals:
        if self.signals is None:
            raise InputError(
                f"{self.name}: a saved result holds the errors of this simulation but not its signals; identify again."
            )
        return self.signals


def free_run(
    model: Model,
    theta: ArrayLike,
    motion: Motion,
    controller: Controller | None = None,
    restart: float | None = None,
    *,
    name: str | None = None,
) -> FreeRun:
    """Simulate a motion from its first usable sample on, with the parameters theta (p), and compare the positions.

    With a ``controller`` the loop is closed around the model: the torque of each sample is held to the next, and the
    velocity fed back is the backward difference of the simulated position, as in a drive. Otherwise the measured torque
    drives the model, and every ``restart`` s (then required) the simulation restarts from the measured state: without
    its controller an arm drifts for any model. A controller works at the times of its references, where
    these are more than the samples. Raises ConfigError where neither is given, InputError where the controller has
    other joints, or where too few samples are usable.
    """
    # without its controller a simulated arm drifts away for any model, so that restarts are needed
    if controller is None and restart is None:
        raise ConfigError("free simulation needs a controller, or `restart` (s) for the measured torque.")
    fine_grid = ticks(motion, controller, usable := longest_stretch(motion))
    run = simulate_recording(
        model, theta, fine_grid.motion, controller, rows=fine_grid.rows, restart=None if controller else restart
    )
    rows = run.rows if controller is None else np.arange(usable.start, usable.stop)[None]
    sample_times = slice(None) if controller is None else fine_grid.at
    q, tau = (channel[sample_times].reshape(*rows.shape, len(motion.joints)) for channel in (run.q, run.tau))
    # each piece ends at the start of the next, whose sample would count twice
    measured, torques, sample_rows = motion.q[rows], motion.tau[rows], rows[:, :-1].ravel()
    # a simulation that ended early has infinite errors
    error = np.full_like(q, np.inf) if run.failure else q - measured
    torque_errors = (
        {} if controller is None else _relative_errors(motion.joints, error if run.failure else tau - torques, torques)
    )
    return FreeRun(
        name=name or motion.source,
        joints=motion.joints,
        driver=Driver.TORQUE if controller is None else Driver.CONTROLLER,
        restart=None if controller is not None else restart,
        relative_error=_relative_errors(motion.joints, error, measured),
        motion_error=_relative_errors(motion.joints, error, measured - measured[:, :1]),
        rms=dict(zip(motion.joints, np.sqrt(np.mean(error**2, axis=(0, 1))).tolist(), strict=True)),
        torque_error=torque_errors,
        failure=run.failure,
        signals=RunSignals(
            motion.t[sample_rows],
            q[:, :-1].reshape(-1, q.shape[2]),
            motion.q[sample_rows],
            tau[:, :-1].reshape(-1, q.shape[2]),
        ),
    )


def _relative_errors(joints: tuple[str, ...], error: Array, reference: Array) -> dict[str, float]:
    sizes = np.linalg.norm(reference, axis=(0, 1))
    wrong = np.linalg.norm(error, axis=(0, 1))
    return {j: 100.0 * float(e / s) if s > 0 else float("nan") for j, e, s in zip(joints, wrong, sizes, strict=True)}
