"""A planar arm of two links in a vertical plane with friction, its limits, and a post that it must go around."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from dynident.apps.excitation import motion_limits
from dynident.apps.excitation.limits import Feasibility
from dynident.models import Model, RigidBodies
from dynident.models.friction import Coulomb, Offset, Viscous
from tests.robots import joint, link, urdf

LIMIT = '<limit effort="{}" velocity="{}" lower="-2.8" upper="2.8"/>'
TWO = urdf(
    link("base"),
    link("upper", 2.0, (0.2, 0.01, 0.0)),
    link("lower", 1.0, (0.15, 0.0, 0.02)),
    joint("lift", "revolute", "base", "upper", rpy=(1.5707963267948966, 0, 0), inside=LIMIT.format(40, 2)),
    joint("bend", "revolute", "upper", "lower", (0.4, 0, 0), inside=LIMIT.format(15, 3)),
)


def arm():
    bodies = RigidBodies(TWO, source="two.urdf")
    return Model((bodies, Viscous(bodies.joints), Coulomb(bodies.joints), Offset(bodies.joints)), name="two.urdf")


MODEL = arm()
THETA = np.array([*(p.value for p in MODEL.terms[0].parameters), 1.0, 0.4, 0.8, 0.3, 0.1, -0.1])
LIMITS = motion_limits(MODEL)


@dataclass(frozen=True)
class Post:
    """A post of a radius (m) at a place (x, z) in the plane of the arm, whose tip and elbow keep away from it."""

    x: float = 0.7
    z: float = 0.0
    radius: float = 0.1
    pairs = (("upper", "post"), ("lower", "post"))

    def distances(self, q):
        elbow = 0.4 * np.stack([np.cos(q[:, 0]), np.sin(q[:, 0])])
        tip = elbow + 0.35 * np.stack([np.cos(q.sum(axis=1)), np.sin(q.sum(axis=1))])
        return np.stack([np.hypot(x[0] - self.x, x[1] - self.z) - self.radius for x in (elbow, tip)], axis=1)


FREE = Feasibility(MODEL, THETA, LIMITS)
AROUND = Feasibility(MODEL, THETA, LIMITS, Post(), 0.02)


def smooth_and_at_rest(trajectory, limits=LIMITS):
    """q, dq, ddq are continuous where pieces meet, and the arm is at rest at both ends."""
    ends = [piece.course.states(np.array([0.0, piece.course.duration]))[:3] for piece in trajectory.pieces]
    for before, after in pairwise(ends):
        np.testing.assert_allclose(before[:, 1], after[:, 0], atol=1e-8)
    first_and_last = trajectory.states(np.array([0.0, trajectory.duration]))
    np.testing.assert_allclose(first_and_last[1:3], 0.0, atol=1e-8)
    return first_and_last[0]


def scaled(family, rng, limits=LIMITS, share=0.9):
    """Random coefficients (n, K) with which a family keeps the limits of position, velocity, acceleration and jerk."""
    guard = family.guard(200)
    x = rng.normal(size=(len(limits.joints), family.size))
    x[:, 0] = 0.0
    used = [np.abs(rows @ x.T).max(axis=0) / size for rows, size in zip(guard.rows, limits.sizes, strict=True)]
    x *= share * guard.share / np.max(used, axis=0)[:, None]
    x[:, 0] = limits.middle
    return x
