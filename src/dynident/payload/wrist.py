"""Which motion of a single joint would show a component of the payload that a recording does not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.models import Model
from dynident.payload.body import slopes
from dynident.payload.mount import Mount

__all__ = ["Turning", "turnings"]

Array = NDArray[np.float64]
DURATION, SAMPLES = 10.0, 60  # s of a motion, and samples of a period of it that are looked at
POSES = 4  # postures of the arm in which a joint turns
REACH, SPEED, SHARE = 0.8, 1.5, 0.7  # rad (m); rad/s (m/s); of the limits
SLIDE = 0.3  # a sliding joint moves less far, in m


@dataclass(frozen=True, eq=False)
class Turning:
    """A ``joint`` that turns back and forth at up to ``speed``, and the standard errors (10) of the payload after."""

    joint: str
    speed: float
    std: Array

    __repr__ = brief


def turnings(
    model: Model, mount: Mount, phi: Array, information: Array, variance: Array, poses: Array
) -> tuple[Turning, ...]:
    """Return for each joint that moves the payload what turning it alone would show, in the best of a few ``poses``.

    ``information`` (10, 10) is on phi (10), the parameters in the frame of the payload; ``variance`` (n) of a joint's
    torque over a second of motion. Friction is taken as known.
    """
    columns = np.flatnonzero(mount.turn.any(axis=1))
    moving = np.flatnonzero(model.support[:, columns].any(axis=1))
    J, found = slopes(phi), []
    for j in moving:
        speed, reach = _within(model, int(j))
        best = np.full(10, np.inf)
        for pose in poses[np.linspace(0, len(poses) - 1, POSES).astype(int)]:
            more = _shown(model, mount, _centred(model, int(j), pose, reach), (int(j), speed, reach), variance)
            covariance = J @ np.linalg.inv(information + DURATION * more) @ J.T
            best = np.minimum(best, np.sqrt(np.diag(covariance)))
        found.append(Turning(model.joints[j].name, speed, best))
    return tuple(found)


def best_of(several: Sequence[Turning], component: int) -> Turning:
    """Return the one that shows a component best; of joints that do about as well the last, nearest to the payload."""
    least = min(one.std[component] for one in several)
    return [one for one in several if one.std[component] <= 1.2 * least][-1]


def _within(model: Model, j: int) -> tuple[float, float]:
    """Return speed and reach of a joint's motion, within its limits where these are known."""
    joint, limit = model.joints[j], model.limits.get(model.joints[j].name)
    reach, speed = (SLIDE * REACH, SLIDE * SPEED) if joint.kind == "prismatic" else (REACH, SPEED)
    if limit is not None and limit.velocity:
        speed = min(speed, SHARE * limit.velocity)
    return speed, reach


def _centred(model: Model, j: int, pose: Array, reach: float) -> Array:
    """Return a pose (n) about which a joint can turn by ``reach`` without leaving its limits, as far as these allow."""
    limit, out = model.limits.get(model.joints[j].name), pose.copy()
    if limit is not None and limit.lower is not None and limit.upper is not None:
        room = min(reach, (limit.upper - limit.lower) / 2)
        out[j] = np.clip(pose[j], limit.lower + room, limit.upper - room)
    return out


def _shown(model: Model, mount: Mount, pose: Array, motion: tuple[int, float, float], variance: Array) -> Array:
    """Return the information (10, 10) on the payload by a second of a joint's motion about a pose (n)."""
    j, speed, reach = motion
    angle = np.linspace(0, 2 * np.pi, SAMPLES, endpoint=False)
    q, dq, ddq = np.tile(pose, (SAMPLES, 1)), *np.zeros((2, SAMPLES, len(pose)))
    q[:, j] += reach * np.sin(angle)
    dq[:, j], ddq[:, j] = speed * np.cos(angle), -(speed**2) / reach * np.sin(angle)
    columns = np.flatnonzero(mount.turn.any(axis=1))
    alone = model.bodies
    place = {name: k for k, name in enumerate(alone.names)}
    Y = alone.regressor(q, dq, ddq)[:, :, [place[model.names[k]] for k in columns]] @ mount.turn[columns]
    return np.asarray(np.einsum("tji,tjk,j->ik", Y, Y, 1.0 / variance)) / SAMPLES
