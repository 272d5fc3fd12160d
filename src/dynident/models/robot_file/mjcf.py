"""Reads a MuJoCo model (MJCF): bodies, joints, inertias, limits and nominal friction; shapes are ignored.

Reference: the XML reference of MuJoCo, https://mujoco.readthedocs.io/en/stable/XMLreference.html. A body's frame here
is at its joint's anchor, with the body's axes. Inertias that MuJoCo would compute from shapes are not known.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ModelError, choices
from dynident.models.inertia import from_physical, moved
from dynident.models.robot_file.mjcf_orientation import ANGULAR, ORIENTATIONS, orientation
from dynident.models.robot_file.xml import (
    Coupled,
    Limits,
    RobotFile,
    RobotJoint,
    Tied,
    corrected,
    known,
    motion,
    numbers,
    placement,
    unique,
    unit,
)

__all__ = ["read_mjcf"]

Array = NDArray[np.float64]
Attributes = Mapping[str, str]
WORLD = "world"
UNREAD = ("include", "attach", "replicate", "frame", "composite", "flexcomp", "plugin")
KINDS: dict[str, Literal["fixed", "revolute", "prismatic"]] = {
    "hinge": "revolute",
    "slide": "prismatic",
    "ball": "fixed",
    "free": "fixed",
}
ALTERED = ("balanceinertia", "boundmass", "boundinertia", "settotalmass", "inertiafromgeom")


@dataclass(frozen=True, eq=False)
class _Reader:
    """Settings of the whole file, and what has been read so far."""

    source: str
    compiler: Attributes
    classes: Mapping[str, Mapping[str, Attributes]]
    links: dict[str, Array | None] = field(default_factory=dict)
    joints: list[RobotJoint] = field(default_factory=list)
    origins: dict[str, Array] = field(default_factory=dict)

    @property
    def degrees(self) -> bool:
        return self.compiler.get("angle", "degree") == "degree"

    def body(self, element: Element, parent: str, shift: Array, inherited: str) -> None:
        """Read a body and those below it; ``shift`` (3) is the origin of the parent's link frame in its body frame."""
        name = element.get("name", "")
        where = f"{self.source}, body {name!r}"
        inherited = element.get("childclass", inherited)
        frame = self._frame(element.attrib, where)
        frame[:3, 3] -= shift
        given = [child for child in element if child.tag in ("joint", "freejoint")]
        if len(given) > 1:
            raise ModelError(
                f"{where}: it has {len(given)} joints; give each a body of its own, nested, so that each has its link."
            )
        anchor = np.zeros(3)
        if given:
            attributes = self._resolved(given[0], inherited)
            anchor = numbers(attributes, "pos", "0 0 0", where, 3)
            self.joints.append(self._joint(attributes, frame @ placement(np.eye(3), anchor), parent, name))
        else:
            still = RobotJoint(f"{name} (fixed)", "fixed", parent, name, frame, np.array([0.0, 0.0, 1.0]))
            self.joints.append(still)
        self.links[name], self.origins[name] = self._inertia(element, anchor, where), anchor
        for child in element.findall("body"):
            self.body(child, name, anchor, inherited)

    def _resolved(self, element: Element, inherited: str) -> dict[str, str]:
        """Return an element's attributes with those of its default class."""
        name = element.get("class", inherited)
        known(name, self.classes, f"{self.source}, <{element.tag}> {element.get('name')!r}", "default class")
        free = {"type": "free"} if element.tag == "freejoint" else {}
        return {**self.classes[name].get(element.tag, {}), **element.attrib, **free}

    def _frame(self, attributes: Attributes, where: str) -> Array:
        """Return the homogeneous matrix (4, 4) of an element's position and orientation."""
        given = [key for key in ORIENTATIONS if key in attributes]
        if len(given) > 1:
            raise ModelError(f"{where}: {' and '.join(given)} are both given; keep one orientation.")
        sequence = self.compiler.get("eulerseq", "xyz")
        turn = orientation(given[0], attributes, where, self.degrees, sequence) if given else np.eye(3)
        return placement(turn, numbers(attributes, "pos", "0 0 0", where, 3))

    def _inertia(self, body: Element, anchor: Array, where: str) -> Array | None:
        """Return the parameters (10) about the anchor; None where MuJoCo would compute them from shapes."""
        inertial, shapes = body.find("inertial"), body.find("geom") is not None
        if shapes and (inertial is None or self.compiler.get("inertiafromgeom") == "true"):
            return None
        if inertial is None:
            return np.zeros(10)
        if "fullinertia" in inertial.attrib:
            tensor = numbers(inertial, "fullinertia", "", where, 6)[[[0, 3, 4], [3, 1, 5], [4, 5, 2]]]
        else:
            tensor = np.diag(numbers(inertial, "diaginertia", "", where, 3))
        frame = self._frame(inertial.attrib, where)
        about_centre = frame[:3, :3] @ tensor @ frame[:3, :3].T
        theta = from_physical(
            numbers(inertial, "mass", "", where)[0], frame[:3, 3], (about_centre + about_centre.T) / 2
        )
        return moved(theta, placement(np.eye(3), -anchor))

    def _joint(self, attributes: Attributes, frame: Array, parent: str, child: str) -> RobotJoint:
        name, type_ = attributes.get("name", ""), attributes.get("type", "hinge")
        where = f"{self.source}, joint {name!r} of body {child!r}"
        if not name:
            raise ModelError(f"{where}: it has no name; give it one, because data are matched by name.")
        if type_ not in KINDS:
            raise ModelError(f"{where}: type {type_!r}; {choices(type_, KINDS)}")
        names = {"damping": "damping", "friction": "frictionloss", "armature": "armature"}
        scale = np.pi / 180 if self.degrees and type_ == "hinge" else 1.0
        refusal = f"it is a {type_} joint, which has several coordinates" if KINDS[type_] == "fixed" else ""
        stiffness = numbers(attributes, "stiffness", "0", where)[0]
        if stiffness:
            refusal = f"it has a spring (stiffness {stiffness:g}), which no term of the model describes; remove it"
        joint = RobotJoint(
            name=name,
            kind=KINDS[type_],
            parent=parent,
            child=child,
            placement=frame,
            axis=unit(numbers(attributes, "axis", "0 0 1", where, 3), where),
            limits=self._limits(attributes, scale, where),
            nominal={k: float(numbers(attributes, v, "0", where)[0]) for k, v in names.items() if v in attributes},
            refusal=refusal,
        )
        # the file shows the arm at q = ref, not at zero
        return _moved_back(joint, scale * float(numbers(attributes, "ref", "0", where)[0]))

    def _limits(self, attributes: Attributes, scale: float, where: str) -> Limits:
        def pair(limited: str, key: str, scale: float) -> tuple[float | None, float | None]:
            active = attributes.get(limited, "auto").replace("auto", self.compiler.get("autolimits", "true"))
            if active != "true" or key not in attributes:
                return None, None
            low, high = numbers(attributes, key, "", where, 2)
            return float(low * scale), float(high * scale)

        lower, upper = pair("limited", "range", scale)
        _, effort = pair("actuatorfrclimited", "actuatorfrcrange", 1.0)
        return Limits(effort=effort, lower=lower, upper=upper)


