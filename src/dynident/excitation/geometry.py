"""The solid shapes of an arm, body by body: what its file says they are, or the places of its joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.models import RigidBodies
from dynident.models.robot_file import motion

__all__ = ["LinkPlace", "joint_places", "link_places"]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LinkPlace:
    """A link, the place of its body in ``Arm.bodies`` (-1: the root link), and its frame (4, 4) in that body's."""

    link: str
    body: int
    frame: Array

    __repr__ = brief


def link_places(bodies: RigidBodies) -> tuple[LinkPlace, ...]:
    """Return where all links of an arm are, those that stand still first."""
    arm = bodies.arm
    still = [LinkPlace(link, -1, frame) for link, frame in _standing(bodies).items()]
    moving = [
        LinkPlace(link, k, frame)
        for k, body in enumerate(arm.bodies)
        for link, frame in zip(body.links, body.frames, strict=True)
    ]
    return (*still, *moving)


def joint_places(bodies: RigidBodies, body: int) -> Array:
    """Return the origins (M, 3) in a body's frame of its links and of the joints that it carries."""
    own = [one.frame[:3, 3] for one in link_places(bodies) if one.body == body]
    carried = [one.placement[:3, 3] for one in bodies.arm.bodies if (-1 if one.parent is None else one.parent) == body]
    return np.array([*own, *carried]).reshape(-1, 3)


def _standing(bodies: RigidBodies) -> dict[str, Array]:
    """Return the frames (4, 4) of the links that stand still, in that of the root link."""
    file, arm = bodies.file, bodies.arm
    still, frames = set(arm.still), {file.root: np.eye(4)}
    todo = [file.root]
    while todo:
        link = todo.pop()
        for joint in file.joints:
            if joint.parent == link and joint.child in still:
                turned = motion(joint, arm.standing.get(joint.name, 0.0))
                frames[joint.child] = frames[link] @ joint.placement @ turned
                todo.append(joint.child)
    return frames
