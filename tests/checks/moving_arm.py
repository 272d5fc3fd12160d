"""An arm of three joints that moves, and its logs, right or with one fault; for tests of what explains a residual."""

from __future__ import annotations

import numpy as np

from dynident.checks.misfit import FitCase, fit_case
from dynident.models import Model, RigidBodies, RotorInertia
from dynident.models.friction import Coulomb, Offset, Viscous
from dynident.motion.log import Motion
from tests.robots import joint, link, urdf

T = np.arange(0, 10, 0.01)


def text(length: float = 0.4, axis=(0, 1, 0), turn=(0, 0, 0)) -> str:
    """The arm with another length of the upper arm, axis of the last joint, or turn of its frame."""
    return urdf(
        link("base"),
        link("shoulder", 4.0, (0.05, 0.02, 0.05), tensor=np.diag([0.03, 0.03, 0.02])),
        link("upper", 3.0, (0.2, 0.0, 0.02), tensor=np.diag([0.01, 0.05, 0.05])),
        link("fore", 2.0, (0.15, 0.03, 0.01), tensor=np.diag([0.008, 0.02, 0.02])),
        joint("j1", "revolute", "base", "shoulder", (0, 0, 0.3)),
        joint("j2", "revolute", "shoulder", "upper", (0.1, 0, 0.2), axis=(0, 1, 0)),
        joint("j3", "revolute", "upper", "fore", (length, 0, 0), turn, axis=axis),
    )


def arm(file: str = text(), without: str = "") -> Model:
    bodies = RigidBodies(file)
    terms = {"rotor": RotorInertia, "viscous": Viscous, "coulomb": Coulomb, "offset": Offset}
    return Model((bodies, *(term(bodies.joints) for name, term in terms.items() if name != without)))


VALUES = {"rotor": 0.3, "viscous": 1.0, "coulomb": 1.5, "": 0.4}


def truth(model: Model) -> np.ndarray:
    return np.array([VALUES[x.role] if x.value is None else x.value for x in model.parameters])


def motion(seed: int = 0, noise: float = 0.02, model: Model | None = None, theta: np.ndarray | None = None) -> Motion:
    """A motion of sines with the torque of the right arm, or of another, and white noise."""
    model, rng = model or arm(), np.random.default_rng([17, seed])
    q, dq, ddq = np.zeros((3, len(T), 3))
    for _ in range(4):
        rate, phase, size = rng.uniform(0.8, 5.0, 3), rng.uniform(0, 6, 3), rng.uniform(0.15, 0.4, 3)
        angle = np.outer(T, rate) + phase
        q, dq = q + size * np.sin(angle), dq + size * rate * np.cos(angle)
        ddq = ddq - size * rate**2 * np.sin(angle)
    tau = model.torque(q, dq, ddq, truth(model) if theta is None else theta)
    tau = tau + noise * tau.std(axis=0) * rng.standard_normal(tau.shape)
    return Motion(T, q, dq, ddq, tau, tuple(x.name for x in model.joints), np.ones(len(T), bool))


def case(moved: Motion | None = None, model: Model | None = None, samples: int = 500) -> FitCase:
    return fit_case(model or arm(), [moved or motion()], samples=samples)
