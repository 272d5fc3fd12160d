"""Newton's method on eq. (7): the trajectory eliminated by its band, the parameters kept inside of what physics allows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ModelError
from dynident.likelihood.arrow import Arrow
from dynident.likelihood.barrier import Barrier
from dynident.likelihood.segment import Equations, Segment, State
from dynident.model import Model

__all__ = ["Fitted", "Settings", "maximise"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Settings:
    """When to stop: the expected fall of the cost (half squared standard deviations), and the number of steps."""

    tolerance: float = 1e-4
    iterations: int = 60


@dataclass(frozen=True, eq=False)
class Fitted:
    """What Newton's method ended at; ``information`` (p, p) of theta with all else profiled out."""

    theta: Array
    states: tuple[State, ...]
    information: Array
    observed: Array
    cost: float
    decrement: float
    iterations: int
    converged: bool


@dataclass(frozen=True, eq=False)
class _Step:
    dC: list[Array]
    dW: list[Array]
    dtheta: Array
    decrement: float
    information: Array
    observed: Array
    newton: bool


def _schur(one: Equations, bordered: Array, k: int) -> tuple[Array, Array, Array, Array]:
    """Eliminate a segment's trajectory, then its torque knots.

    Returns the information (p, p) and gradient (p) that it leaves for theta, and the maps back: d(C, W) = a - A dtheta.
    """
    arrow = Arrow(one.band, np.concatenate([bordered, one.by_C[:, None]], axis=1))
    turned = arrow.turned
    S = one.corner - bordered.T @ turned[:, :-1]
    g = one.by_border - bordered.T @ turned[:, -1]
    S = (S + S.T) / 2
    if k:
        inner = np.linalg.solve(S[:k, :k], np.concatenate([S[:k, k:], g[:k, None]], axis=1))
    else:
        inner = np.zeros((0, S.shape[0] + 1))
    information = S[k:, k:] - S[k:, :k] @ inner[:, :-1]
    gradient = g[k:] - S[k:, :k] @ inner[:, -1]
    by_theta = turned[:, k:-1] - turned[:, :k] @ inner[:, :-1]
    free = turned[:, -1] - turned[:, :k] @ inner[:, -1]
    constant = np.concatenate([free, inner[:, -1]])
    slope = np.concatenate([by_theta, inner[:, :-1]])
    decrement = float(one.by_C @ free + one.by_border[:k] @ inner[:, -1])
    return information, gradient, np.column_stack([constant, slope]), np.array(decrement)


def _step(model: Model, found: Sequence[Equations], theta: Array, barrier: Barrier, *, hold: bool) -> _Step:
    p, n = len(theta), len(model.joints)
    _, pull, push = barrier.terms(theta)
    gauss = newton = push
    gradient = -pull
    maps = []
    decrement = 0.0
    for one in found:
        k = one.border.shape[1] - p
        information, g, back, fall = _schur(one, one.border, k)
        gauss = gauss + information
        bent = one.border.copy()
        bent[:, k:] += one.bend
        observed, g2, back2, _ = _schur(one, bent, k)
        newton = newton + observed
        gradient = gradient + g2
        decrement += float(fall)
        maps.append((k, back, back2, g))
    del n
    scale = np.sqrt(np.diag(gauss))
    good = np.linalg.eigvalsh(newton / np.outer(scale, scale))[0] > 0.02 * np.linalg.eigvalsh(gauss / np.outer(scale, scale))[0]
    if not good:
        gradient = -pull + sum(g for *_, g in maps)
    H = newton if good else gauss
    dtheta = np.zeros(p) if hold else np.linalg.solve(H / np.outer(scale, scale), gradient / scale) / scale
    dC, dW = [], []
    for k, back, back2, _ in maps:
        use = back2 if good else back
        move = use[:, 0] - use[:, 1:] @ dtheta
        dC.append(move[: len(move) - k])
        dW.append(move[len(move) - k :])
    decrement += 0.0 if hold else float(gradient @ dtheta)
    return _Step(dC, dW, dtheta, decrement, gauss - push, newton - push, bool(good))


def maximise(
    model: Model,
    segments: Sequence[Segment],
    states: Sequence[State],
    theta: Array,
    sigma_q: Array,
    sigma_tau: Array,
    barrier: Barrier,
    settings: Settings = Settings(),  # noqa: B008
    hold: int = 2,
    trace: list | None = None,
) -> Fitted:
    """Minimise the cost over trajectories, torques after steps, and theta (p), which must start inside the barrier.

    In the first ``hold`` steps theta stays where it is. Raises ModelError where the equations cannot be solved.
    """
    states, iteration, converged = tuple(states), 0, False
    def total(states: Sequence[State], theta: Array) -> float:
        if not barrier.inside(theta):
            return np.inf
        data = sum(s.cost(model, x, theta, sigma_q, sigma_tau) for s, x in zip(segments, states, strict=True))
        return data + barrier.terms(theta)[0]
    cost = total(states, theta)
    if not np.isfinite(cost):
        raise ModelError(f"{model.name}: the start is outside of what physics allows.")
    while True:
        found = [
            s.equations(model, x, theta, sigma_q, sigma_tau, bend=iteration >= hold)
            for s, x in zip(segments, states, strict=True)
        ]
        step = _step(model, found, theta, barrier, hold=iteration < hold)
        if trace is not None:
            trace.append((iteration, cost, step.decrement, step.newton, theta.copy()))
        converged = iteration >= hold and abs(step.decrement) < settings.tolerance
        if converged or iteration >= settings.iterations:
            break
        size = 1.0
        while not barrier.inside(theta + size * step.dtheta / 0.9):
            size *= 0.7
        while True:
            new = tuple(
                s.moved(x, size * c, size * w) for s, x, c, w in zip(segments, states, step.dC, step.dW, strict=True)
            )
            tried = total(new, theta + size * step.dtheta)
            if tried < cost - 1e-4 * size * step.decrement or size < 1e-3:
                break
            size *= 0.5
        iteration += 1
        if not tried < cost:
            if iteration < hold:
                iteration = hold
                continue
            break
        states, theta, cost = new, theta + size * step.dtheta, tried
    return Fitted(theta, states, step.information, step.observed, cost, step.decrement, iteration, converged)
