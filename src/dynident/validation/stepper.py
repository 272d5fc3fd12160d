"""The steps of a free simulation: the midpoint rule, with friction that can hold a joint at rest (Moreau, 1988)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.errors import DynidentError
from dynident.log import Controller, Motion
from dynident.models import HasMemory, Model, remembered

__all__ = ["FAR", "STEP", "Machine", "integrate"]

Array = NDArray[np.float64]
STEP = 1e-3  # s, the longest step of the integration
FAR = 1e6  # rad or m: a simulation beyond this has diverged
_State = tuple[float, float, float, float, float]  # q, dq, ddq, q at the last sample, tau
AHEAD = 1024  # steps that are taken at most before the model is asked whether it has not changed


@runtime_checkable
class OfNumbers(Protocol):
    """A controller that works with plain numbers for a single joint, where arrays of one element would be slow."""

    def of_numbers(self, t: Array, /) -> Callable[[int, float, float], float]:
        """Return the torque as a function of the number of an instant of t (N), of q and of dq."""


class Machine:
    """The model with friction separated: M ddq + b(q, dq) + V dq + J' f = tau, abs(f_i) <= F_i, equal in sliding.

    A Coulomb parameter whose column is c sign(c'dq), or its smooth form, becomes a row c of J; friction can then hold a
    joint at rest, which sign(dq) cannot. Viscous columns c c'dq form V, which is integrated implicitly, because light
    joints with much friction would otherwise need tiny steps. Terms without any other parameter are left out of the
    model. What terms remember goes on from the middle of one step to that of the next, ``begin`` says from where;
    friction by the load has the level F of this moment.
    """

    def __init__(self, model: Model, theta: ArrayLike) -> None:
        left = np.array(theta, dtype=float)
        n = len(model.joints)
        q = np.random.default_rng(0).uniform(0.5, 1.5, (n + 3, n))
        alternating = np.array([(-1.0) ** k * (1.5 + 0.1 * k) for k in range(n)])
        dq = 1e3 * np.vstack((np.eye(n), np.arange(1.0, n + 1), alternating, -alternating))
        Y = model.regressor(q, dq, np.zeros_like(q), np.ones((n + 3, model.memory)))
        rows, levels, separated = list[Array](), list[float](), list[int]()
        remembers = [isinstance(term, HasMemory) for term in model.terms for _ in term.parameters]
        self.V = np.zeros((n, n))
        for k, parameter in enumerate(model.parameters):
            value, columns = left[k], Y[:, :, k]
            if parameter.role == "coulomb" and value > 0:
                c = columns[n] * np.sign(columns[n] @ dq[n])
                if c.any() and np.allclose(columns[n + 1 :], np.outer(np.sign(dq[n + 1 :] @ c), c)):
                    rows, levels, left[k] = [*rows, c], [*levels, float(value)], 0.0
                    separated.append(k)
            if parameter.role == "viscous" and value > 0 and not remembers[k]:
                slope = columns[:n].T / 1e3
                if np.allclose(columns[n:], dq[n:] @ slope.T):
                    self.V, left[k] = self.V + value * slope, 0.0
        self.J, self.F = np.array(rows).reshape(len(rows), n), np.array(levels)
        self._model, self._theta = _without_zeros(model, left)
        self._separated, self._path = separated, _Path(model)

    def begin(self, motion: Motion, rows: NDArray[np.intp]) -> None:
        """Start from samples of a motion, with what it remembers there."""
        if motion.memory is not None and self._model.memory:
            self._path.begin(motion, rows)

    @property
    def remembers(self) -> bool:
        """Whether the model does."""
        return bool(self._model.memory)

    def mass_and_bias(self, q: Array, dq: Array) -> tuple[Array, Array]:
        """Return M (B, n, n) and b (B, n), both without the friction that is separated, for q and dq (B, n)."""
        return self._model.mass_and_bias(q, dq, self._theta, self._path.memory)

    def _levels(self, q: Array) -> Array:
        """Return F (m) or, where friction depends on what is remembered, F (B, m)."""
        if self._path.memory is None:
            return self.F
        fast = np.full_like(q, 1e3)
        Y = self._model.regressor(q, fast, 0 * q, self._path.memory)[:, :, self._separated]
        return np.asarray(self.F * np.abs(np.einsum("bnm,mn->bm", Y, self.J)) / np.square(self.J).sum(axis=1))

    def step(self, q: Array, dq: Array, ddq: Array, tau: Array, h: float) -> tuple[Array, Array]:
        """Return q, dq after h s (B, n): position by halves around one step of the velocity."""
        middle, rate = q + 0.5 * h * dq, dq + 0.5 * h * ddq
        self._path.go_on(h, middle, rate, ddq)
        mass, bias = self.mass_and_bias(middle, rate)
        push = tau - bias - dq @ self.V.T
        sides = np.concatenate((push[..., None], np.broadcast_to(self.J.T, (len(q), *self.J.T.shape))), axis=2)
        solved = np.linalg.solve(mass + 0.5 * h * self.V, sides)
        free, response = dq + h * solved[..., 0], solved[..., 1:]
        if len(self.F):
            impulse = self._impulse(free @ self.J.T, self.J @ response, h * self._levels(middle))
            free = free - (response @ impulse[..., None])[..., 0]
        return middle + 0.5 * h * free, free

    @staticmethod
    def _impulse(slide: Array, W: Array, most: Array) -> Array:
        """Return the friction impulses (B, m) that stop each sliding velocity, limited by the Coulomb friction."""
        most = np.broadcast_to(most, slide.shape)
        impulse = most * np.sign(slide)
        if ((slide - (W @ impulse[..., None])[..., 0]) * impulse >= 0).all():  # all keep sliding
            return impulse
        for _ in range(50):  # projected Gauss-Seidel
            before = impulse.copy()
            for i in range(slide.shape[1]):
                rest = slide[:, i] - np.einsum("bj,bj->b", W[:, i], impulse)
                impulse[:, i] = np.minimum(np.maximum(impulse[:, i] + rest / W[:, i, i], -most[:, i]), most[:, i])
            if (np.abs(impulse - before) <= 1e-9 * most).all():
                break
        return impulse


class _Path:
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

    def go_on(self, h: float, *now: Array) -> None:
        """Go on to q, dq and ddq (B, n), in the middle of a step of h s."""
        if self.memory is None:
            return
        t = np.array([0.0, self._ahead + 0.5 * h])
        pairs = [np.stack(pair, axis=1) for pair in zip(self._last, now, strict=True)]
        ways = zip(*pairs, self.memory, strict=True)
        self.memory = np.stack([remembered(self._model, t, q, dq, ddq, start)[1] for q, dq, ddq, start in ways])
        self._last, self._ahead = now, 0.5 * h


def _without_zeros(model: Model, theta: Array) -> tuple[Model, Array]:
    """Return the model without the terms whose parameters are all zero, if any is left, and its parameters; all of a
    model with a memory, whose friction has levels that change."""
    if model.memory:
        return model, theta
    ends = np.cumsum([len(term.parameters) for term in model.terms])
    parts = np.split(theta, ends[:-1])
    kept = [k for k, part in enumerate(parts) if part.any()] or [0]
    return Model(tuple(model.terms[k] for k in kept), model.name), np.concatenate([parts[k] for k in kept])


def integrate(
    machine: Machine, motion: Motion, rows: NDArray[np.intp], controller: Controller | None
) -> tuple[Array, Array]:
    """Return the simulated q and the applied tau (B, K, n) at the samples ``rows`` (B, K) of the motion."""
    machine.begin(motion, rows[:, 0])
    if len(rows) == len(motion.joints) == 1 and not machine.remembers:
        return _OneJoint(machine, motion, rows[0], controller).run()
    return _arrays(machine, motion, rows, controller)


def _arrays(
    machine: Machine, motion: Motion, rows: NDArray[np.intp], controller: Controller | None
) -> tuple[Array, Array]:
    """Return what ``integrate`` does, for any number of joints and pieces."""
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


class _OneJoint:
    """The same steps to rounding, for one joint and one piece, in plain numbers: arrays of one take ten times as long.

    Mass and bias are taken to stay as they are for some steps, then the model is asked at all of these at once. The
    steps before the first where it says otherwise are those of a model asked at each, and stay. The number of steps
    doubles as long as nothing changes, as on a level rail; it is one again where something does.
    """

    def __init__(self, machine: Machine, motion: Motion, row: NDArray[np.intp], controller: Controller | None) -> None:
        t, tau = motion.t[row], motion.tau[row, 0]
        lengths = np.diff(t)
        parts = np.maximum(np.ceil(lengths / STEP - 1e-3), 1).astype(int)
        begins = np.full(parts.sum() + 1, -1)
        begins[np.cumsum(np.append(0, parts))] = np.arange(len(t))
        self.begins: list[int] = begins.tolist()  # by step: the sample that it begins with, or -1
        self.h: list[float] = np.repeat(lengths / parts, parts).tolist()  # of the steps, s
        self.gaps: list[float] = [float(lengths[0]), *lengths.tolist()]  # before each sample, s
        self.held: list[float] = [*(0.5 * (tau[:-1] + tau[1:])).tolist(), float(tau[-1])]
        self.drive = None if controller is None else _of_numbers(controller, t)
        self.path, self.applied = [np.inf] * len(t), [np.nan] * len(t)
        self.machine, self.V = machine, float(machine.V[0, 0])
        self.friction = float(np.abs(machine.J[:, 0]) @ machine.F)  # N m or N
        q, dq = float(motion.q[row[0], 0]), float(motion.dq[row[0], 0])
        self.start: _State = (q, dq, 0.0, q - dq * self.gaps[0], 0.0)

    def run(self) -> tuple[Array, Array]:
        """Return q and tau (1, K, 1)."""
        s, state, ahead = 0, self.start, 1
        known = self._asked(s, [state])[0]
        while not self._over(s, state):
            states = self._ahead(s, state, ahead, *known)
            ends = self._over(s + len(states), states[-1])  # there, no model is needed
            asked = self._asked(s + 1, states[: len(states) - ends])
            if ends and len(asked) == len(states) - 1:
                asked.append(known)
            last = next((i for i, one in enumerate(asked) if one != known), len(asked) - 1)
            same = asked[last] == known and len(asked) == len(states)
            s, state, known, ahead = s + last + 1, states[last], asked[last], min(2 * ahead, AHEAD) if same else 1
        k = self.begins[s]
        self._torque(k, state[0], state[3])
        self.path[k + 1 :] = [np.inf] * (len(self.path) - k - 1)  # what was tried beyond
        return np.reshape(self.path, (1, -1, 1)), np.reshape(self.applied, (1, -1, 1))

    def _over(self, s: int, state: _State) -> bool:
        """Whether the run ends before step s: after the last one, or at a sample that is too far away."""
        return s == len(self.h) or (self.begins[s] >= 0 and not abs(state[0]) < FAR)

    def _ahead(self, s: int, state: _State, count: int, mass: float, bias: float) -> list[_State]:
        """Return the states after each of ``count`` steps from the step s on, of fewer where the run ends."""
        states = list[_State]()
        q, dq, ddq, before, tau = state
        for i in range(s, min(s + count, len(self.h))):
            if (k := self.begins[i]) >= 0:
                if not abs(q) < FAR:
                    break
                tau, before = self._torque(k, q, before), q
            h = self.h[i]
            whole = mass + 0.5 * h * self.V
            if not whole:
                raise np.linalg.LinAlgError("Singular matrix")
            free = dq + h * (tau - bias - self.V * dq) / whole
            brake = h * self.friction / whole  # by which friction can change the velocity
            free = 0.0 if abs(free) <= brake else free - brake if free > 0 else free + brake
            q, dq, ddq = q + 0.5 * h * (dq + free), free, (free - dq) / h
            states.append((q, dq, ddq, before, tau))
        return states

    def _torque(self, k: int, q: float, before: float) -> float:
        """Return the torque from sample k on, at the position q, which was ``before`` at the last one; keep both."""
        tau = self.held[k] if self.drive is None else self.drive(k, q, (q - before) / self.gaps[k])
        self.path[k], self.applied[k] = q, tau
        return tau

    def _asked(self, s: int, states: list[_State]) -> list[tuple[float, float]]:
        """Return mass and bias in the middle of the steps s, s + 1, ... that begin with the states.

        Only those of the first where the model fails: a wrong guess may lead to where it has no value.
        """
        if not states:
            return []
        q, dq, ddq = np.array([state[:3] for state in states]).T
        half = 0.5 * np.array(self.h[s : s + len(states)])
        try:
            mass, bias = self.machine.mass_and_bias((q + half * dq)[:, None], (dq + half * ddq)[:, None])
        except DynidentError:
            if len(states) == 1:
                raise
            return self._asked(s, states[:1])
        return list(zip(mass[:, 0, 0].tolist(), bias[:, 0].tolist(), strict=True))


def _of_numbers(controller: Controller, t: Array) -> Callable[[int, float, float], float]:
    if isinstance(controller, OfNumbers):
        return controller.of_numbers(t)
    return lambda k, q, dq: float(controller(float(t[k]), np.array([q]), np.array([dq]))[0])
