"""An arm of a robot file that is good for simulation."""

import numpy as np
import pytest

from dynident.estimators import PhysicallyConsistent
from dynident.identification import Identification, Recipe, identify
from dynident.models import Model, RigidBodies
from dynident.models.friction import Coulomb, Viscous
from dynident.motion.log import Log
from dynident.motion.smoothers import Difference
from tests.identification.motions import sines
from tests.robots import joint, link, urdf

ARM = urdf(
    link("base", 1.0),
    link("upper", 3.0, (0.15, 0.02, 0.01), tensor=np.diag([0.02, 0.03, 0.03])),
    link("fore", 1.5, (0.1, 0.0, 0.03), tensor=np.diag([0.01, 0.012, 0.011])),
    joint("shoulder", "revolute", "base", "upper", axis=(0, 1, 0)),
    joint("elbow", "revolute", "upper", "fore", (0.3, 0.0, 0.0), (0.4, 0.0, 0.0), axis=(0, 1, 0)),
)


def recorded(model: Model, source: str, seed: int) -> Log:
    rng, t = np.random.default_rng(seed), np.arange(3000) * 0.002
    rate, phase = rng.uniform(2.0, 6.0, (3, 2)), rng.uniform(0.0, 6.0, (3, 2))
    q, dq, ddq = sines(t, 0.4, rate, phase)
    truth = np.array([{"viscous": 0.8, "coulomb": 0.5}.get(x.role, x.value) for x in model.parameters])
    noise = 0.02 * rng.standard_normal((3000, 2))
    return Log(t, q, model.torque(q, dq, ddq, truth) + noise, ("shoulder", "elbow"), source)


@pytest.fixture(scope="module")
def arm() -> Identification:
    bodies = RigidBodies(ARM)
    model = Model((bodies, Viscous(bodies.joints), Coulomb(bodies.joints)))
    recipe = Recipe(Difference("central"), PhysicallyConsistent(), restart=0.2)
    return identify(model, [recorded(model, "one", 1)], [recorded(model, "two", 2)], recipe)
