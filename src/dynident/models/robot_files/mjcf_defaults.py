"""What holds for a whole MJCF: the settings of its compiler, its default classes, and the frames that these turn."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from dynident.models.robot_files.xml import (
    JointCoupling,
    LinkTie,
    RobotJoint,
    angles,
    check_known,
    numbers,
    placement,
    rotation,
    unit_vector,
)
from dynident.runtime import ModelError

Array = NDArray[np.float64]
ORIENTATIONS = {"quat": 4, "axisangle": 4, "euler": 3, "xyaxes": 6, "zaxis": 3}  # with the count of their numbers
ANGULAR = ("euler", "axisangle")
UP = np.array([0.0, 0.0, 1.0])


def orientation(key: str, attributes: Mapping[str, str], where: str, degrees: bool, sequence: str) -> Array:
    """Return the rotation (3, 3) that the attribute ``key`` gives; ModelError, led by ``where``, if it is none.

    Angles are in ``degrees`` or rad; ``sequence`` is the ``eulerseq`` of the file.
    """
    values = numbers(attributes, key, "", where, ORIENTATIONS[key])
    if key in ANGULAR:
        turns = np.deg2rad(values) if degrees else angles(attributes, key, "", where, ORIENTATIONS[key])
        return _euler(turns, where, sequence) if key == "euler" else rotation(unit_vector(values[:3], where), turns[3])
    if key == "quat":
        return _quat(values, where)
    if key == "xyaxes":
        x = unit_vector(values[:3], where)
        # y only gives the plane: make it perpendicular to x
        y = unit_vector(values[3:] - (values[3:] @ x) * x, where)
        return np.column_stack([x, y, np.cross(x, y)])
    return rotation_from_z(unit_vector(values, where))


def _quat(values: Array, where: str) -> Array:
    half = float(np.linalg.norm(values[1:]))
    if not values.any():
        raise ModelError(f"{where}: quat is zero; write '1 0 0 0' for no rotation.")
    return rotation(values[1:] / half if half else UP, 2 * float(np.arctan2(half, values[0])))


def rotation_from_z(z: Array) -> Array:
    """Return the shortest rotation (3, 3) that takes the z axis to the unit vector ``z`` (3)."""
    sine = np.cross(UP, z)
    size = float(np.linalg.norm(sine))
    return rotation(sine / size if size else np.array([1.0, 0.0, 0.0]), float(np.arctan2(size, z[2])))


def _euler(turns: Array, where: str, sequence: str) -> Array:
    """Return the rotation (3, 3); lower-case axes of ``eulerseq`` turn with the body, upper-case ones do not."""
    if len(sequence) != 3 or set(sequence.lower()) - set("xyz"):
        raise ModelError(f"{where}: eulerseq = {sequence!r}; give three of x, y, z, or X, Y, Z.")
    out = np.eye(3)
    for letter, angle in zip(sequence, turns, strict=True):
        turn = rotation(np.eye(3)["xyz".index(letter.lower())], angle)
        out = out @ turn if letter.islower() else turn @ out
    return out


Attributes = Mapping[str, str]


@dataclass(frozen=True, eq=False)
class Defaults:
    """Settings of the compiler, and the attributes of each default class by element; ``source`` names the file."""

    source: str
    compiler: Attributes
    classes: Mapping[str, Mapping[str, Attributes]]

    @property
    def degrees(self) -> bool:
        """Whether the file gives angles in degrees."""
        return self.compiler.get("angle", "degree") == "degree"

    def resolve(self, element: Element, inherited: str, tag: str = "") -> dict[str, str]:
        """Return an element's attributes with those of its class, else of the ``inherited`` one.

        ``tag`` is the element's name in the classes, where it is another one. Raises ModelError for an unknown class.
        """
        name = element.get("class", inherited)
        check_known(name, self.classes, f"{self.source}, <{element.tag}> {element.get('name')!r}", "default class")
        # a freejoint is a joint of type free
        free = {"type": "free"} if element.tag == "freejoint" else {}
        return {**self.classes[name].get(tag or element.tag, {}), **element.attrib, **free}

    def frame(self, attributes: Attributes, where: str) -> Array:
        """Return the homogeneous matrix (4, 4) of an element's position and orientation; ModelError for two of them."""
        orientation_keys = [key for key in ORIENTATIONS if key in attributes]
        if len(orientation_keys) > 1:
            raise ModelError(f"{where}: {' and '.join(orientation_keys)} are both given; keep one orientation.")
        sequence = self.compiler.get("eulerseq", "xyz")
        turn = (
            orientation(orientation_keys[0], attributes, where, self.degrees, sequence)
            if orientation_keys
            else np.eye(3)
        )
        return placement(turn, numbers(attributes, "pos", "0 0 0", where, 3))

    def inside(self, element: Element, inherited: str, where: str) -> Iterator[tuple[Element, str, Array]]:
        """Yield the elements of a body with their inherited class and the frame (4, 4) that they are given in.

        ``<frame>`` is a placement of its elements, which belong to the body.
        """
        yield from self._unwrap_frames(element, inherited, np.eye(4), where)

    def _unwrap_frames(
        self, element: Element, inherited: str, above: Array, where: str
    ) -> Iterator[tuple[Element, str, Array]]:
        for child in element:
            if child.tag == "frame":
                child_frame = above @ self.frame(child.attrib, f"{where}, <frame>")
                yield from self._unwrap_frames(child, child.get("childclass", inherited), child_frame, where)
            else:
                yield child, inherited, above


