"""What CMA-ES finds of a servo arm, as PACE (arXiv:2509.06342) uses it: armature, damping, dry friction and encoder
bias of each joint, and one delay, by nothing but simulations.

Hansen, "The CMA evolution strategy: a tutorial", arXiv:1604.00772. Positive values are sought by their logarithms.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import mujoco
import mujoco.rollout
import numpy as np
from numpy.typing import NDArray
from servo import KINDS, Outcome
from servo_arm import NAMES, ServoArm, held_means

Array = NDArray[np.float64]
FACTOR, MAX_BIAS, MAX_DELAY = 30.0, 0.05, 0.06  # of the file's values; rad; s
POPULATION, EVALUATIONS = 24, 3000
SETTLING = 0.5  # s at the start that are not compared


def evolve(arm: ServoArm, seed: int, duration: float) -> Outcome:
    """Return what the search finds, and its CPU."""
    t, command, q, _ = arm.record(seed, duration)
    model = mujoco.MjModel.from_xml_string(arm.text(nominal=True))
    nominal = np.array([model.dof_armature, model.dof_damping.reshape(6, -1)[:, 0], model.dof_frictionloss])
    start = time.process_time()

    def values_of(x: Array) -> tuple[Array, Array, float]:
        return nominal * FACTOR ** (2 * x[:18].reshape(3, 6) - 1), (2 * x[18:24] - 1) * MAX_BIAS, x[24] * MAX_DELAY

    def cost(x: Array) -> float:
        values, bias, delay = values_of(x)
        simulated = simulate(model, values, bias, delay, t, command, q[0])
        return float(np.log(((simulated - q)[t > SETTLING] ** 2).mean() + 1e-300))

    best = search(cost, 0.5 * np.ones(25), np.random.default_rng(seed))
    values, _, delay = values_of(best)
    return Outcome(values, float(delay), time.process_time() - start)


def simulate(model: Any, values: Array, bias: Array, delay: float, t: Array, command: Array, start: Array) -> Array:
    """Return the positions (N, 6) that encoders of a bias (6) show of an arm with values (3, 6)."""
    for name, row in zip(KINDS, values, strict=True):
        part = getattr(model, f"dof_{name}")
        part[...] = row.reshape(part.shape) if part.ndim == 1 else np.column_stack([row, part[:, 1:]])
    data, step = mujoco.MjData(model), model.opt.timestep
    mujoco.mj_setConst(model, data)
    data.qpos[:] = start - bias
    state = np.empty(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
    mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    edges = step * np.arange(round(t[-1] / step) + 2) - delay
    history, _ = mujoco.rollout.rollout(model, data, state[None], (held_means(t, command, edges) - bias)[None])
    path = np.vstack([start - bias, history[0][:, 1 : 1 + len(NAMES)]])
    return np.column_stack([np.interp(t, step * np.arange(len(path)), column) for column in path.T]) + bias


def search(cost: Callable[[Array], float], mean: Array, rng: np.random.Generator) -> Array:
    """Return the best point in the unit cube; what is drawn outside is put on its face."""
    n, parents = len(mean), POPULATION // 2
    weights = np.log(parents + 0.5) - np.log(np.arange(1, parents + 1))
    weights /= weights.sum()
    mass = 1 / (weights**2).sum()
    path_rate, size_rate = (4 + mass / n) / (n + 4 + 2 * mass / n), (mass + 2) / (n + mass + 5)
    one_rate = 2 / ((n + 1.3) ** 2 + mass)
    rank_rate = min(1 - one_rate, 2 * (mass - 2 + 1 / mass) / ((n + 2) ** 2 + mass))
    damping = 1 + 2 * max(0.0, np.sqrt((mass - 1) / (n + 1)) - 1) + size_rate
    length = np.sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n**2))  # expected, of a normal vector
    sigma, covariance, path, size_path = 0.2, np.eye(n), np.zeros(n), np.zeros(n)
    best, least = mean, np.inf
    for k in range(EVALUATIONS // POPULATION):
        spectrum, vectors = np.linalg.eigh(covariance)
        root = np.sqrt(np.maximum(spectrum, 1e-20))
        points = np.clip(mean + sigma * (rng.standard_normal((POPULATION, n)) * root) @ vectors.T, 0.0, 1.0)
        costs = np.array([cost(point) for point in points])
        order = np.argsort(costs)
        if costs[order[0]] < least:
            best, least = points[order[0]], costs[order[0]]
        steps = (points[order[:parents]] - mean) / sigma
        mean_step = weights @ steps
        mean = mean + sigma * mean_step
        whitened = vectors @ ((vectors.T @ mean_step) / root)
        size_path = (1 - size_rate) * size_path + np.sqrt(size_rate * (2 - size_rate) * mass) * whitened
        norm = float(np.linalg.norm(size_path))
        is_short = norm / np.sqrt(1 - (1 - size_rate) ** (2 * k + 2)) < (1.4 + 2 / (n + 1)) * length
        path = (1 - path_rate) * path + is_short * np.sqrt(path_rate * (2 - path_rate) * mass) * mean_step
        loss = one_rate * (1 - is_short) * path_rate * (2 - path_rate)
        covariance = (1 - one_rate - rank_rate + loss) * covariance + one_rate * np.outer(path, path)
        covariance = covariance + rank_rate * (steps.T * weights) @ steps
        sigma *= float(np.exp((size_rate / damping) * (norm / length - 1)))
    return np.asarray(best)
