"""What a recording's motion is worth, for docs/experiment.md: python3 benchmarks/recording.py.

An arm of six joints with friction follows sums of sines; its torque has white noise. Printed for each motion: how many
base parameters it excites to working precision, and the standard error of the torque that least squares then predicts
on another motion at twice the speed, over that of the first recording.
"""

from __future__ import annotations

import os

os.environ.update(dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import numpy as np
from arm import LINKS, urdf

from dynident.models import Model, RigidBodies, RotorInertia
from dynident.models.friction import Coulomb, Offset, Viscous
from dynident.regression import structural_base_parameters

RATE, SPAN, JOINTS = 100.0, 20.0, 6  # Hz, s
Motion = tuple[np.ndarray, np.ndarray, np.ndarray]


def arm() -> Model:
    bodies = RigidBodies(urdf(LINKS[:JOINTS]))
    friction = (Viscous(bodies.joints), Coulomb(bodies.joints), Offset(bodies.joints))
    return Model((bodies, RotorInertia(bodies.joints), *friction))


def sines(seed: int, speed: float = 1.0, span: float = SPAN, size: float = 1.0) -> Motion:
    """Positions, velocities, accelerations (N, n): five sines a joint, to about 1.5 rad and, at speed 1, 1.5 rad/s."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, span, 1.0 / RATE)[:, None, None]
    w = speed * rng.uniform(0.3, 2.5, (JOINTS, 5))
    a, phase = size * 0.8 / (1 + w / speed), rng.uniform(0, 2 * np.pi, (JOINTS, 5))
    q = (a * np.sin(w * t + phase)).sum(axis=2)
    return q, (a * w * np.cos(w * t + phase)).sum(axis=2), -(a * w**2 * np.sin(w * t + phase)).sum(axis=2)


def one_by_one(centre: bool) -> Motion:
    """Each joint moved alone for its share of the time, the others at zero, or each time in another pose."""
    full, rng = sines(1), np.random.default_rng(2)
    turn = np.repeat(np.arange(JOINTS), -(-len(full[0]) // JOINTS))[: len(full[0])]
    moving = turn[:, None] == np.arange(JOINTS)
    pose = np.zeros((JOINTS, JOINTS)) if centre else rng.uniform(-1.5, 1.5, (JOINTS, JOINTS))
    q, dq, ddq = (np.where(moving, x, 0.0) for x in full)
    return np.where(moving, q, pose[turn]), dq, ddq


MOTIONS = {
    "20 s, all joints at once": sines(1),
    "10 s": sines(1, span=SPAN / 2),
    "80 s": sines(1, span=4 * SPAN),
    "half the speed": sines(1, speed=0.5),
    "a quarter of the speed": sines(1, speed=0.25),
    "twice the speed": sines(1, speed=2.0),
    "a third of the range, same frequencies": sines(1, size=1 / 3),
    "one joint after the other, others at zero": one_by_one(centre=True),
    "one joint after the other, others in new poses": one_by_one(centre=False),
}


def main() -> None:
    model = arm()
    kept = list(structural_base_parameters(model).independent)
    other = model.regressor(*sines(5, speed=2.0))[:, :, kept].reshape(-1, len(kept))
    errors = {}
    for name, motion in MOTIONS.items():
        X = model.regressor(*motion)[:, :, kept].reshape(-1, len(kept))
        size = np.linalg.norm(X, axis=0)
        size[size == 0] = 1.0
        _, s, Vt = np.linalg.svd(X / size, full_matrices=False)
        rank = int((s > 1e-5 * s[0]).sum())
        lost = (other / size) @ Vt[rank:].T  # what the other motion needs and this one does not show
        errors[name] = np.inf if np.abs(lost).max(initial=0) > 1e-6 else np.linalg.norm((other / size) @ Vt.T / s)
        ratio = errors[name] / errors["20 s, all joints at once"]
        print(f"{name:<44} {rank:>3} of {len(kept)}   {ratio:8.2f}", flush=True)


if __name__ == "__main__":
    main()