def read_defaults(root: Element, source: str) -> Defaults:
    """Return what holds for the whole file."""
    return Defaults(source, merge_attributes(root, "compiler"), _classes(root))


def merge_attributes(root: Element, tag: str) -> dict[str, str]:
    """Return the attributes of all elements of that name, of which MuJoCo allows several."""
    return {key: value for element in root.findall(tag) for key, value in element.attrib.items()}


def _classes(root: Element) -> dict[str, dict[str, Attributes]]:
    """Return the attributes of each default class by element, with those of its parent classes."""
    classes: dict[str, dict[str, Attributes]] = {"main": {}}

    def read(element: Element, name: str, outer: Mapping[str, Attributes]) -> None:
        """Add a class with the attributes of the one around it, and those inside it."""
        # a class begins with what the class around it sets
        attributes = {**outer, **classes.get(name, {})}
        for child in element:
            if child.tag != "default":
                attributes[child.tag] = {**attributes.get(child.tag, {}), **child.attrib}
        classes[name] = attributes
        for child in element.findall("default"):
            read(child, child.get("class", ""), attributes)

    for element in root.findall("default"):
        # the outermost class is "main", and may have another name besides
        read(element, "main", {})
        if "class" in element.attrib:
            classes[element.get("class", "")] = classes["main"]
    return classes


LINEAR = "0 1 0 0 0"  # of a joint's polynomial, by default
FORCES = ("stiffness", "damping", "frictionloss", "armature")  # of a tendon
WORLD = "world"


def read_constraints(root: Element, defaults: Defaults) -> tuple[JointCoupling | LinkTie, ...]:
    """Return the constraints of the file, but for those that make a joint follow another (``add_followers``).

    A tendon that is only measured is none. Raises ModelError for invalid numbers.
    """
    fixed = {tendon.get("name", ""): _joints(tendon) for tendon in _members(root, "tendon") if tendon.tag == "fixed"}
    return (*_equalities(root, defaults, fixed), *_tendons(root, defaults))


