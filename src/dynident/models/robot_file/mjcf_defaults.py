"""What holds for a whole MJCF: the settings of its compiler, its default classes, and the frames that these turn."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ModelError
from dynident.models.robot_file.mjcf_orientation import ORIENTATIONS, orientation
from dynident.models.robot_file.xml import known, numbers, placement

__all__ = ["Attributes", "Defaults", "merged", "read_defaults"]

Array = NDArray[np.float64]
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

    def resolved(self, element: Element, inherited: str, tag: str = "") -> dict[str, str]:
        """Return an element's attributes with those of its class, else of the ``inherited`` one.

        ``tag`` is the element's name in the classes, where it is another one. Raises ModelError for an unknown class.
        """
        name = element.get("class", inherited)
        known(name, self.classes, f"{self.source}, <{element.tag}> {element.get('name')!r}", "default class")
        free = {"type": "free"} if element.tag == "freejoint" else {}
        return {**self.classes[name].get(tag or element.tag, {}), **element.attrib, **free}

    def frame(self, attributes: Attributes, where: str) -> Array:
        """Return the homogeneous matrix (4, 4) of an element's position and orientation; ModelError for two of them."""
        given = [key for key in ORIENTATIONS if key in attributes]
        if len(given) > 1:
            raise ModelError(f"{where}: {' and '.join(given)} are both given; keep one orientation.")
        sequence = self.compiler.get("eulerseq", "xyz")
        turn = orientation(given[0], attributes, where, self.degrees, sequence) if given else np.eye(3)
        return placement(turn, numbers(attributes, "pos", "0 0 0", where, 3))

    def inside(self, element: Element, inherited: str, where: str) -> Iterator[tuple[Element, str, Array]]:
        """Yield the elements of a body with their inherited class and the frame (4, 4) that they are given in.

        ``<frame>`` is a placement of its elements, which belong to the body.
        """
        yield from self._unframed(element, inherited, np.eye(4), where)

    def _unframed(
        self, element: Element, inherited: str, above: Array, where: str
    ) -> Iterator[tuple[Element, str, Array]]:
        for child in element:
            if child.tag == "frame":
                own = above @ self.frame(child.attrib, f"{where}, <frame>")
                yield from self._unframed(child, child.get("childclass", inherited), own, where)
            else:
                yield child, inherited, above


def read_defaults(root: Element, source: str) -> Defaults:
    """Return what holds for the whole file."""
    return Defaults(source, merged(root, "compiler"), _classes(root))


def merged(root: Element, tag: str) -> dict[str, str]:
    """Return the attributes of all elements of that name, of which MuJoCo allows several."""
    return {key: value for element in root.findall(tag) for key, value in element.attrib.items()}


def _classes(root: Element) -> dict[str, dict[str, Attributes]]:
    """Return the attributes of each default class by element, with those of its parent classes."""
    found: dict[str, dict[str, Attributes]] = {"main": {}}

    def read(element: Element, name: str, outer: Mapping[str, Attributes]) -> None:
        """Add a class with the attributes of the one around it, and those inside it."""
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
