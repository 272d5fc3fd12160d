"""An arm of six joints with a flange, recorded with and without a payload."""

from functools import cache

import numpy as np

from dynident.apps.payload import mount_of
from dynident.estimators import LeastSquares
from dynident.identification import Identification, Recipe, identify, tilt_base
from dynident.models import Model, RigidBodies, from_physical
from dynident.models.friction import Coulomb, Offset, Viscous
from dynident.motion.log import Log
from dynident.motion.smoothers import Spline
from dynident.runtime.arrays import Array
from tests.robots import joint, link, urdf

SIX = urdf(
    link("base"),
    link("column", 8.0, (0.02, 0.03, 0.1), tensor=np.diag([0.1, 0.1, 0.06])),
    link("upper", 6.0, (0.2, 0.02, 0.01), tensor=np.diag([0.02, 0.09, 0.09])),
    link("fore", 3.0, (0.15, -0.01, 0.02), tensor=np.diag([0.006, 0.03, 0.03])),
    link("roll", 1.5, (0.0, 0.01, 0.04), tensor=np.diag([0.006, 0.006, 0.003])),
    link("bend", 1.0, (0.01, 0.0, 0.03), tensor=np.diag([0.003, 0.004, 0.002])),
    link("turn", 0.6, (0.02, 0.01, 0.05), tensor=np.diag([0.0015, 0.002, 0.001])),
    link("arm_tool0"),
    joint("j1", "continuous", "base", "column", (0, 0, 0.3)),
    joint("j2", "continuous", "column", "upper", (0.05, 0.08, 0.1), axis=(0, 1, 0)),
    joint("j3", "continuous", "upper", "fore", (0.4, -0.02, 0), axis=(0, 1, 0)),
    joint("j4", "continuous", "fore", "roll", (0.32, 0, 0.05), (0, np.pi / 2, 0)),
    joint("j5", "continuous", "roll", "bend", (0, 0, 0.1), axis=(0, 1, 0)),
    joint("j6", "continuous", "bend", "turn", (0, 0, 0.1)),
    joint("mounted", "fixed", "turn", "arm_tool0", (0, 0, 0.08), (0, 0, 0.3)),
)
FRICTION = (3.0, 3.0, 1.5, 0.4, 0.4, 0.2)
CARRIED = from_physical(3.0, [0.02, -0.03, 0.08], np.diag([0.012, 0.015, 0.006]))
"""In the frame of the flange."""
RECIPE = Recipe(Spline(), LeastSquares(weights="per_joint"))
NOISE = 0.005  # of the rms torque


@cache
def arm() -> tuple[Model, Array]:
    """The model with friction, and its true parameters."""
    bodies = RigidBodies(SIX, source="six.urdf")
    model = Model((bodies, Viscous(bodies.joints), Coulomb(bodies.joints), Offset(bodies.joints)))
    nominal = [parameter.value for parameter in bodies.parameters]
    return model, np.array([*nominal, *FRICTION, *np.multiply(1.3, FRICTION), *np.multiply(0.1, FRICTION)])


def recorded(
    name: str, payload: Array | None = None, gains: float | Array = 1.0, more: Array | None = None,
    still: tuple[int, ...] = (), tilt: tuple[float, float] = (0.0, 0.0), by_load: float = 0.0,
) -> Log:  # fmt: skip
    """A recording of 8 s; ``more`` is added to the parameters, joints ``still`` do not move, the base has a ``tilt``,
    and friction grows ``by_load``."""
    model, theta = arm()
    theta = theta if more is None else theta + more
    theta = theta if payload is None else theta + mount_of(model).transform @ payload
    rng, n = np.random.default_rng(list(map(ord, name))), len(model.joints)
    t = np.arange(1600) * 0.005 if still else np.arange(800) * 0.01  # to see what noise is where nothing moves
    rate = 2 * np.pi / 8 * np.arange(1, 6)[:, None, None]
    phase, size = rng.uniform(0, 2 * np.pi, (5, 1, n)), rng.uniform(0.3, 1.0, (5, 1, n))
    size *= 1.4 / size.sum(axis=0)
    size[:, :, list(still)] = 0.0
    angle = rate * t[:, None] + phase
    q = np.array([0.2, 0.4, -0.6, 0.3, 0.5, -0.2]) + (size * np.sin(angle)).sum(axis=0)
    dq, ddq = (size * rate * np.cos(angle)).sum(axis=0), -(size * rate**2 * np.sin(angle)).sum(axis=0)
    model = tilt_base(model, *tilt)
    load = model.torque(q, dq, ddq, np.where(np.arange(len(theta)) < 60, theta, 0.0))
    tau = gains * (model.torque(q, dq, ddq, theta) + by_load * np.abs(load) * np.sign(dq))
    tau = tau + NOISE * np.sqrt(np.mean(tau**2, axis=0)) * rng.standard_normal(tau.shape)
    return Log(t, q + 1e-6 * rng.standard_normal(q.shape), tau, tuple(x.name for x in model.joints), name)


def fit(log: Log) -> Identification:
    """The arm identified from a recording alone."""
    return identify(arm()[0], {log.source: log}, recipe=RECIPE)


@cache
def result(gain: float = 1.0) -> Identification:
    """The arm without a payload, identified from torques that are ``gain`` times the true ones."""
    return fit(recorded("arm", gains=gain))


@cache
def loaded_result(name: str = "loaded", gain: float = 1.0) -> Identification:
    """The arm with the payload, identified from a recording of this name."""
    return fit(recorded(name, CARRIED, gain))
