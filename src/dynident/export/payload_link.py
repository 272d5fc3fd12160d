"""A payload as a link of its own in a URDF, fixed to the link that carries it."""

from __future__ import annotations

from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ModelError
from dynident.export.edit import Text
from dynident.export.urdf import TENSOR, numbers_text
from dynident.models import RigidBodies

__all__ = ["check_payload_link", "with_payload_link"]

Array = NDArray[np.float64]
NAME = "payload"
SAME = 1e-6  # largest difference of the torque, relative


def with_payload_link(xml: str, frame: str, mass: float, centre: Array, tensor: Array) -> str:
    """Return a URDF with a further link of ``mass`` (kg), ``centre`` of mass (3) in m and ``tensor`` (3, 3) in kg m^2
    about this, both in the ``frame`` of the link to which a fixed joint ties it; all else is preserved byte by byte.

    Raises ModelError where the text is no URDF or has no such link.
    """
    text = Text(xml)
    links = {node.attributes.get("name", "") for node in text.root.children if node.tag == "link"}
    joints = {node.attributes.get("name", "") for node in text.root.children if node.tag == "joint"}
    if text.root.tag != "robot":
        raise ModelError("a payload is written into a URDF; this robot file is an MJCF.")
    if frame not in links:
        raise ModelError(f"the payload's frame {frame!r} is no link of the URDF.")
    name = next(one for one in (NAME, *(f"{NAME}_{k}" for k in range(2, 1000))) if one not in links)
    joint = next(one for one in (f"{name}_joint", *(f"{name}_joint_{k}" for k in range(2, 1000))) if one not in joints)
    values = " ".join(f'{key}="{float(tensor[place])!r}"' for key, place in TENSOR.items())
    lines = (
        f'<link name="{name}">',
        "  <inertial>",
        f'    <origin xyz="{numbers_text(centre)}"/>',
        f'    <mass value="{float(mass)!r}"/>',
        f"    <inertia {values}/>",
        "  </inertial>",
        "</link>",
        f'<joint name="{joint}" type="fixed">',
        f"  <parent link={quoteattr(frame)}/>",
        f'  <child link="{name}"/>',
        "</joint>",
    )
    text.insert(text.root, *lines)
    return str(text)


def check_payload_link(before: str, after: str, bodies: RigidBodies, added: Array) -> float:
    """Return the largest difference, relative, of what a payload adds to the torque of a URDF from what ``added`` (p)
    adds to the parameters of its ``bodies``; ModelError where it is more than rounding."""
    q, dq, ddq = np.random.default_rng(0).uniform(-3, 3, (3, 100, len(bodies.joints)))
    torques = []
    for text in (before, after):
        arm = RigidBodies(text, bodies.joints_used, bodies.locked, bodies.gravity, bodies.source, bodies.displacements)
        torques.append(arm.torque(q, dq, ddq, np.array([one.value or 0.0 for one in arm.parameters])))
    expected = bodies.torque(q, dq, ddq, added)
    error = float(np.abs(torques[1] - torques[0] - expected).max() / (np.abs(expected).max() or 1.0))
    if not error < SAME:
        raise ModelError(f"the URDF with the payload, loaded again, has another torque (by {100 * error:.2g} %).")
    return error
