"""How fast distances can change at most: what proves a motion between the samples at which they are known."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dynident.models import RigidBodies

__all__ = ["reaches", "steepest"]

Array = NDArray[np.float64]
FARTHEST = 10.0  # m: the travel of a prismatic joint without limits


def reaches(bodies: RigidBodies, body: int, radius: float) -> Array:
    """Return by how much (m/rad, m/m) points of a body within ``radius`` (m) of its origin move at most with the
    position of each body (B) on which it stands, itself included; 0 for others.

    A point moves with a revolute joint by its distance from the axis, of which the lengths of the links between, and
    the travel of prismatic joints, are a bound.
    """
    every, out, far = bodies.arm.bodies, np.zeros(len(bodies.arm.bodies)), radius
    travel = _travel(bodies)
    at: int | None = body if body >= 0 else None
    while at is not None:
        slides = every[at].joint.kind == "prismatic"
        out[at] = 1.0 if slides else far
        far += float(np.linalg.norm(every[at].placement[:3, 3])) + (travel[at] if slides else 0.0)
        at = every[at].parent
    return out


def steepest(bodies: RigidBodies, moved: Array, pairs: Sequence[tuple[int, int]]) -> Array:
    """Return by how much (P, n) distances change at most with the joints, of ``pairs`` (P) of parts whose ``reaches``
    are ``moved`` (parts, B): a body that carries both moves them alike."""
    one, other = (moved[[pair[k] for pair in pairs]].reshape(-1, moved.shape[1]) for k in (0, 1))
    apart = np.where((one > 0) & (other > 0), 0.0, one + other)
    return np.asarray(apart @ np.abs(bodies.arm.drive))


def _travel(bodies: RigidBodies) -> Array:
    """Return how far (B) the bodies' positions are from 0 at most."""
    limits = [bodies.limits[joint.name] for joint in bodies.joints]
    ends = np.array([(one.lower, one.upper) for one in limits], dtype=float).reshape(-1, 2)
    most = np.where(np.isfinite(ends), np.abs(ends), FARTHEST).max(axis=1)
    return np.asarray(np.abs(bodies.arm.drive) @ most + np.abs(bodies.arm.rest))
