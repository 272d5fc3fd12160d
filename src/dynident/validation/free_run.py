"""Free simulation of a recording: the model is driven by the controller, or by the measured torque."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.errors import ConfigError, DynidentError, InputError, brief
from dynident.log import Controller, Motion
from dynident.models import Model
from dynident.regression import stretches
from dynident.validation.stepper import FAR, Machine, integrate

__all__ = ["Broken", "CascadePD", "Driver", "Failure", "FreeRun", "RunSignals", "RunsAway", "Singular", "free_run"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class CascadePD:
    """A drive with a position loop around a velocity loop: tau = gain clip(kv (kp (reference - q) - dq) + feedforward).

    ``t`` (N) s; ``reference`` (N, n) rad or m; ``kp`` (n) 1/s; ``kv`` (n) input per rad/s or m/s; ``gain`` (n) N m or N
    per input; ``saturation`` (n) of the input, infinite where there is none; ``feedforward`` (N, n) of the input.
    References are held constant between samples. Raises InputError where a shape does not fit.
    """

    joints: tuple[str, ...]
    t: Array
    reference: Array
    kp: Array
    kv: Array
    gain: Array
    saturation: Array
    feedforward: Array

    __repr__ = brief

    def __post_init__(self) -> None:
        n, rows = len(self.joints), len(self.t)
        for name in ("reference", "feedforward", "kp", "kv", "gain", "saturation"):
            array, shape = getattr(self, name), (rows, n) if name in ("reference", "feedforward") else (n,)
            if np.shape(array) != shape:
                raise InputError(f"controller: {name} has shape {np.shape(array)}, expected {shape}.")

    def __call__(self, t: float, q: Array, dq: Array) -> Array:
        """Return the torque (n) for the state at time t."""
        k = self._row(t)
        wanted = self.kv * (self.kp * (self.reference[k] - q) - dq) + self.feedforward[k]
        return np.asarray(self.gain * np.minimum(np.maximum(wanted, -self.saturation), self.saturation))

    def of_numbers(self, t: Array) -> Callable[[int, float, float], float]:
        """Return the torque of a single joint as a function of the number of an instant of t (N), of q and of dq."""
        held = self._row(t)
        references: list[float] = self.reference[held, 0].tolist()
        feedforward: list[float] = self.feedforward[held, 0].tolist()
        kp, kv, gain, limit = (float(one[0]) for one in (self.kp, self.kv, self.gain, self.saturation))

        def torque(k: int, q: float, dq: float) -> float:
            wanted = kv * (kp * (references[k] - q) - dq) + feedforward[k]
            return gain * min(max(wanted, -limit), limit)

        return torque

    def _row(self, t: Any) -> Any:
        """Return the row of the references that is held at time t."""
        return np.maximum(np.searchsorted(self.t, t + 1e-9) - 1, 0)


class Driver(StrEnum):
    """What drives the model in a free simulation: the controller, or the measured torque."""

    CONTROLLER = "controller"
    TORQUE = "torque"


@dataclass(frozen=True)
class Failure:
    """Base of the reasons for which a free simulation ends early."""


@dataclass(frozen=True)
class RunsAway(Failure):
    """The simulated position diverges ``after`` so many seconds."""

    after: float


@dataclass(frozen=True)
class Singular(Failure):
    """The mass matrix is singular."""


@dataclass(frozen=True)
class Broken(Failure):
    """The model cannot be evaluated, for a ``reason`` (the error's message)."""

    reason: str


@dataclass(frozen=True, eq=False)
class RunSignals:
    """``t`` (N) s, ``q`` (N, n) simulated and ``measured`` (N, n), rad or m, and ``tau`` (N, n) that drove the
    model.
    """

    t: Array
    q: Array
    measured: Array
    tau: Array

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class FreeRun:
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
    signals: RunSignals | None = None

    __repr__ = brief

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
    its controller an arm drifts for any model. Raises ConfigError where neither is given, InputError where the
    controller has other joints, or where too few samples are usable.
    """
    motion = model.remembering(motion)
    rows = _pieces(motion, controller, restart)
    q, tau, failure = _simulated(model, theta, motion, rows, controller)
    measured, torques, shown = motion.q[rows], motion.tau[rows], rows[:, :-1].ravel()
    error = np.full_like(q, np.inf) if failure else q - measured
    asked = {} if controller is None else _shares(motion.joints, error if failure else tau - torques, torques)
    return FreeRun(
        name=name or motion.source,
        joints=motion.joints,
        driver=Driver.TORQUE if controller is None else Driver.CONTROLLER,
        restart=None if controller is not None else restart,
        relative_error=_shares(motion.joints, error, measured),
        motion_error=_shares(motion.joints, error, measured - measured[:, :1]),
        rms=dict(zip(motion.joints, np.sqrt(np.mean(error**2, axis=(0, 1))).tolist(), strict=True)),
        torque_error=asked,
        failure=failure,
        signals=RunSignals(
            motion.t[shown],
            q[:, :-1].reshape(-1, q.shape[2]),
            motion.q[shown],
            tau[:, :-1].reshape(-1, q.shape[2]),
        ),
    )


def _pieces(motion: Motion, controller: Controller | None, restart: float | None) -> NDArray[np.intp]:
    """Return the samples (pieces, k) to simulate, of the longest run of usable ones; with a controller, one piece.

    The last sample of each piece is the first of the next.
    """
    if controller is None and restart is None:
        raise ConfigError("free simulation needs a controller, or `restart` (s) for the measured torque.")
    if controller is not None and controller.joints != motion.joints:
        raise InputError(f"{motion.source}: the controller has joints {controller.joints}, the log {motion.joints}.")
    part = max(stretches(motion.mask), key=lambda one: one.stop - one.start, default=slice(0, 0))
    if part.stop - part.start < 3:
        raise InputError(f"{motion.source}: too few usable samples in a row to simulate.")
    last, step = part.stop - part.start - 1, float(np.diff(motion.t[part]).mean())
    length = last if controller or restart is None else min(max(round(restart / step), 1), last)
    starts = np.arange(part.start, part.stop - length, length)
    return np.asarray(starts[:, None] + np.arange(length + 1))


def _simulated(
    model: Model, theta: ArrayLike, motion: Motion, rows: NDArray[np.intp], controller: Controller | None
) -> tuple[Array, Array, Failure | None]:
    """Return positions and torques (pieces, k, n), and why the simulation failed, if it did."""
    try:
        with np.errstate(all="ignore"):  # a diverging run is reported below
            q, tau = integrate(Machine(model, theta), motion, rows, controller)
    except (DynidentError, np.linalg.LinAlgError) as fault:
        failure = Broken(str(fault)) if isinstance(fault, DynidentError) else Singular()
        return np.full((*rows.shape, len(motion.joints)), np.inf), motion.tau[rows], failure
    away = not (np.abs(q) < FAR).all()
    return q, tau, RunsAway(_escape(q, motion.t[rows])) if away else None


def _shares(joints: tuple[str, ...], error: Array, whole: Array) -> dict[str, float]:
    sizes = np.linalg.norm(whole, axis=(0, 1))
    wrong = np.linalg.norm(error, axis=(0, 1))
    return {j: 100.0 * float(e / s) if s > 0 else float("nan") for j, e, s in zip(joints, wrong, sizes, strict=True)}


def _escape(q: Array, t: Array) -> float:
    piece, k, _ = np.argwhere(~(np.abs(q) < FAR))[0]
    return float(t[piece, k] - t[piece, 0])
