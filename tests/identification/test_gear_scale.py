"""A gear that is wrong alike for position and torque of a joint that is coupled to no other only scales its numbers."""

import numpy as np
import pytest

from dynident.estimators import Estimator, LeastSquares, PhysicallyConsistent
from dynident.identification import Recipe, identify
from dynident.models import Model, RigidBodies, RotorInertia
from dynident.models.friction import Coulomb, Offset, Viscous
from dynident.motion.log import Log
from tests.identification.motions import sines
from tests.robots import joint, link, urdf

T = np.arange(0, 4, 0.01)
FILE = urdf(
    link("base"),
    link("pan", 2.0, (0.1, 0.03, 0.01), tensor=np.diag([0.01, 0.02, 0.02])),
    link("lift", 3.0, (0.2, 0.0, 0.02), tensor=np.diag([0.01, 0.05, 0.05])),
    joint("pan", "revolute", "base", "pan", (1.0, 0, 0)),
    joint("lift", "revolute", "base", "lift", (0, 0, 0.2), axis=(0, 1, 0)),
)
VALUES = {"rotor": 0.2, "viscous": 2.0, "coulomb": 3.0, "": 0.3}


def errors(factor: float, estimator: Estimator) -> dict[str, float]:
    """The held-out errors by joint where the panning joint has positions ``factor`` times as large, and less torque."""
    bodies = RigidBodies(FILE)
    model = Model((bodies, *(term(bodies.joints) for term in (RotorInertia, Viscous, Coulomb, Offset))))
    theta = np.array([VALUES[x.role] if x.value is None else x.value for x in model.parameters])
    logs, gear = [], np.array([factor, 1.0])
    for seed in range(2):
        rng = np.random.default_rng(seed)
        rate, phase = rng.uniform(1.0, 6.0, (3, 2)), rng.uniform(0, 6, (3, 2))
        q, dq, ddq = sines(T, 0.3, rate, phase)
        tau = model.torque(q, dq, ddq, theta)
        tau = tau + 0.02 * tau.std(axis=0) * rng.standard_normal(tau.shape)
        q = q + 1e-5 * rng.standard_normal(q.shape)
        logs.append(Log(T, gear * q, tau / gear, ("pan", "lift"), source=f"log {seed}"))
    result = identify(model, logs[:1], logs[1:], Recipe(estimator=estimator))
    return dict(result.of_role("validation")[0].errors.per_joint)


@pytest.mark.parametrize("estimator", [LeastSquares(), PhysicallyConsistent()], ids=lambda x: type(x).__name__)
def test_the_gear_of_a_joint_alone_changes_no_error(estimator: Estimator) -> None:
    right = errors(1.0, estimator)
    assert max(right.values()) < 4.0
    assert errors(100.0, estimator) == pytest.approx(right, rel=1e-3)
