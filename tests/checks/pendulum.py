"""A pendulum that moves, and its logs; for tests of what recordings show."""

import numpy as np

from dynident.models import Model, RigidBodies
from dynident.motion.log import Log
from tests.robots import joint, link, urdf

BODIES = RigidBodies(
    urdf(link("base"), link("arm", 1.0, (0.2, 0, 0)), joint("pivot", "revolute", "base", "arm", axis=(0, 1, 0)))
)
PENDULUM = Model((BODIES,))
T = np.arange(1000) * 0.005


def swing(seed: int, *waves: tuple[float, float], noise: float = 1e-4) -> Log:
    """The pendulum moves by waves of given sizes and rates."""
    q, dq, ddq = (sum(a * w**k * np.sin(w * T + k * np.pi / 2) for a, w in waves)[:, None] for k in range(3))
    rng, theta = np.random.default_rng(seed), np.array([x.value for x in PENDULUM.parameters], dtype=float)
    tau = PENDULUM.torque(q, dq, ddq, theta) + 0.02 * rng.standard_normal(q.shape)
    return Log(T, q + noise * rng.standard_normal(q.shape), tau, ("pivot",), "a")
