"""Where a payload is mounted: a link of the robot file, and how ten parameters in its frame act on the moving body."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ModelError, brief, choices
from dynident.models import INERTIAL, Model, RigidBodies, moved
from dynident.models.robot_file import ArmBody

__all__ = ["Mount", "mount_of"]

Array = NDArray[np.float64]
FLANGES = ("flange", "tool0", "tcp")  # of ROS-Industrial (REP 199) and of many robot files, the first that there is


@dataclass(frozen=True, eq=False)
class Mount:
    """The ``frame``, a link of the robot file, on the moving ``body``; ``joint`` is the one that moves this.

    ``turn`` (p, 10) makes of ten parameters in the frame what they add to the parameters of the model.
    """

    frame: str
    body: str
    joint: str
    turn: Array

    __repr__ = brief


def mount_of(model: Model, frame: str | None = None) -> Mount:
    """Return where a payload is: on the link ``frame``, by default the flange of the last body, where a link of it is
    called so, else its first link.

    Raises ModelError where the model has no rigid bodies of a robot file, there is no such link, it does not move, or
    the arm has several ends and no frame is named.
    """
    bodies = next((term for term in model.terms if isinstance(term, RigidBodies)), None)
    if bodies is None:
        raise ModelError(f"{model.name}: has no links to carry a payload; identify with a URDF or MJCF.")
    links = {link: body for body in bodies.arm.chosen for link in body.links}
    if frame is None:
        frame = _flange(bodies)
    if frame not in links:
        if frame in bodies.arm.still:
            raise ModelError(f"the payload's frame {frame!r} does not move; {choices(frame, links)}")
        raise ModelError(f"the payload's frame {frame!r} is no link of {bodies.source}; {choices(frame, links)}")
    body = links[frame]
    placement = body.frames[body.links.index(frame)]
    columns = [k for k, one in enumerate(model.parameters) if one.body == body.name and one.role in INERTIAL]
    turn = np.zeros((len(model.parameters), 10))
    turn[columns] = moved(np.eye(10), placement).T
    return Mount(frame, body.name, body.joint.name, turn)


def _flange(bodies: RigidBodies) -> str:
    """Return the frame of the arm's end; ModelError where there are several ends."""
    every = bodies.arm.bodies
    parents = {body.parent for body in every}
    ends = [body for k, body in enumerate(every) if k not in parents and not body.massless]
    if len(ends) != 1:
        names = ", ".join(repr(body.name) for body in ends)
        raise ModelError(f"{bodies.source}: the arm has several ends ({names}); name the payload's frame.")
    return _named_flange(ends[0])


def _named_flange(body: ArmBody) -> str:
    """Return the link of a body that is called a flange, with or without a prefix, or the first."""
    for name in FLANGES:
        for link in body.links:
            if link.lower() == name or link.lower().endswith((f"_{name}", f"/{name}")):
                return link
    return body.name
