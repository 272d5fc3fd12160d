"""What an MJCF says of its joints outside of its bodies: equalities, tendons, and forces that are not read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from dynident.models.robot_file.mjcf_defaults import Defaults, merged
from dynident.models.robot_file.xml import Coupled, RobotJoint, Tied, known, numbers

__all__ = ["constraints", "following", "ignored"]

Array = NDArray[np.float64]
LINEAR = "0 1 0 0 0"  # of a joint's polynomial, by default
FORCES = ("stiffness", "damping", "frictionloss", "armature")  # of a tendon
WORLD = "world"


def constraints(root: Element, defaults: Defaults) -> tuple[Coupled | Tied, ...]:
    """Return the constraints of the file, but for those that make a joint follow another (``following``).

    A tendon that is only measured is none. Raises ModelError for invalid numbers.
    """
    fixed = {tendon.get("name", ""): _joints(tendon) for tendon in _members(root, "tendon") if tendon.tag == "fixed"}
    return (*_equalities(root, defaults, fixed), *_tendons(root, defaults))


def following(
    root: Element, defaults: Defaults, joints: Sequence[RobotJoint], zeros: Mapping[str, float]
) -> tuple[RobotJoint, ...]:
    """Return the joints, those that an equality makes a linear function of another as followers of it.

    ``zeros`` are the positions (rad, m) in which the file shows its joints. Raises ModelError for an unknown joint.
    """
    found = {joint.name: joint for joint in joints}
    for element, one, other in _linear(root, defaults):
        where = f"{defaults.source}, <equality> <joint> {element.get('name', '')!r}"
        for name in (one, other):
            known(name, found, where)
        constant, slope = _polynomial(element, defaults)[:2].tolist()
        offset = constant + zeros[one] - slope * zeros[other]
        found[one] = replace(found[one], follows=(other, slope, offset))
    return tuple(found.values())


def _active(element: Element, defaults: Defaults) -> bool:
    return defaults.resolved(element, "main", "equality").get("active", "true") != "false"


def _polynomial(element: Element, defaults: Defaults) -> Array:
    words = element.get("polycoef", "").split()
    filled = " ".join([*words, *LINEAR.split()[len(words) :]])
    return numbers({"polycoef": filled}, "polycoef", LINEAR, f"{defaults.source}, <equality> <joint>", 5)


def _linear(root: Element, defaults: Defaults) -> Iterator[tuple[Element, str, str]]:
    """Yield the equalities of two joints without powers, with their joints, the first of each joint that follows."""
    seen: set[str] = set()
    for element in _members(root, "equality"):
        one, other = element.get("joint1", ""), element.get("joint2", "")
        if element.tag != "joint" or not other or one in seen or not _active(element, defaults):
            continue
        if not _polynomial(element, defaults)[2:].any():
            seen.add(one)
            yield element, one, other


def _members(root: Element, tag: str) -> Iterator[Element]:
    return (child for group in root.findall(tag) for child in group)


def _joints(tendon: Element) -> tuple[str, ...]:
    return tuple(joint.get("joint", "") for joint in tendon.findall("joint"))


def _equalities(root: Element, defaults: Defaults, fixed: Mapping[str, tuple[str, ...]]) -> Iterator[Coupled | Tied]:
    followed = {id(element) for element, _, _ in _linear(root, defaults)}
    for element in _members(root, "equality"):
        what = f"<equality> <{element.tag}> {element.get('name', '')!r}"
        if not _active(element, defaults) or id(element) in followed:
            continue
        ends = [end for key in ("1", "2") if (end := element.get(element.tag + key))]
        if element.tag == "joint":
            yield Coupled(what, tuple(ends))
        elif element.tag == "tendon" and all(end in fixed for end in ends):
            yield Coupled(what, tuple(joint for end in ends for joint in fixed[end]))
        else:
            sited = "site1" in element.attrib or element.tag not in ("connect", "weld")
            yield Tied(what, (None, None) if sited else (element.get("body1"), element.get("body2", WORLD)))


def _tendons(root: Element, defaults: Defaults) -> Iterator[Coupled]:
    """Yield the tendons of joints that apply a force."""
    for element in _members(root, "tendon"):
        attributes = defaults.resolved(element, "main", "tendon")
        if element.tag == "fixed" and any(attributes.get(key, "").strip("0. ") for key in FORCES):
            yield Coupled(f"<tendon> <fixed> {element.get('name', '')!r}", _joints(element))


def ignored(root: Element) -> Iterator[str]:
    """Yield notes on forces of the file that are not read."""
    option = merged(root, "option")
    for key in (one for one in ("density", "viscosity", "wind") if one in option):
        yield f"<option> {key} = {option[key]!r} is ignored"
    if lifted := [body.get("name", "") for body in root.iter("body") if body.get("gravcomp", "0").strip("0.")]:
        yield f"the gravity compensation of {', '.join(lifted)} is ignored"
    if spatial := [tendon.get("name", "") for tendon in _members(root, "tendon") if tendon.tag == "spatial"]:
        yield f"the spatial tendons {', '.join(map(repr, spatial))} are ignored"