def add_followers(
    root: Element, defaults: Defaults, joints: Sequence[RobotJoint], zeros: Mapping[str, float]
) -> tuple[RobotJoint, ...]:
    """Return the joints, with those that an equality makes a linear function of another as followers of it.

    ``zeros`` are the positions (rad, m) in which the file shows its joints. Raises ModelError for an unknown
    joint.
    """
    joints_by_name = {joint.name: joint for joint in joints}
    for element, follower, master in _linear(root, defaults):
        where = f"{defaults.source}, <equality> <joint> {element.get('name', '')!r}"
        for name in (follower, master):
            check_known(name, joints_by_name, where)
        # MuJoCo's polynomial is of positions from those in which the file shows the joints
        constant, slope = _polynomial(element, defaults)[:2].tolist()
        offset = constant + zeros[follower] - slope * zeros[master]
        joints_by_name[follower] = replace(joints_by_name[follower], follows=(master, slope, offset))
    return tuple(joints_by_name.values())


def _active(element: Element, defaults: Defaults) -> bool:
    return defaults.resolve(element, "main", "equality").get("active", "true") != "false"


def _polynomial(element: Element, defaults: Defaults) -> Array:
    words = element.get("polycoef", "").split()
    filled = " ".join([*words, *LINEAR.split()[len(words) :]])
    return numbers({"polycoef": filled}, "polycoef", LINEAR, f"{defaults.source}, <equality> <joint>", 5)


def _linear(root: Element, defaults: Defaults) -> Iterator[tuple[Element, str, str]]:
    """Yield the equalities of two joints without powers, with their joints, the first of each joint that follows."""
    followers: set[str] = set()
    for element in _members(root, "equality"):
        follower, master = element.get("joint1", ""), element.get("joint2", "")
        if element.tag != "joint" or not master or follower in followers or not _active(element, defaults):
            continue
        if not _polynomial(element, defaults)[2:].any():
            followers.add(follower)
            yield element, follower, master


def _members(root: Element, tag: str) -> Iterator[Element]:
    return (child for group in root.findall(tag) for child in group)


def _joints(tendon: Element) -> tuple[str, ...]:
    return tuple(joint.get("joint", "") for joint in tendon.findall("joint"))


def _equalities(
    root: Element, defaults: Defaults, fixed: Mapping[str, tuple[str, ...]]
) -> Iterator[JointCoupling | LinkTie]:
    linear = {id(element) for element, _, _ in _linear(root, defaults)}
    for element in _members(root, "equality"):
        description = f"<equality> <{element.tag}> {element.get('name', '')!r}"
        if not _active(element, defaults) or id(element) in linear:
            continue
        ends = [end for key in ("1", "2") if (end := element.get(element.tag + key))]
        if element.tag == "joint":
            yield JointCoupling(description, tuple(ends))
        elif element.tag == "tendon" and all(end in fixed for end in ends):
            yield JointCoupling(description, tuple(joint for end in ends for joint in fixed[end]))
        else:
            # sites may be on any link: the ends of such a constraint are not known
            has_sites = "site1" in element.attrib or element.tag not in ("connect", "weld")
            yield LinkTie(
                description, (None, None) if has_sites else (element.get("body1"), element.get("body2", WORLD))
            )


def _tendons(root: Element, defaults: Defaults) -> Iterator[JointCoupling]:
    """Yield the tendons of joints that apply a force."""
    for element in _members(root, "tendon"):
        attributes = defaults.resolve(element, "main", "tendon")
        if element.tag == "fixed" and any(attributes.get(key, "").strip("0. ") for key in FORCES):
            yield JointCoupling(f"<tendon> <fixed> {element.get('name', '')!r}", _joints(element))


def note_ignored_forces(root: Element) -> Iterator[str]:
    """Yield notes on forces of the file that are not read."""
    option = merge_attributes(root, "option")
    for key in (name for name in ("density", "viscosity", "wind") if name in option):
        yield f"<option> {key} = {option[key]!r} is ignored"
    if lifted := [body.get("name", "") for body in root.iter("body") if body.get("gravcomp", "0").strip("0.")]:
        yield f"the gravity compensation of {', '.join(lifted)} is ignored"
    if spatial := [tendon.get("name", "") for tendon in _members(root, "tendon") if tendon.tag == "spatial"]:
        yield f"the spatial tendons {', '.join(map(repr, spatial))} are ignored"
