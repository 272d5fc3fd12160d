"""Reads an MJCF as MuJoCo compiles it: bodies, joints, inertias, limits, nominal friction and shapes.

A body's frame here is at the anchor of its last joint, with the body's axes; of several joints, each but the last moves
a massless link.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, Literal
from xml.etree.ElementTree import Element

import numpy as np

from dynident.models.inertia import change_frame
from dynident.models.robot_files.mjcf_compile import (
    ANGLES,
    WORLD,
    CompiledMjcf,
    compile_mjcf,
    elements_with_angles,
    exact,
    is_in_radians,
)
from dynident.models.robot_files.xml import (
    JointCoupling,
    LinkShapes,
    LinkTie,
    RobotFile,
    RobotJoint,
    RobotJointLimits,
    Shape,
    ShapeKind,
    check_unique,
    motion_matrix,
    note_exact_angles,
    placement,
)
from dynident.runtime import ModelError
from dynident.runtime.arrays import Array

JOINT_TYPES = ("free", "ball", "slide", "hinge")  # in MuJoCo's order, as those below
KINDS: dict[str, Literal["revolute", "prismatic"]] = {"hinge": "revolute", "slide": "prismatic"}
EQUALITIES = ("connect", "weld", "joint", "tendon", "flex", "flexvert", "flexstrain", "distance")
OBJECT_BODY, WRAP_JOINT = 1, 1
TENDON_FORCES = ("stiffness", "damping", "frictionloss", "armature")
SIZES = {ShapeKind.SPHERE: 1, ShapeKind.CAPSULE: 2, ShapeKind.ELLIPSOID: 3, ShapeKind.CYLINDER: 2, ShapeKind.BOX: 3}
GEOMS = dict(enumerate(SIZES, start=2))


def read_mjcf(root: Element, source: str) -> RobotFile:
    """Read the <mujoco> element.

    Raises ModelError where MuJoCo is not installed or refuses the model, for elements that change the dynamics and are
    not supported, joints without a name, and duplicate names.
    """
    notes = _note_exact_angles(root)
    compiled = compile_mjcf(root, source)
    model = compiled.model
    links: dict[str, Array | None] = {WORLD: np.zeros(10)}
    origins, joints, zeros = {}, [], {}
    below = {WORLD: np.eye(4)}  # the frames of the file in those of the links
    for k in range(1, model.nbody):
        name, link = model.body(k).name, model.body(model.body_parentid[k]).name
        frame, anchor = below[link] @ compiled.frame("body", k), np.zeros(3)
        indices = range(model.body_jntadr[k], model.body_jntadr[k] + model.body_jntnum[k])
        for index in indices:
            joint = _joint(compiled, index, name)
            child = name if index == indices[-1] else f"{name} by {joint.name}"
            # the joint's frame in the file is at the position that the file shows
            zeros[joint.name] = 0.0 if joint.free else float(model.qpos0[model.jnt_qposadr[index]])
            frame = frame @ placement(np.eye(3), model.jnt_pos[index] - anchor)
            frame = frame @ motion_matrix(joint, -zeros[joint.name])
            joints.append(replace(joint, parent=link, child=child, placement=frame))
            # several joints of a body move one after the other: massless links connect them
            if child != name:
                links[child], link, frame = np.zeros(10), child, np.eye(4)
            anchor = model.jnt_pos[index]
        if not indices:
            joints.append(RobotJoint(f"{name} (fixed)", "fixed", link, name, frame, np.array([0.0, 0.0, 1.0])))
        below[name], theta = placement(np.eye(3), -anchor), compiled.inertias[name]
        links[name], origins[name] = None if theta is None else change_frame(theta, below[name]), np.array(anchor)
    check_unique((joint.name for joint in joints), "joint", source)
    followers = _followers(compiled, zeros)
    return RobotFile(
        format="mjcf",
        source=source,
        root=WORLD,
        links=links,
        joints=tuple(replace(joint, follows=followers.get(joint.name)) for joint in joints),
        constraints=(*_equalities(compiled), *_tendons(compiled)),
        gravity=tuple(compiled.spec.option.gravity.tolist()),
        notes=(*_note_ignored_forces(compiled), *notes),
        origins=origins,
        massless=tuple(name for name in links if name not in origins and name != WORLD),
    )


def _joint(compiled: CompiledMjcf, k: int, body: str) -> RobotJoint:
    """Return the k-th joint without its links and placement."""
    model, type_ = compiled.model, JOINT_TYPES[compiled.model.jnt_type[k]]
    free = type_ not in KINDS
    name = compiled.joint(k) or (f"{body} ({type_})" if free else "")
    if not name:
        raise ModelError(
            f"{compiled.source}, joint {name!r} of body {body!r}: it has no name; give it one, because data are "
            "matched by name."
        )
    refusal = f"it is a {type_} joint, which has several coordinates" if free else ""
    if k in compiled.springs:
        refusal = f"it has a spring ({compiled.springs[k]}), which no term of the model describes"
    lower, upper = model.jnt_range[k].tolist() if model.jnt_limited[k] and not free else (None, None)
    effort = float(model.jnt_actfrcrange[k, 1]) if model.jnt_actfrclimited[k] else None
    at = model.jnt_dofadr[k]
    values = {"damping": model.dof_damping, "friction": model.dof_frictionloss, "armature": model.dof_armature}
    return RobotJoint(
        name=name,
        kind=KINDS.get(type_, "fixed"),
        parent="",
        child="",
        placement=np.eye(4),
        axis=np.array(model.jnt_axis[k]),
        limits=RobotJointLimits(effort=effort, lower=lower, upper=upper),
        nominal={key: float(value[at]) for key, value in values.items() if value[at]},
        refusal=refusal,
        free=free,
    )


def _note_exact_angles(root: Element) -> tuple[str, ...]:
    """Return a note on the angles (rad) of bodies and frames that are replaced by exact ones."""
    if not is_in_radians(root):
        return ()
    pairs = (
        (repr(element.get("name", "")), word)
        for element, key in elements_with_angles(root)
        if element.tag in ("body", "frame")
        for word in element.attrib[key].split()[ANGLES[key] :]
        if isinstance(exact(word), float)
    )
    return note_exact_angles("euler, axisangle", pairs)


def _linear_equalities(model: Any) -> dict[int, int]:
    """Return, for each joint that follows another by an equality without powers, the first such equality."""
    first: dict[int, int] = {}
    for k in np.flatnonzero(model.eq_active0):
        if EQUALITIES[model.eq_type[k]] == "joint" and model.eq_obj2id[k] >= 0 and not model.eq_data[k, 2:5].any():
            first.setdefault(int(model.eq_obj1id[k]), int(k))
    return first


def _followers(compiled: CompiledMjcf, zeros: Mapping[str, float]) -> dict[str, tuple[str, float, float]]:
    """Return what joints follow, by their names; ``zeros`` (rad, m) are where the file shows the joints."""
    model, followers = compiled.model, {}
    for joint, k in _linear_equalities(model).items():
        follower, master = compiled.joint(joint), compiled.joint(model.eq_obj2id[k])
        # MuJoCo's polynomial is of positions from those in which the file shows the joints
        constant, slope = model.eq_data[k, :2].tolist()
        followers[follower] = master, slope, constant + zeros[follower] - slope * zeros[master]
    return followers


def _equalities(compiled: CompiledMjcf) -> Iterator[JointCoupling | LinkTie]:
    """Yield the equalities but for those by which a joint follows another."""
    model, linear = compiled.model, _linear_equalities(compiled.model).values()
    for k in (k for k in np.flatnonzero(model.eq_active0) if k not in linear):
        type_ = EQUALITIES[model.eq_type[k]]
        description = f"<equality> <{type_}> {model.eq(k).name!r}"
        ends = [int(end) for end in (model.eq_obj1id[k], model.eq_obj2id[k]) if end >= 0]
        tendons = [_tendon_joints(compiled, end) for end in ends] if type_ == "tendon" else []
        if type_ == "joint":
            yield JointCoupling(description, tuple(compiled.joint(end) for end in ends))
        elif tendons and all(tendons):
            yield JointCoupling(description, tuple(joint for joints in tendons for joint in joints))
        elif type_ in ("connect", "weld") and model.eq_objtype[k] == OBJECT_BODY:
            yield LinkTie(description, (model.body(ends[0]).name, model.body(ends[1]).name))
        else:
            # sites may be on any link: the ends of such a constraint are not known
            yield LinkTie(description, (None, None))


def _tendon_joints(compiled: CompiledMjcf, k: int) -> tuple[str, ...]:
    """Return the joints of the k-th tendon; none where it is spatial."""
    model = compiled.model
    path = slice(model.tendon_adr[k], model.tendon_adr[k] + model.tendon_num[k])
    is_fixed = (model.wrap_type[path] == WRAP_JOINT).all()
    return tuple(compiled.joint(joint) for joint in model.wrap_objid[path]) if is_fixed else ()


def _tendons(compiled: CompiledMjcf) -> Iterator[JointCoupling]:
    """Yield the tendons of joints that apply a force; one that is only measured couples nothing."""
    model = compiled.model
    for k in range(model.ntendon):
        has_force = any(getattr(model, f"tendon_{key}")[k] for key in TENDON_FORCES)
        if has_force and (joints := _tendon_joints(compiled, k)):
            yield JointCoupling(f"<tendon> <fixed> {model.tendon(k).name!r}", joints)


def _note_ignored_forces(compiled: CompiledMjcf) -> Iterator[str]:
    """Yield notes on forces of the file that are not read."""
    model = compiled.model
    for key in ("density", "viscosity", "wind"):
        if (values := np.array(getattr(compiled.spec.option, key), ndmin=1)).any():
            yield f"<option> {key} = {' '.join(f'{x:g}' for x in values)!r} is ignored"
    if lifted := [model.body(k).name for k in np.flatnonzero(model.body_gravcomp)]:
        yield f"the gravity compensation of {', '.join(lifted)} is ignored"
    if spatial := [model.tendon(k).name for k in range(model.ntendon) if not _tendon_joints(compiled, k)]:
        yield f"the spatial tendons {', '.join(map(repr, spatial))} are ignored"


def mjcf_shapes(root: Element, source: str, origins: Mapping[str, Array]) -> dict[str, LinkShapes]:
    """Return the shapes of each body of a <mujoco> element, in the frames of the links (``RobotFile.origins``).

    Planes and height fields are left out. Raises ModelError as ``read_mjcf`` does.
    """
    compiled = compile_mjcf(root, source)
    model = compiled.model
    shapes: list[tuple[list[Shape], list[Shape]]] = [([], []) for _ in range(model.nbody)]
    for k in range(model.ngeom):
        body = model.geom_bodyid[k]
        back = placement(np.eye(3), -origins.get(model.body(body).name, np.zeros(3)))
        kind = GEOMS.get(int(model.geom_type[k]))
        shape = compiled.meshes.get(k)
        if shape is None and kind is not None:
            shape = Shape(kind, tuple(model.geom_size[k, : SIZES[kind]].tolist()), np.eye(4))
        # shapes that collide with nothing are only shown
        is_visual = not (model.geom_contype[k] or model.geom_conaffinity[k])
        if shape is not None:
            shapes[body][is_visual].append(replace(shape, frame=back @ compiled.frame("geom", k)))
    return {model.body(k).name: LinkShapes(*map(tuple, pair)) for k, pair in enumerate(shapes)}
