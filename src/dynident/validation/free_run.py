"""Free simulation of a recording: the model is driven by the controller, or by the measured torque."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.errors import ConfigError, DynidentError, InputError, brief
from dynident.log import Controller, Motion
from dynident.models import Model
from dynident.regression import stretches

__all__ = ["Broken", "CascadePD", "Driver", "Failure", "FreeRun", "RunSignals", "RunsAway", "Singular", "free_run"]

Array = NDArray[np.float64]
STEP = 1e-3  # s, the longest step of the integration
FAR = 1e6  # rad or m: a simulation beyond this has diverged


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
        k = max(int(np.searchsorted(self.t, t + 1e-9)) - 1, 0)
        wanted = self.kv * (self.kp * (self.reference[k] - q) - dq) + self.feedforward[k]
        return np.asarray(self.gain * np.minimum(np.maximum(wanted, -self.saturation), self.saturation))


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
            q, tau = _integrate(_Machine(model, theta), motion, rows, controller)
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


class _Machine:
    """The model with friction separated: M ddq + b(q, dq) + V dq + J' f = tau, abs(f_i) <= F_i, equal in sliding.

    A Coulomb parameter whose column is c sign(c'dq), or its smooth form, becomes a row c of J; friction can then hold a
    joint at rest, which sign(dq) cannot. Viscous columns c c'dq form V, which is integrated implicitly, because light
    joints with much friction would otherwise need tiny steps.
    """

    def __init__(self, model: Model, theta: ArrayLike) -> None:
        self.model, self.theta = model, np.array(theta, dtype=float)
        n = len(model.joints)
        q = np.random.default_rng(0).uniform(0.5, 1.5, (n + 2, n))
        alternating = [(-1.0) ** k * (1 + 0.1 * k) for k in range(n)]
        dq = 1e3 * np.vstack((np.eye(n), np.arange(1.0, n + 1), alternating))
        Y = model.regressor(q, dq, np.zeros_like(q))
        rows, levels = list[Array](), list[float]()
        self.V = np.zeros((n, n))
        for k, parameter in enumerate(model.parameters):
            value, columns = self.theta[k], Y[:, :, k]
            if parameter.role == "coulomb" and value > 0:
                c = columns[n] * np.sign(columns[n] @ dq[n])
                if c.any() and np.allclose(columns[n + 1], c * np.sign(c @ dq[n + 1])):
                    rows, levels, self.theta[k] = [*rows, c], [*levels, float(value)], 0.0
            if parameter.role == "viscous" and value > 0:
                slope = columns[:n].T / 1e3
                if np.allclose(columns[n:], dq[n:] @ slope.T):
                    self.V, self.theta[k] = self.V + value * slope, 0.0
        self.J, self.F = np.array(rows).reshape(len(rows), n), np.array(levels)

    def step(self, q: Array, dq: Array, ddq: Array, tau: Array, h: float) -> tuple[Array, Array]:
        """Return q, dq after h s (B, n): position by halves around one step of the velocity (Moreau, 1988)."""
        middle = q + 0.5 * h * dq
        mass, bias = self.model.mass_and_bias(middle, dq + 0.5 * h * ddq, self.theta)
        push = tau - bias - dq @ self.V.T
        sides = np.concatenate((push[..., None], np.broadcast_to(self.J.T, (len(q), *self.J.T.shape))), axis=2)
        solved = np.linalg.solve(mass + 0.5 * h * self.V, sides)
        free, response = dq + h * solved[..., 0], solved[..., 1:]
        if len(self.F):
            free = free - (response @ self._impulse(free @ self.J.T, self.J @ response, h * self.F)[..., None])[..., 0]
        return middle + 0.5 * h * free, free

    @staticmethod
    def _impulse(slide: Array, W: Array, most: Array) -> Array:
        """Return the friction impulses (B, m) that stop each sliding velocity, limited by the Coulomb friction."""
        impulse = most * np.sign(slide)
        if ((slide - (W @ impulse[..., None])[..., 0]) * impulse >= 0).all():  # all keep sliding
            return impulse
        for _ in range(50):  # projected Gauss-Seidel
            before = impulse.copy()
            for i in range(len(most)):
                rest = slide[:, i] - np.einsum("bj,bj->b", W[:, i], impulse)
                impulse[:, i] = np.minimum(np.maximum(impulse[:, i] + rest / W[:, i, i], -most[i]), most[i])
            if (np.abs(impulse - before) <= 1e-9 * most).all():
                break
        return impulse


def _integrate(
    machine: _Machine, motion: Motion, rows: NDArray[np.int_], controller: Controller | None
) -> tuple[Array, Array]:
    """Return the simulated q and the applied tau (B, K, n) at the samples ``rows`` (B, K) of the motion."""
    t = motion.t[rows]
    q, dq = motion.q[rows[:, 0]], motion.dq[rows[:, 0]]
    ddq, before = np.zeros_like(q), q - dq * (t[:, 1] - t[:, 0])[:, None]
    path, applied = np.full((*rows.shape, q.shape[1]), np.inf), np.empty((*rows.shape, q.shape[1]))
    for k in range(rows.shape[1]):
        path[:, k] = q
        last = k + 1 == rows.shape[1]
        if controller is None:
            tau = motion.tau[rows[:, k]] if last else 0.5 * (motion.tau[rows[:, k]] + motion.tau[rows[:, k + 1]])
        else:
            h = t[0, k] - t[0, k - 1] if k else t[0, 1] - t[0, 0]
            tau = controller(float(t[0, k]), q[0], (q[0] - before[0]) / h)[None]
        applied[:, k] = tau
        if last or not (np.abs(q) < FAR).all():
            break
        before, step = q, float((t[:, k + 1] - t[:, k]).mean())
        parts = max(int(np.ceil(step / STEP - 1e-3)), 1)
        for _ in range(parts):
            slower = dq
            q, dq = machine.step(q, dq, ddq, tau, step / parts)
            ddq = (dq - slower) * parts / step
    return path, applied
