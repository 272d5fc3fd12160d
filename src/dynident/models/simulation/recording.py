"""Simulated motion of a model, and its recording with measurement noise: article, eqs. (41)-(46)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from dynident.models.evaluation import motion_memory
from dynident.models.model import Model
from dynident.motion.log import Log, Motion
from dynident.runtime import ConfigError, InputError, ModelError, Noun
from dynident.runtime.arrays import Array, as_numbers

Torque = Callable[[float], ArrayLike]
DIFFERENCE_STEP = 1e-7  # s, over which a memory is differentiated by time
MIN_MEMORY_TOLERANCE = 1e-9  # least tolerance with a memory, whose derivatives are rounded to this
MAX_ROUNDS, ACCELERATION_TOLERANCE = 30, 1e-10  # of accelerations that friction by the load depends on, until they stay


class Recording(Noun):
    """A log with simulated noise, its exact motion, and the standard deviations (n) of the noise by joint."""

    log: Log
    truth: Motion
    sigma_q: Array
    sigma_tau: Array


def simulate(
    model: Model,
    theta: ArrayLike,
    torque: Torque,
    t: ArrayLike,
    q0: ArrayLike | None = None,
    dq0: ArrayLike | None = None,
    *,
    tolerance: float = 1e-12,
    max_evaluations: int = 300_000,
    source: str = "simulation",
) -> Motion:
    """Integrate the state space model (article, eqs. 41-43) and return its motion at the instants t.

    ``theta`` (p); ``torque`` is a function of the time (s) that returns (n) N m or N; ``t`` (N) s, strictly
    increasing; ``q0``, ``dq0`` (n) at t[0] default to zero. ``tolerance`` is the relative and absolute error per step
    of the integrator (LSODA, for stiff friction), in rad or m: with the default, 10 s of each model of the gallery are
    accurate to 1e-9. In the motion, ddq is the exact forward dynamics and tau the torque applied. What the model
    remembers is integrated too, from nothing before t[0], with a tolerance of at least 1e-9. Raises InputError for
    wrong times, initial values or torques, ConfigError for a wrong tolerance, and ModelError where the model or the
    integration fails, or needs more than ``max_evaluations`` of the model.

    A pendulum released at a small angle returns after its period, 2 pi sqrt(J / (h g)):

    >>> import numpy as np
    >>> from dynident.models.lagrangian import pendulum
    >>> model = pendulum()
    >>> period = 2 * np.pi * np.sqrt(0.0825 / (0.25 * 9.81))
    >>> motion = simulate(model, model.values, lambda t: [0.0], [0.0, period / 2, period], q0=[0.01])
    >>> motion.q[:, 0].tolist()
    [0.01000, -0.01000, 0.01000]
    """
    single = {"theta": theta, "q0": q0, "dq0": dq0, "torque": torque(_times(t, source)[0])}
    for name, value in single.items():
        if value is not None and np.ndim(value) > 1:
            raise InputError(
                f"{source}: {name} has shape {np.shape(value)}; for several runs at once use simulate_many."
            )
    return simulate_many(
        model, theta, torque, t, q0, dq0, tolerance=tolerance, max_evaluations=max_evaluations, source=source
    )[0]


def simulate_many(
    model: Model,
    theta: ArrayLike,
    torque: Torque,
    t: ArrayLike,
    q0: ArrayLike | None = None,
    dq0: ArrayLike | None = None,
    *,
    tolerance: float = 1e-12,
    max_evaluations: int = 300_000,
    source: str = "simulation",
) -> tuple[Motion, ...]:
    """Integrate B runs together and return their motions; much faster than B calls of ``simulate``.

    As ``simulate``, but ``theta`` may be (B, p), ``q0`` and ``dq0`` (B, n), and ``torque`` may return (B, n); a value
    given once applies to all runs. All runs share the steps of the integrator; the tolerance is divided by sqrt(B),
    because its error norm is a mean over the runs.
    """
    times, n, p = _times(t, source), len(model.joints), len(model.parameters)
    arguments = {
        "theta": (as_numbers(theta), p),
        "q0": (np.zeros(n) if q0 is None else as_numbers(q0), n),
        "dq0": (np.zeros(n) if dq0 is None else as_numbers(dq0), n),
        "torque": (as_numbers(torque(times[0])), n),
    }
    runs = _count_runs(arguments, source)
    parameters, q, dq, _ = (np.broadcast_to(array, (runs, width)) for array, width in arguments.values())
    system = _System(model, parameters, torque, max_evaluations, source)
    zero_ddq = np.zeros((1, n))
    memories = [
        motion_memory(model, times[:1], *state, zero_ddq)[0] for state in zip(q[:, None], dq[:, None], strict=True)
    ]
    # the rates of a memory are differences: a smaller tolerance than their rounding is never reached
    step_tolerance = max(tolerance, MIN_MEMORY_TOLERANCE) if model.memory else tolerance
    states = _integrate(system, np.hstack([q, dq, np.array(memories)]), times, step_tolerance)
    return tuple(_make_motions(system, states, times))


def record(
    truth: Motion, sigma_q: ArrayLike, sigma_tau: ArrayLike, rng: np.random.Generator, source: str | None = None
) -> Recording:
    """Add measurement noise to positions and torques: article, eqs. (44)-(46).

    ``sigma_q`` (rad or m) and ``sigma_tau`` (N m or N) are standard deviations, one number or one per joint; the
    noise is normal and independent. Positions are drawn first. ``source`` defaults to that of the motion.
    Raises ConfigError for a negative or not finite deviation, or a wrong number of them.

    >>> import numpy as np
    >>> from dynident.models.lagrangian import pendulum
    >>> model, rng = pendulum(), np.random.default_rng(0)
    >>> motion = simulate(model, model.values, lambda t: [np.sin(5.0 * t)], np.linspace(0.0, 2.0, 401))
    >>> log = record(motion, sigma_q=1e-4, sigma_tau=0.01, rng=rng).log
    >>> log.q.shape, log.joints
    ((401, 1), ('pivot',))
    >>> print(f"{np.std(log.q - motion.q):.1e} rad, {np.std(log.tau - motion.tau):.3f} N m")
    9.9e-05 rad, 0.010 N m
    """
    deviations = _deviation("sigma_q", sigma_q, truth), _deviation("sigma_tau", sigma_tau, truth)
    q, tau = (x + s * rng.standard_normal(x.shape) for x, s in zip((truth.q, truth.tau), deviations, strict=True))
    name = truth.source if source is None else source
    return Recording(Log(t=truth.t, q=q, tau=tau, joints=truth.joints, source=name), truth, *deviations)


def _deviation(name: str, sigma: ArrayLike, truth: Motion) -> Array:
    deviation = as_numbers(sigma)
    if deviation.shape not in ((), (len(truth.joints),)):
        raise ConfigError(f"{name} has shape {deviation.shape}; give one number, or one per joint: {truth.joints}.")
    if not ((deviation >= 0) & (deviation < np.inf)).all():
        raise ConfigError(f"{name} is {deviation.tolist()}; a standard deviation is 0 or more, and finite.")
    return np.broadcast_to(deviation, (len(truth.joints),)).copy()


@dataclass(eq=False)
class _System:
    """The runs as one system of first order, state (B, 2 n + m), of q, dq and memory; counts its evaluations."""

    model: Model
    theta: Array
    torque: Torque
    limit: int
    source: str
    count: int = 0

    def applied_torque(self, t: float) -> Array:
        """Return the torques (B, n) at time t; InputError where they do not fit."""
        tau, shape = np.asarray(self.torque(t), dtype=float), (len(self.theta), len(self.model.joints))
        if tau.shape not in (shape, shape[1:]) or not np.isfinite(tau).all():
            raise InputError(
                f"{self.source}: the torque at t = {t} s is {tau.tolist()}; it must be finite, of shape {shape[1:]} "
                f"or {shape}."
            )
        return np.broadcast_to(tau, shape)

    def slope(self, t: float, flat: Array) -> Array:
        """Return the time derivative of the flattened state: article, eq. (42)."""
        self.count += 1
        if self.count > self.limit:
            raise ModelError(
                f"{self.source}: {self.limit} evaluations of {self.model.name} reached only t = {t} s; discontinuous "
                "friction needs a smooth sign (the field 'width' of Coulomb), stiff parameters a larger "
                "max_evaluations."
            )
        q, dq, start_memory = _split_states(flat.reshape(len(self.theta), -1), len(self.model.joints))
        times = np.full(len(q), t)
        ddq, memory = self.accelerations(times, q, dq, self.applied_torque(t), self.theta, start_memory)
        if memory is None:
            return np.concatenate([dq, ddq], axis=1).ravel()
        # a memory goes on in time only: its derivative by forward differences, of second order
        now, after_one, after_two = np.moveaxis(
            self._extrapolate_memory(times, q, dq, ddq, start_memory, DIFFERENCE_STEP * np.arange(3.0)), 1, 0
        )
        rates = (4 * after_one - after_two - 3 * now) / (2 * DIFFERENCE_STEP)
        return np.concatenate([dq, ddq, rates], axis=1).ravel()

    def accelerations(
        self, t: Array, q: Array, dq: Array, tau: Array, theta: Array, start_memory: Array
    ) -> tuple[Array, Array | None]:
        """Return ddq (K, n) and the memory (K, m) that goes with it.

        ``start_memory`` (K, m) is what is remembered of the motion before.
        """
        if not self.model.memory:
            return self.model.forward_dynamics(q, dq, tau, theta), None
        ddq = np.zeros_like(q)
        # friction by the load depends on ddq, which depends on it: iterate until the acceleration stays
        for _ in range(MAX_ROUNDS if self.model.needs_load else 1):
            previous, memory = ddq, self._extrapolate_memory(t, q, dq, ddq, start_memory, np.zeros(1))[:, 0]
            ddq = self.model.forward_dynamics(q, dq, tau, theta, memory)
            if np.abs(ddq - previous).max(initial=0.0) <= ACCELERATION_TOLERANCE * np.abs(ddq).max(initial=0.0):
                break
        return ddq, memory

    def _extrapolate_memory(self, t: Array, q: Array, dq: Array, ddq: Array, start_memory: Array, s: Array) -> Array:
        """Return the memory (K, k, m) after the times s (k), s, of motion at constant acceleration."""
        memories = []
        for t0, x, v, a, start in zip(t, q, dq, ddq, start_memory, strict=True):
            positions = x + np.outer(s, v) + np.outer(0.5 * s**2, a)
            velocities, accelerations = v + np.outer(s, a), np.tile(a, (len(s), 1))
            memories.append(motion_memory(self.model, t0 + s, positions, velocities, accelerations, start))
        return np.array(memories)


def _integrate(system: _System, start: Array, t: Array, tolerance: float) -> Array:
    """Return the states (N, B, 2 n) at the instants t."""
    from scipy.integrate import solve_ivp

    if not 1e-13 <= tolerance < 1:
        raise ConfigError(f"{system.source}: tolerance is {tolerance}; give a number from 1e-13 to below 1.")
    # LSODA takes the root mean square over all runs: one of them alone may have sqrt(B) times the error
    step_tolerance = max(tolerance / np.sqrt(len(start)), 100 * np.finfo(float).eps)
    # the runs do not depend on each other; for one alone LSODA takes many more steps if given a band
    band = start.shape[1] - 1 if len(start) > 1 else None
    with np.errstate(over="ignore", invalid="ignore"):  # a diverging run is reported below
        settings = {"rtol": step_tolerance, "atol": step_tolerance, "lband": band, "uband": band}
        solution = solve_ivp(system.slope, (t[0], t[-1]), start.ravel(), method="LSODA", t_eval=t, **settings)
    if not solution.success:
        reached = solution.t[-1] if len(solution.t) else t[0]
        raise ModelError(
            f"{system.source}: the integration of {system.model.name} stopped after t = {reached} s of {t[-1]} s with "
            f"status {solution.status}: {solution.message} Check that theta is physical (Model.check_mass_matrix) and "
            "that torque and friction are smooth."
        )
    states: Array = solution.y.T.reshape(len(t), len(start), -1)
    return states


def _make_motions(system: _System, states: Array, t: Array) -> list[Motion]:
    tau = np.array([system.applied_torque(instant) for instant in t])
    joints, smoothing = tuple(joint.name for joint in system.model.joints), {"method": "exact", "integrator": "LSODA"}
    motions = []
    for k, theta in enumerate(system.theta):
        q, dq, start_memory = _split_states(states[:, k], len(system.model.joints))
        ddq, memory = system.accelerations(t, q, dq, tau[:, k], theta, start_memory)
        states_and_torque, usable = (t, q, dq, ddq, tau[:, k]), np.ones(len(t), dtype=bool)
        motions.append(Motion(*states_and_torque, joints, usable, system.source, smoothing, memory=memory))
    return motions


def _split_states(states: Array, n: int) -> tuple[Array, Array, Array]:
    """Return positions, velocities and memory of states (..., 2 n + m)."""
    return states[..., :n], states[..., n : 2 * n], states[..., 2 * n :]


def _times(t: ArrayLike, source: str) -> Array:
    times = as_numbers(t)
    if times.ndim != 1 or len(times) < 2 or not np.isfinite(times).all() or not (np.diff(times) > 0).all():
        times_text = np.array2string(times, threshold=6)
        raise InputError(f"{source}: t must be at least 2 finite, strictly increasing times (s), got {times_text}.")
    return times


def _count_runs(arguments: dict[str, tuple[Array, int]], source: str) -> int:
    """Return the number of runs; InputError where a shape does not fit or a value is not finite."""
    for name, (array, width) in arguments.items():
        if array.ndim not in (1, 2) or array.shape[-1] != width or not array.size:
            raise InputError(f"{source}: {name} has shape {array.shape}, expected ({width},) or (runs, {width}).")
        if not np.isfinite(array).all():
            raise InputError(f"{source}: {name} holds a value that is not finite: {array.tolist()}.")
    counts = {name: len(array) for name, (array, _) in arguments.items() if array.ndim == 2}
    if len(set(counts.values())) > 1:
        raise InputError(f"{source}: the numbers of runs differ: {counts}; give each quantity once or once per run.")
    return next(iter(counts.values()), 1)
