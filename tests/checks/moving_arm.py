"""An arm of three joints that moves, and its logs, right or with one fault; for tests of what explains a residual."""

from dataclasses import replace

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


def waves(
    model: Model, theta: np.ndarray, rates, sizes, phases=0.0, noise: float = 0.02, seed: object = 0, t: np.ndarray = T
) -> Motion:
    """A sum of sines (k, n) on every joint, with the torque of a model and white noise of a share of it."""
    rates, sizes = (np.reshape(x, (-1, len(model.joints))) for x in (rates, sizes))
    angle = rates * t[:, None, None] + phases
    q, dq, ddq = (np.sum(sizes * rates**k * np.sin(angle + k * np.pi / 2), axis=1) for k in range(3))
    tau = model.torque(q, dq, ddq, theta)
    tau = tau + noise * tau.std(axis=0) * np.random.default_rng(seed).standard_normal(tau.shape)
    return Motion(t, q, dq, ddq, tau, tuple(x.name for x in model.joints), np.ones(len(t), bool))


def motion(seed: int = 0, noise: float = 0.02, model: Model | None = None, theta: np.ndarray | None = None) -> Motion:
    """A motion of four sines of each joint with the torque of the right arm, or of another."""
    model, rng = model or arm(), np.random.default_rng([17, seed])
    rates, phases, sizes = (rng.uniform(*limits, (4, 3)) for limits in ((0.8, 5.0), (0, 6), (0.15, 0.4)))
    return waves(model, truth(model) if theta is None else theta, rates, sizes, phases, noise, [18, seed])


MOVED = motion()


def with_torque(extra: np.ndarray, joint: int = 0, moved: Motion = MOVED) -> Motion:
    """A motion with more torque at one joint."""
    return replace(moved, tau=moved.tau + np.outer(extra, np.eye(3)[joint]))


def swap_torques(moved: Motion) -> Motion:
    return replace(moved, tau=moved.tau[:, [0, 2, 1]])


def case(moved: Motion = MOVED, model: Model | None = None, samples: int = 500) -> FitCase:
    return fit_case(model or arm(), [moved], samples=samples)
