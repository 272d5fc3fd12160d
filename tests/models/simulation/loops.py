"""Motions and controllers to simulate with, for the tests of the room."""

import numpy as np

from dynident.models import Model
from dynident.models.friction import Coulomb, Offset, Viscous
from dynident.models.lagrangian import pendulum, two_link_arm
from dynident.models.simulation import PD, PID, CascadePD, Function
from dynident.motion.log import Motion

HINGE = pendulum().joints
RUSTY = pendulum().with_terms(Viscous(HINGE), Coulomb(HINGE), Offset(HINGE))
RUST = np.array([0.0825, 0.25, 0.05, 0.4, 0.05])
LINKS = two_link_arm().joints
ARM = two_link_arm().with_terms(Viscous(LINKS), Coulomb(LINKS))
LINKED = np.array([*two_link_arm().values, 0.3, 0.2, 0.5, 0.3])


def driven(model: Model, t: np.ndarray, start: float = 0.1, speed: float = 0.2) -> Motion:
    """A motion to start from, with torques that move, hold and reverse the joints."""
    n = len(model.joints)
    zero, k = np.zeros((len(t), n)), np.arange(n)
    tau = (1.5 - 0.7 * k) * np.sin(np.multiply.outer(t, 5 + 2 * k))
    names = tuple(joint.name for joint in model.joints)
    return Motion(t, zero + start, zero + speed, zero, tau, names, np.ones(len(t), dtype=bool), "run")


def reference(motion: Motion) -> np.ndarray:
    """A reference that rests and moves."""
    t = motion.t[:, None]
    return 0.5 * np.sin(4 * t) * np.clip(5 * np.sin(3 * t), 0, 1) * np.ones(len(motion.joints))


def spring(t: float, q: np.ndarray, dq: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    return 10 * np.tanh(wanted - q) - 0.2 * dq + 0.01 * t


def loop(kind: str, motion: Motion, limit: float = np.inf) -> PD | PID | CascadePD | Function:
    """A controller of a kind, which the two-link arm and the pendulum bear at 1 kHz."""
    wanted, ones = reference(motion), np.ones(len(motion.joints))
    shared = {"joints": motion.joints, "t": motion.t, "reference": wanted, "feedforward": 0.1 * wanted}
    shared |= {"gain": 2 * ones, "saturation": limit * ones}
    if kind == "cascade":
        return CascadePD(kp=50 * ones, kv=0.2 * ones, **shared)
    if kind == "function":
        return Function(law=spring, **shared)
    pd = PD(kp=10 * ones, kd=0.2 * ones, **shared)
    if kind == "pid":
        return PID(pd, 40 * ones)
    speed = np.gradient(wanted, motion.t, axis=0) if kind == "tracking" else None
    return PD(kp=10 * ones, kd=0.2 * ones, velocity_reference=speed, **shared)
