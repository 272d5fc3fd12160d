"""The physically consistent fit of a 7-joint arm, after compression: python3 benchmarks/consistent.py.

The arm is made here, as a robot file: seven links with offsets as on common arms, friction at each joint. Times are the
best of several repetitions with one BLAS thread. What decides the time is not the length of the log, but how much noise
drives the unconstrained fit out of what is possible.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from dataclasses import replace

os.environ.update(dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import numpy as np
from arm import LINKS, urdf

from dynident.estimators import Estimator, LeastSquares, PhysicallyConsistent, Problem
from dynident.models import Model, RigidBodies
from dynident.models.friction import Coulomb, Offset, Viscous
from dynident.motion.log import Motion
from dynident.regression import Regression, structural_base_parameters


def model() -> Model:
    bodies = RigidBodies(urdf(LINKS))
    friction = [term(bodies.joints, values=(0.5,) * len(bodies.joints)) for term in (Viscous, Coulomb, Offset)]
    return Model((bodies, *friction))


def problem(arm: Model, noise: float, samples: int = 5000) -> Problem:
    """A multisine of each joint, with noise on the torque in N m, already compressed."""
    rng, n = np.random.default_rng(0), len(arm.joints)
    t = np.linspace(0, 25, samples)
    rate, phase = 2 * np.pi * rng.uniform(0.05, 0.5, (5, n)), rng.uniform(0, 2 * np.pi, (5, n))
    size, angle = rng.uniform(0.1, 0.4, (5, n)), t[:, None, None] * rate + phase
    q, dq = (size * np.sin(angle)).sum(axis=1), (size * rate * np.cos(angle)).sum(axis=1)
    ddq = -(size * rate**2 * np.sin(angle)).sum(axis=1)
    truth = arm.values
    assert truth is not None
    tau = arm.torque(q, dq, ddq, truth) + noise * rng.standard_normal(q.shape)
    names = tuple(joint.name for joint in arm.joints)
    motion = Motion(t, q, dq, ddq, tau, names, np.ones(samples, dtype=bool))
    posed = Problem(arm, (motion,), Regression(arm, (motion,)))
    _ = posed.regression.triangular_factors
    return posed


def seconds(call: Callable[[], object], repeat: int = 7) -> float:
    best = np.inf
    for _ in range(repeat):
        began = time.perf_counter()
        call()
        best = min(best, time.perf_counter() - began)
    return best


def main() -> None:
    arm = model()
    basis = structural_base_parameters(arm)
    took = seconds(lambda: structural_base_parameters(arm), 3)
    print(f"structural rank {basis.rank} of {len(basis.names)}, gap {basis.gap:.0e}: {1e3 * took:.1f} ms", flush=True)
    fit = PhysicallyConsistent(costs=False)
    estimators: dict[str, Estimator] = {
        "least squares, per joint": LeastSquares(weights="per_joint"),
        "consistent, entropic": fit,
        "consistent, Euclidean": replace(fit, distance="euclidean"),
        "consistent, no prior": replace(fit, prior="none"),
        "consistent, with costs": replace(fit, costs=True),
    }
    for noise in (0.02, 0.5, 5.0):
        posed = problem(arm, noise)
        for name, estimator in estimators.items():
            physics = estimator(posed).consistency
            least = min(physics.eigenvalues.values(), default=np.nan) if physics else np.nan
            cost = physics.costs.get("all", np.nan) if physics else np.nan
            print(
                f"noise {noise:4.2f} N m  {name:<26} {1e3 * seconds(lambda e=estimator, p=posed: e(p)):6.1f} ms  "  # type: ignore[misc]
                f"smallest eigenvalue {least:.1e}  costs {cost:.4f} %",
                flush=True,
            )


if __name__ == "__main__":
    main()
