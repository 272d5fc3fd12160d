"""The joints of a gripper, told by the structure of a robot file: no motion of theirs shows the arm's parameters."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dynident.models import Model, RigidBodies
from dynident.models.robot_files import Arm
from dynident.runtime import Note, Severity, join_names

MAX_MASS_SHARE = 0.05  # of the moving mass, in all fingers together


class GripperLeftOut(Note):
    """The joints of a gripper, with the ``positions`` (rad or m) at which they are held, are left out of a motion."""

    severity = Severity.INFO
    positions: Mapping[str, float]

    def __str__(self) -> str:
        return (
            f"{join_names(self.positions)}: left out as joints of a gripper, light fingers side by side at the end of "
            "the arm, and held still. `grippers: true` exercises them like the arm."
        )


def find_gripper(model: Model) -> GripperLeftOut | None:
    """Return the joints of a gripper, held at zero or where their range begins; None where there is none.

    Fingers are side by side: two or more branches from one moving link (a mimic joint moves one, too) that weigh
    little together, or, where the file does not tell masses, of which all slide or mimic.
    """
    arm = next((term.arm for term in model.terms if isinstance(term, RigidBodies)), None)
    if arm is None:
        return None
    fingers = [place for palm in range(len(arm.bodies)) for place in _finger_bodies(arm, palm)]
    moves = arm.drive[sorted(set(fingers))].any(axis=0) & ~np.delete(arm.drive, fingers, axis=0).any(axis=0)
    names = [model.joints[k].name for k in np.flatnonzero(moves)]
    if not names or len(names) == len(model.joints):
        return None
    return GripperLeftOut({name: model.limits[name].nearest_to_zero for name in names})


def _finger_bodies(arm: Arm, palm: int) -> list[int]:
    """Return the bodies beyond a body, where all of them are fingers."""
    roots = [k for k, body in enumerate(arm.bodies) if body.parent == palm]
    fingers = list(roots)
    for k, body in enumerate(arm.bodies):  # a parent comes before its children
        if body.parent in fingers and k not in fingers:
            fingers.append(k)
    if len(roots) < 2:
        return []
    mass = np.array([body.theta[0] for body in arm.bodies])
    if np.isfinite(mass).all() and mass.sum() > 0:
        return fingers if mass[fingers].sum() <= MAX_MASS_SHARE * mass.sum() else []
    is_mimic = [k not in arm.driven for k in fingers]
    slides = [arm.bodies[k].joint.kind == "prismatic" for k in fingers]
    return fingers if all(np.logical_or(is_mimic, slides)) else []
