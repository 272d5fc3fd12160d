"""The content of a robot file of either format: links with inertias, joints that connect them, and their limits."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from decimal import Decimal
from enum import StrEnum
from functools import cached_property
from typing import Literal, NoReturn
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import numpy as np

from dynident.runtime import ModelError, Noun, choices
from dynident.runtime.arrays import Array

MAX_NUMBER = 1e30  # larger than any length, mass or angle of a robot; squares of larger numbers overflow
ANGLE_STEP, RIGHT_ANGLE = np.pi / 12, np.pi / 2  # 15 and 90 degrees
MIN_NOTED_CHANGE = 1e-8  # rad: an angle that is changed by more than this is named in the notes
MAX_DEPTH = 300  # levels of nesting: no arm needs more, and readers that recurse would fail


@dataclass(frozen=True)
class RobotJointLimits:
    """Limits of a joint, None where the file gives none: N m or N, rad/s or m/s, and rad or m."""

    effort: float | None = None
    velocity: float | None = None
    lower: float | None = None
    upper: float | None = None

    @property
    def nearest_to_zero(self) -> float:
        """The position nearest to zero that the joint can have."""
        low = -math.inf if self.lower is None else self.lower
        return min(max(0.0, low), math.inf if self.upper is None else self.upper)


class RobotJoint(Noun):
    """A joint between two links: at position q the child's frame in the parent's is ``placement`` @ motion(q).

    ``placement`` (4, 4) in m; ``axis`` (3) is a unit vector in the child's frame. ``refusal`` is the reason why the
    joint cannot be a moving one; ``free``: it has several coordinates. ``follows`` is (joint, multiplier, offset) of a
    mimic joint. ``nominal`` holds the file's damping (N m s/rad or N s/m), friction (N m or N) and armature (kg m^2 or
    kg).
    """

    name: str
    kind: Literal["fixed", "revolute", "prismatic"]
    parent: str
    child: str
    placement: Array
    axis: Array
    limits: RobotJointLimits = RobotJointLimits()
    nominal: Mapping[str, float] = field(default_factory=dict)
    follows: tuple[str, float, float] | None = None
    refusal: str = ""
    free: bool = False


@dataclass(frozen=True)
class JointCoupling:
    """Joints coupled by an equation of the file, which ``description`` names."""

    description: str
    joints: tuple[str, ...]


@dataclass(frozen=True)
class LinkTie:
    """Two links connected by a constraint of the file, which ``description`` names; None is an unknown link."""

    description: str
    links: tuple[str | None, str | None]


class RobotFile(Noun):
    """A tree of links from ``root``: ``links`` maps names to inertial parameters (10) in the link's frame, or None
    where the file leaves them to be computed from shapes. ``joints`` are in the order of the file. ``gravity`` (3) in
    m/s^2 is None where the file gives none; ``notes`` say what is ignored. ``origins`` (3), in m, are the origins of
    the link frames used here in those of the file, where they differ (MJCF: at the joint's anchor). ``massless`` are
    links that the file does not have: between the joints of one body.
    """

    format: Literal["urdf", "mjcf"]
    source: str
    root: str
    links: Mapping[str, Array | None]
    joints: tuple[RobotJoint, ...]
    constraints: tuple[JointCoupling | LinkTie, ...] = ()
    gravity: tuple[float, ...] | None = None
    notes: tuple[str, ...] = ()
    origins: Mapping[str, Array] = field(default_factory=dict)
    massless: tuple[str, ...] = ()

    @cached_property
    def joints_below(self) -> Mapping[str, Sequence[RobotJoint]]:
        """The joints on each link that has any, in the order of the file."""
        below: dict[str, list[RobotJoint]] = {}
        for joint in self.joints:
            below.setdefault(joint.parent, []).append(joint)
        return below

    @property
    def floating(self) -> tuple[str, ...]:
        """The joints with several coordinates that carry the whole robot, such as a free joint of the trunk."""
        return tuple(joint.name for joint in self.joints if joint.free and joint.parent == self.root)

    def limbs(self, moving: Collection[str]) -> tuple[str, tuple[str, ...]] | None:
        """Return the base link at which several ``moving`` joints begin, with these, where it has a mass; else None."""
        base_links, below = [self.root], self.joints_below
        # the base is the root and all links fixed to it: the list grows while it is gone through
        for link in base_links:
            base_links += [joint.child for joint in below.get(link, []) if joint.kind == "fixed"]
        limb_joints = [joint for link in base_links for joint in below.get(link, []) if joint.name in moving]
        with_mass = [link for link in base_links if (theta := self.links[link]) is not None and theta[0] > 0]
        names = tuple(joint.name for joint in limb_joints)
        return (with_mass[0], names) if with_mass and len(names) > 1 else None


def parse(xml: str, source: str) -> Element:
    """Return the root element of a robot file's text; no entity is expanded and no other file is opened.

    Raises ModelError for malformed XML, with its line, and for a document type or entity declaration.
    """
    # expat itself, so that declarations can be refused before anything in them is expanded
    builder, parser, depth = TreeBuilder(), expat.ParserCreate(), 0

    def refuse(*_: object) -> NoReturn:
        """Raise the error for a document type."""
        raise ModelError(
            f"{source}, line {parser.CurrentLineNumber}: a DOCTYPE with its entities is not read, because it can reach "
            "other files or grow without bound; delete it and write out what its entities stand for."
        )

    def start(tag: str, attributes: dict[str, str]) -> None:
        """Begin an element; ModelError where it is nested too deep, or is for xacro."""
        nonlocal depth
        depth += 1
        if depth > MAX_DEPTH:
            raise ModelError(
                f"{source}, line {parser.CurrentLineNumber}: elements are nested deeper than {MAX_DEPTH} levels."
            )
        if tag.startswith("xacro:") or any("${" in value for value in attributes.values()):
            raise ModelError(
                f"{source}, line {parser.CurrentLineNumber}: <{tag}> needs xacro; let the file's name end in "
                ".xacro, or expand it first with `xacro robot.urdf.xacro > robot.urdf`."
            )
        builder.start(tag, attributes)

    def end(tag: str) -> None:
        nonlocal depth
        depth -= 1
        builder.end(tag)

    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = refuse
    parser.StartElementHandler, parser.EndElementHandler = start, end
    try:
        parser.Parse(xml, True)
    except expat.ExpatError as error:
        raise ModelError(f"{source} is not well-formed XML: {error}; correct the file there.") from error
    except UnicodeEncodeError as error:
        raise ModelError(f"{source} is not text: {error}; read it with its own encoding.") from error
    return builder.close()


def numbers(element: Element | Mapping[str, str] | None, key: str, default: str, where: str, count: int = 1) -> Array:
    """Return ``count`` numbers of an attribute, or of ``default`` where element or attribute is missing.

    Raises ModelError, with the place ``where``, for another number of them, or where one is not finite or too large.
    """
    text = default if element is None else (element.get(key) or default)
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.array([])
    if len(values) != count or not (np.abs(values) < MAX_NUMBER).all():
        expected = f"a number below {MAX_NUMBER:g}" if count == 1 else f"{count} numbers below {MAX_NUMBER:g}"
        raise ModelError(f"{where}: {key} = {text!r}, expected {expected}, such as {default or '0'!r}.")
    return values


def angles(element: Element | Mapping[str, str] | None, key: str, default: str, where: str, count: int = 1) -> Array:
    """Return ``numbers`` in rad, with rounded multiples of 15 degrees made exact (``exact_angle``)."""
    numbers(element, key, default, where, count)
    text = default if element is None else (element.get(key) or default)
    return np.array([exact_angle(word) for word in text.split()])


def exact_angle(word: str) -> float:
    """Return the number, or the multiple of 15 degrees in rad that it is rounded from: pi for 3.1416, 3.1415 and 3.14.

    A rounded or truncated angle differs from the exact one by less than a unit in its last place. It needs at least
    three decimal places, or two for right angles.
    """
    # the decimal number has as many places as were printed
    value, printed = float(word), Decimal(word).normalize().as_tuple()
    if not isinstance(printed.exponent, int) or printed.exponent > -2:
        return value
    # two places tell only right angles from other numbers
    step = RIGHT_ANGLE if printed.exponent == -2 else ANGLE_STEP
    nearest = float(np.round(value / step) * step)
    return nearest if nearest and abs(value - nearest) < 10.0**printed.exponent else value


def note_exact_angles(attributes: str, pairs: Iterable[tuple[str, str]]) -> tuple[str, ...]:
    """Return a note on the angles that ``exact_angle`` changes, if any.

    ``pairs`` are the name of a joint or body, and a text of angles.
    """
    changed = [
        f"{word} of {name} as {exact_angle(word):.10g}"
        for name, text in pairs
        for word in text.split()
        if abs(exact_angle(word) - float(word)) > MIN_NOTED_CHANGE
    ]
    note = f"rounded angles ({attributes}) are read as exact multiples of 15 deg: {', '.join(changed)}"
    return (note,) if changed else ()


def unit_vector(vector: Array, where: str) -> Array:
    """Return the vector (3) at length 1; ModelError where it has none."""
    length = float(np.linalg.norm(vector))
    if length == 0:
        raise ModelError(f"{where}: the axis is {vector.tolist()}, which has no direction; give one such as '0 0 1'.")
    return vector / length


def check_unique(names: Iterable[str], kind: str, source: str) -> None:
    """Raise ModelError where one of the names is duplicate or empty."""
    earlier_names: set[str] = set()
    for name in names:
        if not name:
            raise ModelError(f"{source}: a {kind} has no name; give it one, because data are matched by name.")
        if name in earlier_names:
            raise ModelError(f"{source}: the name {name!r} is given to more than one {kind}; rename the others.")
        earlier_names.add(name)


def check_known(name: str, names: Iterable[str], where: str, kind: str = "joint") -> None:
    """Raise ModelError with the choices where ``name`` is none of ``names``."""
    names = names if isinstance(names, Collection) else list(names)
    if name not in names:
        raise ModelError(f"{where}: no {kind} {name!r}; {choices(name, names)}")


def rotation(axis: Array, angle: float) -> Array:
    """Return the matrix (3, 3) that turns by ``angle`` rad about the unit vector ``axis`` (Rodrigues)."""
    x, y, z = axis
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K)


def placement(turn: Array, shift: Array) -> Array:
    """Return the homogeneous matrix (4, 4) of a rotation (3, 3) and a translation (3) in m."""
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = turn, shift
    return out


def motion_matrix(joint: RobotJoint, q: float) -> Array:
    """Return the homogeneous matrix (4, 4) of a joint's motion by q, in rad or m."""
    if joint.kind == "prismatic":
        return placement(np.eye(3), joint.axis * q)
    return placement(rotation(joint.axis, q), np.zeros(3)) if joint.kind == "revolute" else np.eye(4)


class ShapeKind(StrEnum):
    """The kinds of shapes, each about the origin of its frame."""

    BOX = "box"
    SPHERE = "sphere"
    CYLINDER = "cylinder"
    CAPSULE = "capsule"
    ELLIPSOID = "ellipsoid"
    MESH = "mesh"


class Shape(Noun):
    """A shape with its ``frame`` (4, 4) in that of its link.

    ``size``, in m: the half edges of a box, the radius of a sphere, radius and half length (of its cylinder) of a
    cylinder or capsule along z, the half axes of an ellipsoid; of a mesh the factors (3) of its coordinates. ``file``
    is the name of a mesh as the robot file has it, empty where it names none.
    """

    kind: ShapeKind
    size: tuple[float, ...]
    frame: Array
    file: str = ""


@dataclass(frozen=True)
class LinkShapes:
    """The shapes of a link: those for ``collision``, and the ``visual`` ones, which are only shown."""

    collision: tuple[Shape, ...] = ()
    visual: tuple[Shape, ...] = ()
