"""What a free simulation goes through: the steps between samples, and what is given at these."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.models.evaluation import motion_memory
from dynident.models.friction import Offset
from dynident.models.model import Model
from dynident.models.motor import RotorInertia
from dynident.models.recursion_kernel import MAX_ANGLE, CompiledRecursion
from dynident.models.rigid_bodies import RigidBodies
from dynident.motion.log import Controller, HasState, Motion
from dynident.runtime import InputError, Noun, Statement, TaggedUnion, short
from dynident.runtime.arrays import Array


class Failure(Statement, TaggedUnion):
    """Base of the reasons for which a free simulation ends early."""


class RunsAway(Failure):
    """The simulated position diverges ``after`` so many seconds."""

    after: float

    def __str__(self) -> str:
        return f"the simulated position diverges after {short(self.after)} s"


class Singular(Failure):
    """The mass matrix is singular."""

    def __str__(self) -> str:
        return "the mass matrix is singular"


class Broken(Failure):
    """The model cannot be evaluated, for a ``reason`` (the error's message)."""

    reason: str

    def __str__(self) -> str:
        return self.reason


STEP = 1e-3  # s, the longest step of the integration
# steps of a drive between two samples, and how far they may be from a whole number
MAX_DRIVE_STEPS, PERIOD_TOLERANCE = 1000, 0.02
MAX_POSITION = 1e6  # rad or m: a simulation beyond this has diverged


class Trace(Noun):
    """All S steps of B pieces of K samples: their lengths ``h`` (S), s, and the states between them.

    ``begins`` (S + 1) is the sample that a step begins with, or -1; ``q``, ``dq`` (S + 1, B, n) rad or m, and per s;
    ``tau`` (K, B, n) N m or N is applied from a sample on; ``states`` (K, m) of the controller are before it.
    """

    h: Array
    begins: NDArray[np.intp]
    q: Array
    dq: Array
    tau: Array
    states: Array

    @property
    def samples(self) -> NDArray[np.intp]:
        """The steps (K) that begin with a sample, after the last step the end."""
        return np.flatnonzero(self.begins >= 0)


def divide_steps(lengths: Array) -> tuple[Array, NDArray[np.intp]]:
    """Return the lengths h (S) of the steps between samples ``lengths`` (K - 1) s apart, and where samples are.

    The steps are equal parts of at most ``STEP``. The second array (S + 1) holds the sample that each step
    begins with, -1 for none; its last entry is that of the end.
    """
    # a length beyond a multiple of the step by rounding only must not add a part
    parts = np.maximum(np.ceil(lengths / STEP - 1e-3), 1).astype(int)
    begins = np.full(parts.sum() + 1, -1)
    begins[np.cumsum(np.append(0, parts))] = np.arange(len(lengths) + 1)
    return np.repeat(lengths / parts, parts), begins


def held_torques(motion: Motion, rows: NDArray[np.intp]) -> Array:
    """Return the torques (K, B, n) held from samples ``rows`` (B, K) on: the means of measured ones and the next."""
    tau = motion.tau[rows].swapaxes(0, 1)
    return np.concatenate((0.5 * (tau[:-1] + tau[1:]), tau[-1:]))


def sample_gaps(t: Array) -> Array:
    """Return the time (K), s, before each sample; before the first, that after it."""
    lengths = np.diff(t)
    return np.append(lengths[:1], lengths)


def drive_times(t: Array, period: float) -> Array:
    """Return times t (N), s, with those of a drive of this ``period`` (s) between them, in equal parts.

    Raises InputError where no whole number of periods, up to 1000, fits the usual step.
    """
    gaps = np.diff(t)
    # the median is not affected by missing samples
    step = float(np.median(gaps)) if len(gaps) else 0.0
    ratio = step / period if period > 0 and np.isfinite(period) else 0.0
    parts = min(max(round(ratio), 1), MAX_DRIVE_STEPS)
    if abs(ratio - parts) > PERIOD_TOLERANCE * parts:
        raise InputError(
            f"period = {period:g} s does not fit the {step:.6g} s from sample to sample; give a whole part of that, "
            f"such as {step / parts:.6g}, or leave it out."
        )
    # where samples are missing, a gap has several times the usual number of parts
    parts_per_gap = np.maximum(np.round(gaps / step), 1).astype(int) * parts
    ends = np.concatenate(([0], np.cumsum(parts_per_gap)))
    return np.asarray(np.interp(np.arange(ends[-1] + 1), ends, t))


def initial_state(controller: Controller, motion: Motion, row: NDArray[np.intp]) -> Array:
    """Return the state (m) of a controller before the samples (K) of a motion, none where it has no state."""
    if not isinstance(controller, HasState):
        return np.zeros(0)
    t, k = motion.t[row[:2]], row[0]
    return controller.begin(float(t[0]), float(t[1] - t[0]), motion.q[k], motion.dq[k], motion.tau[k])


DIFFERENCE_STEP = 1e-6  # rad or m, and per s: the step of differences, and of larger values their share


class ControllerInput(Noun):
    """What a controller sees at K samples: ``t`` s, each ``h`` s after the last (K); q, dq (K, n); its state (K, m)."""

    t: Array
    h: Array
    q: Array
    dq: Array
    state: Array

    def slopes_of(self, controller: Controller) -> ControllerSlopes:
        """Return the derivatives of a controller, by central differences where it does not know them."""
        if isinstance(controller, HasSlopes):
            return controller.slopes(self)
        n, rows = self.q.shape[1], np.hstack((self.q, self.dq, self.state))
        out = np.empty((len(rows), n + self.state.shape[1], rows.shape[1]))
        for k, (t, h, row) in enumerate(zip(self.t.tolist(), self.h.tolist(), rows, strict=True)):
            # central differences, one input after the other
            for j, value in enumerate(row.tolist()):
                step, ends = DIFFERENCE_STEP * max(abs(value), 1.0), list[Array]()
                for displacement in (step, -step):
                    displaced = row.copy()
                    displaced[j] += displacement
                    q, dq, state = np.split(displaced, [n, 2 * n])
                    if isinstance(controller, HasState):
                        ends.append(np.concatenate(controller.advance(t, h, q, dq, state)))
                    else:
                        ends.append(controller(t, q, dq))
                out[k, :, j] = (ends[0] - ends[1]) / (2 * step)
        by_tau, by_state = (np.split(part, [n, 2 * n], axis=2) for part in np.split(out, [n], axis=1))
        return ControllerSlopes((by_tau[0], by_tau[1], by_tau[2]), (by_state[0], by_state[1], by_state[2]))


class ControllerSlopes(Noun):
    """Derivatives of a controller's torque (K, n, .) and next state (K, m, .) at K samples by q, dq and the state."""

    tau: tuple[Array, Array, Array]
    state: tuple[Array, Array, Array]


@runtime_checkable
class HasSlopes(Protocol):
    """A controller that knows its derivatives."""

    def slopes(self, inputs: ControllerInput, /) -> ControllerSlopes:
        """Return the derivatives at the inputs."""


def diagonal(entries: Array) -> Array:
    """Return (K, n) as diagonal matrices (K, n, n)."""
    return np.asarray(entries[:, :, None] * np.eye(entries.shape[1]))


CONSTANT = (Offset, RotorInertia)  # terms whose mass and bias are the same at all states


class Machine:
    """The model with friction separated: M ddq + b(q, dq) + V dq + J' f = tau, abs(f_i) <= F_i, equal in sliding.

    A Coulomb parameter whose column is c sign(c'dq), or its smooth form, becomes a row c of J; friction can then hold a
    joint at rest, which sign(dq) cannot. Viscous columns c c'dq form V, which is integrated implicitly, because light
    joints with much friction would otherwise need tiny steps. Terms without any other parameter are left out of the
    model. What terms remember goes on from the middle of one step to that of the next, ``begin`` says from where;
    friction by the load has the level F of this moment. ``separated`` are the parameters of the rows of J, ``slopes``
    the parts (n, n) of V by parameter, over their values; ``model`` and ``theta`` are what is left.
    """

    def __init__(self, model: Model, theta: ArrayLike) -> None:
        remaining = np.array(theta, dtype=float)
        n = len(model.joints)
        # states that tell columns apart: unit velocities, all joints together, alternating signs; beyond smooth signs
        q = np.random.default_rng(0).uniform(0.5, 1.5, (n + 3, n))
        alternating = np.array([(-1.0) ** k * (1.5 + 0.1 * k) for k in range(n)])
        dq = 1e3 * np.vstack((np.eye(n), np.arange(1.0, n + 1), alternating, -alternating))
        Y = model.regressor(q, dq, np.zeros_like(q), np.ones((n + 3, model.memory)))
        rows, levels, self.separated = list[Array](), list[float](), list[int]()
        remembers = [term.memory > 0 for term in model.terms for _ in term.parameters]
        self.V, self.slopes = np.zeros((n, n)), dict[int, Array]()
        for k, parameter in enumerate(model.parameters):
            value, columns = remaining[k], Y[:, :, k]
            if parameter.role == "coulomb" and value > 0:
                # does the column act along one vector c, with the sign of c'dq?
                c = columns[n] * np.sign(columns[n] @ dq[n])
                if c.any() and np.allclose(columns[n + 1 :], np.outer(np.sign(dq[n + 1 :] @ c), c)):
                    rows, levels, remaining[k] = [*rows, c], [*levels, float(value)], 0.0
                    self.separated.append(k)
            if parameter.role == "viscous" and value > 0 and not remembers[k]:
                # the slope from unit velocities must explain all other states
                slope = columns[:n].T / 1e3
                if np.allclose(columns[n:], dq[n:] @ slope.T):
                    self.V, self.slopes[k], remaining[k] = self.V + value * slope, slope, 0.0
        self.J, self.F = np.array(rows).reshape(len(rows), n), np.array(levels)
        self.model, self.theta = _drop_zero_terms(model, remaining)
        self._varying, self._value, self._mass, self._bias = _split_constant_terms(self.model, self.theta)
        self._path = _MemoryTracker(model)
        # the kernel takes the steps of rigid bodies whose friction is all separated
        bodies = self._varying.terms[0]
        recursion = bodies.recursion if isinstance(bodies, RigidBodies) and len(self._varying.terms) == 1 else None
        self._compiled = recursion if isinstance(recursion, CompiledRecursion) else None

    def begin(self, motion: Motion, rows: NDArray[np.intp]) -> None:
        """Start from samples of a motion, with what it remembers there."""
        if motion.memory is not None and self.model.memory:
            self._path.begin(motion, rows)

    def mass_and_bias(self, q: Array, dq: Array) -> tuple[Array, Array]:
        """Return M (B, n, n) and b (B, n), both without the friction that is separated, for q and dq (B, n)."""
        mass, bias = self._varying.mass_and_bias(q, dq, self._value, self._path.memory)
        return mass + self._mass, bias + self._bias

    def _levels(self, q: Array) -> Array:
        """Return F (m) or, where friction depends on what is remembered, F (B, m)."""
        if self._path.memory is None:
            return self.F
        # at high speed the sign is complete, so that the column has the level of the load
        fast_dq = np.full_like(q, 1e3)
        Y = self.model.regressor(q, fast_dq, 0 * q, self._path.memory)[:, :, self.separated]
        return np.asarray(self.F * np.abs(np.einsum("bnm,mn->bm", Y, self.J)) / np.square(self.J).sum(axis=1))

    def take_steps(self, q: Array, dq: Array, ddq: Array, tau: Array, h: Array) -> None:
        """Take steps of h (S) s from the first of the states q and dq (S + 1, B, n), and of ddq (B, n), all in place.

        Raises LinAlgError where the mass matrix is singular.
        """
        if self._compiled is not None and np.abs(q[0]).max() < MAX_ANGLE:
            theta = self._compiled.layout.expand_parameters(self._value)
            others = self._mass, self._bias, self.V, self.J, self.F
            if not self._compiled.steps(q, dq, ddq, tau, h, theta, others):
                raise np.linalg.LinAlgError("Singular matrix")
            return
        for s, seconds in enumerate(h.tolist()):
            q[s + 1], dq[s + 1] = self.step(q[s], dq[s], ddq, tau, seconds)
            ddq[:] = (dq[s + 1] - dq[s]) / seconds

    def step(self, q: Array, dq: Array, ddq: Array, tau: Array, h: float) -> tuple[Array, Array]:
        """Return q, dq after h s (B, n): position by halves around one step of the velocity."""
        middle, rate = q + 0.5 * h * dq, dq + 0.5 * h * ddq
        self._path.advance(h, middle, rate, ddq)
        mass, bias = self.mass_and_bias(middle, rate)
        right_sides = np.empty((*q.shape, 1 + len(self.F)))
        right_sides[..., 0], right_sides[..., 1:] = tau - bias - dq @ self.V.T, self.J.T
        # half of the viscous torque is by the velocity after the step: implicit, or light joints would need tiny steps
        responses = np.linalg.solve(mass + 0.5 * h * self.V, right_sides)
        free = dq + h * responses[..., 0]
        if len(self.F):
            response = responses[..., 1:]
            impulse = self.impulse(free @ self.J.T, self.J @ response, h * self._levels(middle))
            free = free - (response @ impulse[..., None])[..., 0]
        return middle + 0.5 * h * free, free

    @staticmethod
    def impulse(slide: Array, W: Array, limits: Array) -> Array:
        """Return the friction impulses (B, m) that stop each sliding velocity, limited by the Coulomb friction."""
        # full friction against the sliding is right where no velocity turns round by it
        impulse = limits * np.sign(slide)
        if ((slide - (W @ impulse[..., None])[..., 0]) * impulse >= 0).all():  # all keep sliding
            return impulse
        limits = np.broadcast_to(limits, slide.shape)
        # else limits and velocities depend on each other through W: one joint after the other until the impulses stay
        for _ in range(50):  # projected Gauss-Seidel
            previous = impulse.copy()
            for i in range(slide.shape[1]):
                residual = slide[:, i] - np.einsum("bj,bj->b", W[:, i], impulse)
                impulse[:, i] = np.minimum(
                    np.maximum(impulse[:, i] + residual / W[:, i, i], -limits[:, i]), limits[:, i]
                )
            if (np.abs(impulse - previous) <= 1e-9 * limits).all():
                break
        return impulse


class _MemoryTracker:
    """What a model remembers of B simulated motions (B, m), None where it has no memory."""

    def __init__(self, model: Model) -> None:
        self._model = model
        self._last: tuple[Array, ...] = ()
        self._ahead = 0.0  # s from the last state to the end of its step
        self.memory: Array | None = None

    def begin(self, motion: Motion, rows: NDArray[np.intp]) -> None:
        """Start at samples of a motion."""
        states = motion.states(rows)
        self.memory, self._last = states["memory"], (states["q"], states["dq"], states["ddq"])

    def advance(self, h: float, *now: Array) -> None:
        """Go on to q, dq and ddq (B, n), in the middle of a step of h s."""
        if self.memory is None:
            return
        # from the middle of the last step to the middle of this one
        t = np.array([0.0, self._ahead + 0.5 * h])
        pairs = [np.stack(pair, axis=1) for pair in zip(self._last, now, strict=True)]
        motions = zip(*pairs, self.memory, strict=True)
        self.memory = np.stack([motion_memory(self._model, t, q, dq, ddq, start)[1] for q, dq, ddq, start in motions])
        self._last, self._ahead = now, 0.5 * h


def _drop_zero_terms(model: Model, theta: Array) -> tuple[Model, Array]:
    """Return the model without the terms whose parameters are all zero, if any is left, and its parameters; all of a
    model with a memory, whose friction has levels that change."""
    if model.memory:
        return model, theta
    parts = _split_parameters(model, theta)
    return _select_terms(model, parts, [k for k, part in enumerate(parts) if part.any()] or [0])


def _split_constant_terms(model: Model, theta: Array) -> tuple[Model, Array, Array, Array]:
    """Split off the terms whose mass and bias are the same at all states.

    Return the rest of the model, its parameters, and mass (n, n) and bias (n) of the terms split off: these are
    computed once in place of at each step.
    """
    n = len(model.joints)
    constant_terms = [k for k, term in enumerate(model.terms) if type(term) in CONSTANT]
    varying = [k for k in range(len(model.terms)) if k not in constant_terms]
    if model.memory or not constant_terms or not varying:
        return model, theta, np.zeros((n, n)), np.zeros(n)
    parts, zero_state = _split_parameters(model, theta), np.zeros((1, n))
    constant, value = _select_terms(model, parts, constant_terms)
    mass, bias = constant.mass_and_bias(zero_state, zero_state, value)
    return *_select_terms(model, parts, varying), mass[0], bias[0]


def _split_parameters(model: Model, theta: Array) -> list[Array]:
    """Return the parameters of each term."""
    return np.split(theta, np.cumsum([len(term.parameters) for term in model.terms])[:-1])


def _select_terms(model: Model, parts: list[Array], indices: list[int]) -> tuple[Model, Array]:
    """Return a model of some of the terms, and their parameters."""
    return Model(tuple(model.terms[k] for k in indices), model.name), np.concatenate([parts[k] for k in indices])