def read_mjcf(root: Element, source: str) -> RobotFile:
    """Parse the <mujoco> element.

    Raises ModelError for elements that change the dynamics and are not supported, joints or bodies without a name,
    duplicate names, bodies with several joints, and invalid attributes.
    """
    compiler = _merged(root, "compiler")
    _check_read(root, compiler, source)
    reader = _Reader(source, compiler, _classes(root))
    bodies = [body for world in root.findall("worldbody") for body in world.iter("body")]
    unique([WORLD, *(body.get("name", "") for body in bodies)], "body", source)
    reader.links[WORLD] = np.zeros(10)
    for world in root.findall("worldbody"):
        for body in world.findall("body"):
            reader.body(body, WORLD, np.zeros(3), world.get("childclass", "main"))
    unique((joint.name for joint in reader.joints), "joint", source)
    read = [body for body in bodies if body.get("name") in reader.links]
    return RobotFile(
        format="mjcf",
        source=source,
        root=WORLD,
        links=reader.links,
        joints=tuple(reader.joints),
        constraints=(*_equalities(root), *_tendons(root)),
        gravity=tuple(numbers(_merged(root, "option"), "gravity", "0 0 -9.81", f"{source}, <option>", 3).tolist()),
        notes=(*_notes(root, compiler), *(() if reader.degrees else _corrected(read))),
        origins=reader.origins,
    )


