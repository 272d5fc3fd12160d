"""An arm of three joints with a friction law that is known."""

from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import NDArray

from dynident.identification.terms import library_kinds
from dynident.models import Model, Past, RigidBodies
from dynident.models.friction import Dahl
from dynident.motion.filters import butterworth, zero_phase
from dynident.motion.log import Motion
from tests.identification.motions import sines
from tests.robots import three_joints

Array = NDArray[np.float64]
Law = Callable[[Array, Array, Array, Array], Array]

ARM = three_joints(base_axis=(0, 1, 0), fore_centre=(0.1, 0.06, 0))
PLAIN = tuple(kind for kind in library_kinds() if kind.presumed)
FEW = (*PLAIN, *(kind for kind in library_kinds() if kind.name in ("load_coulomb", "dahl")))
SIZE = np.array([3.0, 1.5, 0.15])  # N m: of the friction of each joint


@cache
def bodies() -> RigidBodies:
    """The bodies of the arm."""
    return RigidBodies(ARM)


def states(seed: int, rows: int = 4000) -> tuple[Array, ...]:
    """Return t (N) and q, dq, ddq (N, 3) of a Fourier series."""
    rng, t = np.random.default_rng(seed), np.arange(rows) * 0.005
    rate = 0.6 * np.arange(1, 6)
    size, phase = rng.normal(size=(5, 3)) / np.arange(1, 6)[:, None], rng.uniform(0, 6, (5, 3))
    return t, *sines(t, size, rate[:, None], phase)


def recorded(law: Law, seed: int, noise: float = 0.05, rows: int = 4000) -> Motion:
    """Return a motion whose torque is that of the bodies and of a law: torques (N, 3) of t, q, dq and the load, per
    unit of SIZE; ``noise`` is that of the torque, half white, half below 4 Hz, relative to the size of the friction."""
    t, q, dq, ddq = states(seed, rows)
    arm, rng = Model((bodies(),)), np.random.default_rng(seed + 1)
    theta = 1.1 * np.array([parameter.value for parameter in arm.parameters])
    load = arm.torque(q, dq, ddq, theta)
    slow = zero_phase(butterworth(2, 4.0, 200.0), rng.normal(size=q.shape), 6, axis=0)
    error = rng.normal(size=q.shape) + slow / slow.std(axis=0)
    tau = load + SIZE * (law(t, q, dq, load) + noise / np.sqrt(2) * error)
    return Motion(t, q, dq, ddq, tau, tuple(x.name for x in bodies().joints), np.ones(len(t), bool))


def viscous(t: Array, q: Array, dq: Array, load: Array) -> Array:
    """Viscous friction."""
    return 0.3 * dq


def none(t: Array, q: Array, dq: Array, load: Array) -> Array:
    """No friction."""
    return np.zeros_like(q)


def coulomb(t: Array, q: Array, dq: Array, load: Array) -> Array:
    """Viscous and Coulomb friction."""
    return viscous(t, q, dq, load) + np.sign(dq)


def breakaway(t: Array, q: Array, dq: Array, load: Array) -> Array:
    """Coulomb friction that is larger in a narrow range of low speed, with a sharp sign."""
    return coulomb(t, q, dq, load) + 0.5 * np.exp(-np.square(dq / 0.05)) * np.sign(dq)


def averaged(t: Array, q: Array, dq: Array, load: Array) -> Array:
    """Viscous and Coulomb friction, each sample the mean over its interval: at a reversal of both signs."""
    step = np.abs(np.gradient(dq, axis=0))
    return viscous(t, q, dq, load) + np.clip(2.0 * dq / step, -1.0, 1.0)


def wide(t: Array, q: Array, dq: Array, load: Array) -> Array:
    """The same with a wide sign."""
    return viscous(t, q, dq, load) + np.tanh(dq / 0.1)


def by_load(t: Array, q: Array, dq: Array, load: Array) -> Array:
    """Friction that grows with the load."""
    return viscous(t, q, dq, load) + 1.5 * np.abs(load) / np.sqrt(np.mean(load**2, axis=0)) * np.tanh(dq / 0.05)


def dahl(t: Array, q: Array, dq: Array, load: Array) -> Array:
    """Presliding over 0.02 rad."""
    term = Dahl(bodies().joints, length=0.02)
    return viscous(t, q, dq, load) + term.remember(Past(t, q, dq, np.zeros_like(q), load))


def ripple(t: Array, q: Array, dq: Array, load: Array) -> Array:
    """Ripple of 32 cycles in a turn."""
    return coulomb(t, q, dq, load) + 0.3 * np.sin(32 * q + 0.4)


def fine_ripple(t: Array, q: Array, dq: Array, load: Array) -> Array:
    """Ripple of 150 cycles in a turn."""
    return coulomb(t, q, dq, load) + 0.3 * np.sin(150 * q)


def ripple_and_bump(t: Array, q: Array, dq: Array, load: Array) -> Array:
    """Less ripple, and a torque at some positions that no term describes."""
    return coulomb(t, q, dq, load) + 0.1 * np.sin(32 * q + 0.4) + 0.5 * np.exp(-3 * np.abs(q - 1))
