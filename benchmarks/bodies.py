"""Regressors of rigid bodies: chains of any number of joints on their way along sines."""

from __future__ import annotations

from collections.abc import Callable
from itertools import cycle, islice

import numpy as np
from arm import LINKS, urdf
from numpy.typing import NDArray

Call = Callable[[], object]
Array = NDArray[np.float64]


def chain(joints: int) -> str:
    """An arm of so many joints as URDF text: that of arm.py, and again from its start."""
    return urdf(list(islice(cycle(LINKS), joints)))


def states(joints: int, samples: int, step: float = 5e-3) -> tuple[Array, Array, Array]:
    """Positions, velocities and accelerations (N, n), a ``step`` (s) apart: five sines a joint."""
    rng, t = np.random.default_rng(0), np.arange(samples) * step
    rate, phase = 2 * np.pi * rng.uniform(0.05, 0.5, (5, joints)), rng.uniform(0, 2 * np.pi, (5, joints))
    wave = rng.uniform(0.1, 0.4, (5, joints)) * np.exp(1j * (t[:, None, None] * rate + phase))
    q, dq, ddq = ((wave * (1j * rate) ** order).imag.sum(axis=1) for order in range(3))
    return q, dq, ddq


def regressor(way: str, joints: int, samples: int) -> Call:
    """The regressor of all states; Pinocchio gives one at a time."""
    q, dq, ddq = states(joints, samples)
    if way == "Pinocchio":
        import pinocchio as pin

        model = pin.buildModelFromXML(chain(joints))
        data, compute = model.createData(), pin.computeJointTorqueRegressor

        def loop() -> Array:
            Y = np.empty((samples, joints, 10 * joints))
            for k in range(samples):
                Y[k] = compute(model, data, q[k], dq[k], ddq[k])
            return Y

        return loop
    from dynident.models import RigidBodies

    bodies = RigidBodies(chain(joints))
    return lambda: bodies.regressor(q, dq, ddq)
