"""Rigid bodies of an arm of seven joints: Pinocchio's loop over samples, NumPy, and the kernel where there is one.

python3 benchmarks/bodies.py prints microseconds a sample (CPU, one BLAS thread, best of several), the ratio to
Pinocchio's within the same seconds, and the difference from its results.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable

os.environ.update(dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import numpy as np
import pinocchio as pin
from arm import LINKS, urdf

from dynident.kernel import kernel
from dynident.models import RigidBodies
from dynident.models.recursion import Recursion
from dynident.models.recursion_kernel import CompiledRecursion
from dynident.models.tree import Layout, Tree

SAMPLES = 4096
Call = Callable[[], np.ndarray]


def peer(text: str, theta: np.ndarray, states: np.ndarray) -> dict[str, Call]:
    """Return what Pinocchio computes of an arm, one sample after the other."""
    model = pin.buildModelFromXML(text)
    for k, body in enumerate(theta):
        model.inertias[k + 1] = pin.Inertia.FromDynamicParameters(body)
    data, n = model.createData(), model.nv

    def each(compute: Callable[..., object], *shape: int) -> Call:
        def call() -> np.ndarray:
            out = np.empty((len(states[0]), *shape))
            for row, q, dq, ddq in zip(out, *states, strict=True):
                row[:] = compute(model, data, q, dq, ddq)
            return out

        return call

    return {
        "regressor": each(pin.computeJointTorqueRegressor, n, 10 * n),
        "torque": each(pin.rnea, n),
        "derivatives": each(pin.computeRNEADerivatives, 3, n, n),
    }


def ours(one: Recursion, theta: np.ndarray, states: np.ndarray) -> dict[str, Call]:
    """Return the same by a recursion, and what else it has."""
    (q, dq, ddq), (joint, parameter) = states, np.nonzero(one.layout.support)
    return {
        "regressor": lambda: one.regressor(q, dq, ddq),
        "torque": lambda: one.torque(q, dq, ddq, theta),
        "derivatives": lambda: one.partials(q, dq, ddq, theta).swapaxes(0, 1),
        "entries": lambda: one.entries(q, dq, ddq, joint, parameter),
        "mass and bias": lambda: one.mass_and_bias(q, dq, theta)[0],
    }


def cost(call: Call, samples: int) -> float:
    """Return microseconds of CPU a sample."""
    best = np.inf
    for _ in range(20):
        began = time.process_time()
        for _ in range(max(1, 100 // samples)):
            call()
        best = min(best, time.process_time() - began)
    return best / max(1, 100 // samples) / samples * 1e6


def bodies(samples: int = SAMPLES) -> dict[str, dict[str, tuple[float, float, float]]]:
    """Return for each way and each quantity its cost, the ratio to Pinocchio's, and the largest relative difference."""
    text = urdf(LINKS)
    term = RigidBodies(text)
    theta = np.array([one.value for one in term.parameters], dtype=float).reshape(-1, 10)
    states = np.random.default_rng(0).normal(size=(3, samples, len(term.joints)))
    tree = Tree.of(term.arm, Layout.of(term.arm))
    ways = {"NumPy": Recursion} | ({f"kernel {kernel().level}": CompiledRecursion} if kernel().level else {})
    calls = {"Pinocchio": peer(text, theta, states)}
    calls |= {name: ours(way(tree, np.array(term.gravity)), theta, states) for name, way in ways.items()}
    out: dict[str, dict[str, tuple[float, float, float]]] = {name: {} for name in calls}
    for what in calls["NumPy"]:
        costs = {name: cost(some[what], samples) for name, some in calls.items() if what in some}
        found = {name: some[what]() for name, some in calls.items() if what in some}
        judge = found.get("Pinocchio", found["NumPy"])
        for name, value in found.items():
            error = float(np.abs(value - judge).max() / np.abs(judge).max())
            out[name][what] = costs[name], costs.get("Pinocchio", np.nan) / costs[name], error
    return out


def main() -> None:
    for samples in (SAMPLES, 1):
        print(f"{samples} samples: us a sample, times as fast as Pinocchio's loop, difference")
        for name, row in bodies(samples).items():
            for what, (microseconds, ratio, error) in row.items():
                print(f"  {name:14} {what:14} {microseconds:9.3f} {ratio:7.1f} {error:9.1e}")


if __name__ == "__main__":
    main()
