"""An arm of six joints for a payload of 300 kg, or as small as one likes, with and without the inertias in its file."""

import numpy as np
from numpy.typing import NDArray

from dynident.estimators import Problem
from dynident.models import Model, RigidBodies
from dynident.models.friction import Coulomb, Offset, Viscous
from dynident.motion.log import Motion
from dynident.regression import Regression
from tests.robots import joint, link, urdf

Array = NDArray[np.float64]
LINKS = (  # kg; m; m^2
    (600, (0.1, 0.02, -0.2), 0.09),
    (350, (0.5, 0.02, 0.05), 0.12),
    (250, (0.05, 0.2, 0.1), 0.06),
    (80, (0.02, 0.01, 0.6), 0.08),
    (40, (0.0, -0.02, 0.05), 0.01),
    (330, (0.05, 0.02, 0.35), 0.05),
)
JOINTS = (  # m
    ((0, 0, 0.8), (0, 0, 1)),
    ((0.4, 0, 0.2), (0, 1, 0)),
    ((1.3, 0, 0), (0, 1, 0)),
    ((0.1, 0, 0.2), (1, 0, 0)),
    ((1.4, 0, 0), (0, 1, 0)),
    ((0.2, 0, 0), (1, 0, 0)),
)


def arm(mass: float = 1.0, length: float = 1.0, inertias: str = "true", off: float = 0.0, seed: int = 0) -> str:
    """The text of its robot file; ``inertias`` "true", "zero" or "none"; true ones wrong by the share ``off``."""
    rng, parts = np.random.default_rng(seed), [link("base")]
    for k, (m, centre, moment) in enumerate(LINKS):
        share = 1.0 + off * rng.choice([-1.0, 1.0])
        if inertias == "none":
            parts.append(link(f"l{k}"))
        elif inertias == "zero":
            parts.append(link(f"l{k}", 0.0, tensor=np.zeros((3, 3))))
        else:
            tensor = np.diag([1.0, 1.2, 0.8]) * moment * m * mass * length**2 * share
            parts.append(link(f"l{k}", m * mass * share, tuple(length * np.array(centre)), tensor=tensor))
    for k, (place, axis) in enumerate(JOINTS):
        before = "base" if k == 0 else f"l{k - 1}"
        parts.append(joint(f"j{k}", "revolute", before, f"l{k}", xyz=tuple(length * np.array(place)), axis=axis))
    return urdf(*parts)


def problem(
    text: str,
    mass: float = 1.0,
    length: float = 1.0,
    *,
    speed: float = 1.0,
    seed: int = 0,
    samples: int = 1200,
    seconds: float = 20.0,
    wrong: float = 1.0,
) -> Problem:
    """The problem of a file's model and the torque of the true arm with friction, ``wrong`` times ripple and noise."""
    truth, bodies, rng = RigidBodies(arm(mass, length)), RigidBodies(text), np.random.default_rng(seed)
    t = np.linspace(0.0, seconds, samples)
    phase, rate = rng.uniform(0, 6, (4, 6)), speed * rng.uniform(0.5, 2.5, (4, 6))
    angle = [rate[k] * t[:, None] + phase[k] for k in range(4)]
    q = sum((0.3 * np.sin(x) for x in angle), np.zeros((samples, 6)))
    dq = sum((0.3 * rate[k] * np.cos(x) for k, x in enumerate(angle)), np.zeros((samples, 6)))
    ddq = sum((-0.3 * rate[k] ** 2 * np.sin(x) for k, x in enumerate(angle)), np.zeros((samples, 6)))
    tau = truth.torque(q, dq, ddq, np.array([parameter.value for parameter in truth.parameters], dtype=float))
    rms = tau.std(axis=0)
    unlike = 0.05 * np.sin(17 * q) + 0.03 * rng.standard_normal(q.shape)
    tau = tau + rms * (0.1 * dq + 0.1 * np.sign(dq) + wrong * unlike)
    model = Model((bodies, Viscous(bodies.joints), Coulomb(bodies.joints), Offset(bodies.joints)))
    motion = Motion(t, q, dq, ddq, tau, tuple(x.name for x in bodies.joints), np.ones(samples, bool))
    return Problem(model, (motion,), Regression(model, (motion,)))


def error(posed: Problem, theta: Array) -> float:
    """The relative torque error (%)."""
    factors = posed.regression.triangular_factors
    return float(100 * np.sqrt(factors.residual(theta).sum() / np.square(factors.factors[:, :, -1]).sum()))
