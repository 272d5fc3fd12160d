"""A small arm with a rail, and recordings of it, for tests of tuning."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from dynident.apps.tuning import Bench, Tuning
from dynident.identification import Recipe, identify
from dynident.models import Model, RigidBodies
from dynident.models.friction import Coulomb, Offset, Viscous
from dynident.motion.log import Log
from dynident.motion.smoothers import Spline
from tests.robots import ARM

BODIES = RigidBodies(ARM)
TERMS = (Viscous, Coulomb, Offset)
MODEL = Model((BODIES, *(part(BODIES.joints) for part in TERMS)), name="arm")
JOINTS = tuple(joint.name for joint in MODEL.joints)
THETA = np.array([0.4 if x.value is None else x.value for x in MODEL.parameters])
RATE = 200.0


def recording(seed: int, seconds: float = 5.0, name: str = "", model: Model = MODEL, theta: np.ndarray = THETA) -> Log:
    """Sums of sines with noise of positions and torques."""
    rng, n = np.random.default_rng(seed), len(model.joints)
    t = np.arange(round(seconds * RATE)) / RATE
    w, phase = 2 * np.pi * rng.uniform(0.2, 1.2, (3, n)), rng.uniform(0.0, 6.0, (3, n))
    size = rng.uniform(0.1, 0.3, (3, n))
    s, c = np.sin(w * t[:, None, None] + phase), np.cos(w * t[:, None, None] + phase)
    q, dq, ddq = (size * s).sum(axis=1), (size * w * c).sum(axis=1), -(size * w**2 * s).sum(axis=1)
    tau = model.torque(q, dq, ddq, theta) + 0.05 * rng.standard_normal(q.shape)
    names = tuple(joint.name for joint in model.joints)
    return Log(t, q + 2e-4 * rng.standard_normal(q.shape), tau, names, name or f"log {seed}")


def logs(*train: Log, held: tuple[Log, ...] = ()) -> dict[str, dict[str, Log]]:
    """Logs by role and name."""
    return {role: {x.source: x for x in some} for role, some in (("train", train), ("validation", held))}


def bench(
    given: Mapping[str, Mapping[str, Log]] | None = None, recipe: Recipe | None = None, model: Model = MODEL
) -> Bench:
    """The arm on the bench."""
    given = given or logs(recording(1), held=(recording(2),))
    result = identify(model, given["train"], given["validation"], recipe or Recipe(Spline(factor=1.5)))
    return Bench.of(model, given, result)


def with_terms(tuning: Tuning, joint: int, kinds: Sequence[str]) -> Tuning:
    """Return the tuning with the kinds of terms of a joint, by its index."""
    return replace(tuning, terms=(*tuning.terms[:joint], tuple(kinds), *tuning.terms[joint + 1 :]))