def _check_read(root: Element, compiler: Attributes, source: str) -> None:
    """Raise ModelError for elements that change the dynamics and are not supported."""
    for element in root.iter():
        if element.tag in UNREAD:
            raise ModelError(
                f"{source}: <{element.tag}> is not supported; save the compiled model from MuJoCo "
                "(mj_saveLastXML), which writes it out, and use that file."
            )
    if compiler.get("coordinate") == "global":
        raise ModelError(f"{source}: coordinate='global' is not supported; save the file again with a current MuJoCo.")


def _corrected(bodies: list[Element]) -> tuple[str, ...]:
    """Return a note on the angles in rad that are replaced by exact ones."""
    keys = ((body, key) for body in bodies for key in ANGULAR if key in body.attrib)
    last = {"euler": -3, "axisangle": -1}  # which numbers are angles
    pairs = ((repr(body.get("name", "")), " ".join(body.attrib[key].split()[last[key] :])) for body, key in keys)
    return corrected("euler, axisangle", pairs)


def _moved_back(joint: RobotJoint, reference: float) -> RobotJoint:
    return replace(joint, placement=joint.placement @ motion(joint, -reference)) if reference else joint


def _merged(root: Element, tag: str) -> dict[str, str]:
    """Return the attributes of all elements of that name, of which MuJoCo allows several."""
    return {key: value for element in root.findall(tag) for key, value in element.attrib.items()}


def _classes(root: Element) -> dict[str, dict[str, Attributes]]:
    """Return the attributes of each default class by element, with those of its parent classes."""
    found: dict[str, dict[str, Attributes]] = {"main": {}}

    def read(element: Element, name: str, outer: Mapping[str, Attributes]) -> None:
        own = {**outer, **found.get(name, {})}
        for child in element:
            if child.tag != "default":
                own[child.tag] = {**own.get(child.tag, {}), **child.attrib}
        found[name] = own
        for child in element.findall("default"):
            read(child, child.get("class", ""), own)

    for element in root.findall("default"):
        read(element, "main", {})
        if "class" in element.attrib:
            found[element.get("class", "")] = found["main"]
    return found


def _equalities(root: Element) -> Iterator[Coupled | Tied]:
    for element in (child for group in root.findall("equality") for child in group):
        what = f"<equality> <{element.tag}> {element.get('name', '')!r}"
        if element.get("active") == "false":
            continue
        if element.tag == "joint":
            yield Coupled(what, tuple(x for key in ("joint1", "joint2") if (x := element.get(key))))
        else:
            sited = "site1" in element.attrib or element.tag not in ("connect", "weld")
            yield Tied(what, (None, None) if sited else (element.get("body1"), element.get("body2", WORLD)))


def _tendons(root: Element) -> Iterator[Coupled]:
    for element in (child for group in root.findall("tendon") for child in group):
        joints = tuple(joint.get("joint", "") for joint in element.findall("joint"))
        yield Coupled(f"<tendon> <{element.tag}> {element.get('name', '')!r}", joints)


def _notes(root: Element, compiler: Attributes) -> Iterator[str]:
    """Yield notes on what of the file is ignored."""
    option = _merged(root, "option")
    for key in (one for one in ("density", "viscosity", "wind") if one in option):
        yield f"<option> {key} = {option[key]!r} is ignored"
    for altered in (one for one in ALTERED if one in compiler):
        yield f"<compiler> {altered} = {compiler[altered]!r} is not applied to the inertias"
    yield from _forces(root)


def _forces(root: Element) -> Iterator[str]:
    """Yield notes on forces on bodies that are ignored."""
    if lifted := [body.get("name", "") for body in root.iter("body") if body.get("gravcomp", "0").strip("0.")]:
        yield f"the gravity compensation of {', '.join(lifted)} is ignored"
    if spatial := [x.get("name", "") for group in root.findall("tendon") for x in group.findall("spatial")]:
        yield f"the spatial tendons {', '.join(map(repr, spatial))} are ignored"
