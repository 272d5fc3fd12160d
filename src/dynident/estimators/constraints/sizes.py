"""The usual size of a body whose mass and inertia the robot file does not say: from the torques and the geometry."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dynident.estimators.constraints.constraints import LENGTH, BodyConstraint
from dynident.models import Parameter
from dynident.regression import TriangularFactors

__all__ = ["sized"]

Array = NDArray[np.float64]
SHORTEST = 0.1  # of the longest lever arm: the length of a body whose joints meet in a point
LIGHTEST = 1e-3  # of the heaviest body
TINY = 1e-9  # of the largest column: rounding
PLAUSIBLE = (1e-3, 30.0)  # nominal mass over that from the torques, where it is right: wrists move friction, not mass
KINDS = (slice(0, 1), slice(1, 4), slice(4, 10))  # mass, first and second moments


def sized(
    bodies: Sequence[BodyConstraint], parameters: Sequence[Parameter], triangular: TriangularFactors
) -> tuple[BodyConstraint, ...]:
    """Return the bodies, those without nominal mass or inertia with the size that torques and geometry give them.

    In each joint's equation, the column of a body's mass is as many times those of its first moments as the origin of
    the body is away from the joint's axis: its lever arm (m). The length of a body is the distance of the next one that
    these show, for the last one that of the one before. The mass is the largest that no joint's torque is too small
    for, alone and at its origin or this length from it. Nominal values far from it count as not known.
    """
    torque = np.linalg.norm(triangular.factors[:, :, -1], axis=1)
    effect = np.linalg.norm(triangular.factors[:, :, :-1], axis=1)
    effects = np.stack([effect[:, body.columns] for body in bodies]) if bodies else np.zeros((0, len(effect), 10))
    if not effects.any() or not torque.any():
        return tuple(bodies)
    mass, first, second = (np.transpose(effects[..., part].max(axis=2)) for part in KINDS)
    acts = np.logical_or.reduce([part > TINY * part.max() for part in (mass, first, second)])
    length = _lengths(np.where(first > TINY * first.max(), mass / np.where(first > 0, first, 1.0), 0.0), acts)
    arm = np.maximum.reduce([mass, first * length, second * length**2])  # N m/kg
    most = np.where(acts & (torque > 0)[:, None], torque[:, None] / np.where(acts, arm, 1.0), np.inf).min(axis=0)
    if not np.isfinite(most).any():
        return tuple(bodies)
    most[~np.isfinite(most)] = most[np.isfinite(most)].max()
    lifted = acts.any(axis=0) & (first > TINY * first.max()).any(axis=0)
    if lifted.any():  # of the others only the inertia about an axis is seen, behind that of all they carry
        most = np.where(lifted, most, np.minimum(most, most[lifted].max()))
    most = np.maximum(most, LIGHTEST * most.max())
    return tuple(_resized(body, parameters, *one) for body, *one in zip(bodies, most, length, strict=True))


def _resized(body: BodyConstraint, parameters: Sequence[Parameter], most: float, length: float) -> BodyConstraint:
    """Return the body, of this mass and length unless its nominal values are known and plausible beside them."""
    nominal = np.array([parameters[k].value or 0.0 for k in body.columns])
    likely = PLAUSIBLE[0] * most < nominal[0] < PLAUSIBLE[1] * most
    if likely and nominal[[4, 6, 9]].sum() > 0:
        return body
    mass = nominal[0] if likely else most
    return replace(body, size=np.sqrt(mass) * np.array([length, length, length, 1.0]))


def _lengths(lever: Array, acts: NDArray[np.bool_]) -> Array:
    """Return the length (K) of each body from the lever arms (n, K) of all about the joints that move them."""
    longest = float(lever.max())
    if not longest > 0:  # one joint, or joints that meet in a point
        return np.full(lever.shape[1], LENGTH)
    joints = acts.sum(axis=0)  # the more of them move a body, the further out it is
    apart = np.zeros((lever.shape[1],) * 2)  # of the origins of two bodies, as far as a common joint shows it
    for k, b in np.argwhere((joints[:, None] + 1 == joints) & (joints[:, None] > 0)):
        if (acts[:, b] >= acts[:, k]).all():
            apart[k, b] = np.abs(lever[:, b] - lever[:, k])[acts[:, k]].max()
    outward, inward = apart.max(axis=1), apart.max(axis=0)
    return np.asarray(np.maximum(np.where(outward > 0, outward, inward), SHORTEST * longest))
