"""A model as a free simulation has it: friction that can hold a joint apart, and what its terms remember."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.log import Motion
from dynident.models import HasMemory, Model, Offset, RotorInertia, remembered

__all__ = ["Machine"]

Array = NDArray[np.float64]
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
        left = np.array(theta, dtype=float)
        n = len(model.joints)
        q = np.random.default_rng(0).uniform(0.5, 1.5, (n + 3, n))
        alternating = np.array([(-1.0) ** k * (1.5 + 0.1 * k) for k in range(n)])
        dq = 1e3 * np.vstack((np.eye(n), np.arange(1.0, n + 1), alternating, -alternating))
        Y = model.regressor(q, dq, np.zeros_like(q), np.ones((n + 3, model.memory)))
        rows, levels, self.separated = list[Array](), list[float](), list[int]()
        remembers = [isinstance(term, HasMemory) for term in model.terms for _ in term.parameters]
        self.V, self.slopes = np.zeros((n, n)), dict[int, Array]()
        for k, parameter in enumerate(model.parameters):
            value, columns = left[k], Y[:, :, k]
            if parameter.role == "coulomb" and value > 0:
                c = columns[n] * np.sign(columns[n] @ dq[n])
                if c.any() and np.allclose(columns[n + 1 :], np.outer(np.sign(dq[n + 1 :] @ c), c)):
                    rows, levels, left[k] = [*rows, c], [*levels, float(value)], 0.0
                    self.separated.append(k)
            if parameter.role == "viscous" and value > 0 and not remembers[k]:
                slope = columns[:n].T / 1e3
                if np.allclose(columns[n:], dq[n:] @ slope.T):
                    self.V, self.slopes[k], left[k] = self.V + value * slope, slope, 0.0
        self.J, self.F = np.array(rows).reshape(len(rows), n), np.array(levels)
        self.model, self.theta = _without_zeros(model, left)
        self._varying, self._value, self._mass, self._bias = _without_constants(self.model, self.theta)
        self._path = _Path(model)

    def begin(self, motion: Motion, rows: NDArray[np.intp]) -> None:
        """Start from samples of a motion, with what it remembers there."""
        if motion.memory is not None and self.model.memory:
            self._path.begin(motion, rows)

    @property
    def remembers(self) -> bool:
        """Whether the model does."""
        return bool(self.model.memory)

    def mass_and_bias(self, q: Array, dq: Array) -> tuple[Array, Array]:
        """Return M (B, n, n) and b (B, n), both without the friction that is separated, for q and dq (B, n)."""
        mass, bias = self._varying.mass_and_bias(q, dq, self._value, self._path.memory)
        return mass + self._mass, bias + self._bias

    def _levels(self, q: Array) -> Array:
        """Return F (m) or, where friction depends on what is remembered, F (B, m)."""
        if self._path.memory is None:
            return self.F
        fast = np.full_like(q, 1e3)
        Y = self.model.regressor(q, fast, 0 * q, self._path.memory)[:, :, self.separated]
        return np.asarray(self.F * np.abs(np.einsum("bnm,mn->bm", Y, self.J)) / np.square(self.J).sum(axis=1))

    def step(self, q: Array, dq: Array, ddq: Array, tau: Array, h: float) -> tuple[Array, Array]:
        """Return q, dq after h s (B, n): position by halves around one step of the velocity."""
        middle, rate = q + 0.5 * h * dq, dq + 0.5 * h * ddq
        self._path.go_on(h, middle, rate, ddq)
        mass, bias = self.mass_and_bias(middle, rate)
        sides = np.empty((*q.shape, 1 + len(self.F)))
        sides[..., 0], sides[..., 1:] = tau - bias - dq @ self.V.T, self.J.T
        solved = np.linalg.solve(mass + 0.5 * h * self.V, sides)
        free = dq + h * solved[..., 0]
        if len(self.F):
            response = solved[..., 1:]
            impulse = self.impulse(free @ self.J.T, self.J @ response, h * self._levels(middle))
            free = free - (response @ impulse[..., None])[..., 0]
        return middle + 0.5 * h * free, free

    @staticmethod
    def impulse(slide: Array, W: Array, most: Array) -> Array:
        """Return the friction impulses (B, m) that stop each sliding velocity, limited by the Coulomb friction."""
        impulse = most * np.sign(slide)
        if ((slide - (W @ impulse[..., None])[..., 0]) * impulse >= 0).all():  # all keep sliding
            return impulse
        most = np.broadcast_to(most, slide.shape)
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
    parts = _parts(model, theta)
    return _some(model, parts, [k for k, part in enumerate(parts) if part.any()] or [0])


def _without_constants(model: Model, theta: Array) -> tuple[Model, Array, Array, Array]:
    """Return what is left of a model without the terms that are the same at all states, its parameters, and mass
    (n, n) and bias (n) of these terms: they are computed once in place of at each step."""
    n = len(model.joints)
    same = [k for k, term in enumerate(model.terms) if type(term) in CONSTANT]
    varying = [k for k in range(len(model.terms)) if k not in same]
    if model.memory or not same or not varying:
        return model, theta, np.zeros((n, n)), np.zeros(n)
    parts, rest = _parts(model, theta), np.zeros((1, n))
    constant, value = _some(model, parts, same)
    mass, bias = constant.mass_and_bias(rest, rest, value)
    return *_some(model, parts, varying), mass[0], bias[0]


def _parts(model: Model, theta: Array) -> list[Array]:
    """Return the parameters of each term."""
    return np.split(theta, np.cumsum([len(term.parameters) for term in model.terms])[:-1])


def _some(model: Model, parts: list[Array], kept: list[int]) -> tuple[Model, Array]:
    """Return a model of some of the terms, and their parameters."""
    return Model(tuple(model.terms[k] for k in kept), model.name), np.concatenate([parts[k] for k in kept])
