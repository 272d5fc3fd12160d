"""The tree of a robot file in the other format: an MJCF of a URDF, a URDF of an MJCF.

Frames, joints, limits, what joints follow and simple shapes are written with all their digits. Meshes are left out: a
file that names one that is not there cannot be loaded. What is identified is set afterwards, as in a file of its own.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import PurePath
from xml.sax.saxutils import quoteattr

import numpy as np

from dynident.models import RigidBodies
from dynident.models.robot_files import RobotJoint, Shape, ShapeKind
from dynident.runtime import count
from dynident.runtime.arrays import Array

WORLD = "world"  # the name that MuJoCo has for what does not move
JOINT_TAGS = {"revolute": "hinge", "prismatic": "slide"}
# a visual shape touches nothing
GEOM_ROLES = {"collision": 'group="3"', "visual": 'group="2" contype="0" conaffinity="0"'}
UNLIMITED_EFFORT = 1e6  # N m or N: a URDF needs a limit at each joint


def numbers_text(values: Iterable[float]) -> str:
    """Return numbers with all their digits, separated by spaces."""
    return " ".join(repr(float(value)) for value in values)


def element(tag: str, **attributes: object) -> str:
    """Return an empty element; texts are escaped, sequences of numbers written with all their digits."""
    words = [tag]
    for name, value in attributes.items():
        text = value if isinstance(value, str) else numbers_text(np.atleast_1d(np.asarray(value, dtype=float)))
        words.append(f"{name.rstrip('_')}={quoteattr(text)}")
    return f"<{' '.join(words)}/>"


def _model_name(bodies: RigidBodies) -> str:
    """Return the name of the file without what XML cannot hold or has to escape."""
    return re.sub(r"[^\w .+-]", "_", PurePath(bodies.source).stem)


def mjcf_of(bodies: RigidBodies) -> str:
    """Return the tree of a URDF as an MJCF without inertias: bodies are links, joints are at their origins."""
    lines = [
        f'<mujoco model="{_model_name(bodies)}">',
        # inertias are given: shapes must not add any
        '  <compiler angle="radian" autolimits="true" inertiafromgeom="false"/>',
        "  <worldbody>",
        *_body_lines(bodies),
        "  </worldbody>",
    ]
    followers = [
        "    " + element("joint", joint1=joint.name, joint2=leader, polycoef=(offset, factor, 0, 0, 0))
        for joint in bodies.file.joints
        if joint.follows
        for leader, factor, offset in (joint.follows,)
    ]
    lines += ["  <equality>", *followers, "  </equality>"] if followers else []
    return "\n".join([*lines, "</mujoco>", ""])


def _body_lines(bodies: RigidBodies) -> Iterator[str]:
    """Yield the bodies, each inside of its parent, depth first in the order of the file."""
    shapes, root = bodies.shapes, bodies.file.root
    todo: list[tuple[str, RobotJoint | None, int] | str] = [(root, None, 2)]
    while todo:
        entry = todo.pop()
        if isinstance(entry, str):
            yield entry
            continue
        link, joint, depth = entry
        indent = "  " * depth
        is_world = link == WORLD and joint is None
        if not is_world:
            yield f"{indent}<body name={quoteattr(link)}{'' if joint is None else ' ' + _place(joint.placement)}>"
            todo.append(f"{indent}</body>")
        if joint is not None and joint.kind != "fixed":
            yield f"{indent}  {_mjcf_joint(joint)}"
        roles = shapes.get(link)
        for role in GEOM_ROLES if roles is not None else ():
            simple = (
                shape for shape in getattr(roles, role) if shape.kind is not ShapeKind.MESH and min(shape.size) > 0
            )
            yield from (f"{indent}  {_geom(shape, role)}" for shape in simple)
        todo += [(x.child, x, depth + (not is_world)) for x in reversed(bodies.file.joints_below.get(link, ()))]


def _place(frame: Array) -> str:
    """Return position and orientation (w, x, y, z) of a frame (4, 4)."""
    from scipy.spatial.transform import Rotation  # slow to import

    turn = Rotation.from_matrix(frame[:3, :3]).as_quat(scalar_first=True)
    return f'pos="{numbers_text(frame[:3, 3])}" quat="{numbers_text(turn)}"'


def _mjcf_joint(joint: RobotJoint) -> str:
    attributes: dict[str, object] = {"name": joint.name, "type": JOINT_TAGS[joint.kind], "axis": joint.axis}
    limits = joint.limits
    if limits.lower is not None and limits.upper is not None and limits.lower < limits.upper:
        attributes["range"] = limits.lower, limits.upper
    if limits.effort:
        attributes["actuatorfrcrange"] = -limits.effort, limits.effort
    names = {"damping": "damping", "friction": "frictionloss", "armature": "armature"}
    return element("joint", **attributes, **{names[key]: value for key, value in joint.nominal.items()})


def _geom(shape: Shape, role: str) -> str:
    return f'<geom type="{shape.kind}" size="{numbers_text(shape.size)}" {_place(shape.frame)} {GEOM_ROLES[role]}/>'


def mesh_notes(bodies: RigidBodies) -> tuple[str, ...]:
    """Return a note on the meshes that the tree does not have."""
    counts = Counter(
        link
        for link, roles in bodies.shapes.items()
        for shape in (*roles.collision, *roles.visual)
        if shape.kind is ShapeKind.MESH
    )
    if not counts:
        return ()
    shapes, links = count(sum(counts.values()), "shape"), count(len(counts), "link")
    return (f"{shapes} of {links} left out, as meshes are not in the file; add those that you need",)


def urdf_of(bodies: RigidBodies) -> str:
    """Return the tree of an MJCF as a URDF without inertias.

    Link frames are at the anchors of the joints. A joint with several coordinates is fixed.
    """
    lines = [f'<robot name="{_model_name(bodies)}">']
    lines += [f"  {element('link', name=link)}" for link in bodies.file.links]
    for joint in bodies.file.joints:
        lines += [f"  {line}" for line in _urdf_joint(joint)]
    return "\n".join([*lines, "</robot>", ""])


def _urdf_joint(joint: RobotJoint) -> Iterator[str]:
    limits = joint.limits
    is_limited = limits.lower is not None and limits.upper is not None
    kind = "continuous" if joint.kind == "revolute" and not is_limited else joint.kind
    yield f'<joint name={quoteattr(joint.name)} type="{kind}">'
    yield f"  {element('origin', xyz=joint.placement[:3, 3], rpy=_roll_pitch_yaw(joint.placement))}"
    yield f"  {element('parent', link=joint.parent)}"
    yield f"  {element('child', link=joint.child)}"
    if kind != "fixed":
        yield f"  {element('axis', xyz=joint.axis)}"
        ends = {"lower": limits.lower, "upper": limits.upper} if is_limited else {}
        ends |= {"lower": -1e3, "upper": 1e3} if kind == "prismatic" and not is_limited else {}
        yield f"  {element('limit', **ends, effort=limits.effort or UNLIMITED_EFFORT, velocity=limits.velocity or 1e3)}"
    if kind != "fixed" and joint.follows:
        leader, factor, offset = joint.follows
        yield f"  {element('mimic', joint=leader, multiplier=factor, offset=offset)}"
    yield "</joint>"


def _roll_pitch_yaw(frame: Array) -> tuple[float, float, float]:
    """Return the angles (rad) of a frame (4, 4) about the fixed axes x, y, z; the last is 0 where only a sum counts."""
    R = frame[:3, :3]
    across = math.hypot(R[0, 0], R[1, 0])
    pitch = math.atan2(-R[2, 0], across)
    if across > 1e-9:
        return math.atan2(R[2, 1], R[2, 2]), pitch, math.atan2(R[1, 0], R[0, 0])
    return math.atan2(-R[1, 2], R[1, 1]), pitch, 0.0
