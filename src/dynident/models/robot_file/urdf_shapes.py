"""The shapes of the links of a URDF: http://wiki.ros.org/urdf/XML/link."""

from __future__ import annotations

from collections.abc import Iterator
from xml.etree.ElementTree import Element

from dynident.errors import ModelError
from dynident.models.robot_file.shapes import LinkShapes, Shape, ShapeKind
from dynident.models.robot_file.urdf import origin
from dynident.models.robot_file.xml import numbers, placement

__all__ = ["urdf_shapes"]

READ = {kind.value: kind for kind in ShapeKind if kind is not ShapeKind.ELLIPSOID}


def urdf_shapes(root: Element, source: str) -> dict[str, LinkShapes]:
    """Return the shapes of each link of a <robot> element; ModelError for a shape without a size."""
    return {
        link.get("name", ""): LinkShapes(*(tuple(_shapes(link, tag, source)) for tag in ("collision", "visual")))
        for link in root.findall("link")
    }


def _shapes(link: Element, tag: str, source: str) -> Iterator[Shape]:
    where = f"{source}, <{tag}> of link {link.get('name')!r}"
    for element in link.findall(tag):
        for one in element.findall("geometry/*"):
            if one.tag in READ:
                size = _size(one, where)
                if one.tag != "mesh" and min(size) <= 0:
                    raise ModelError(f"{where}: a {one.tag} of the size {size}; give lengths above zero.")
                frame = placement(*origin(element.find("origin"), where))
                yield Shape(READ[one.tag], size, frame, one.get("filename", ""))


def _size(one: Element, where: str) -> tuple[float, ...]:
    if one.tag == "mesh":
        return tuple(numbers(one, "scale", "1 1 1", where, 3).tolist())
    if one.tag == "box":
        return tuple((numbers(one, "size", "", where, 3) / 2).tolist())
    radius = float(numbers(one, "radius", "", where)[0])
    return (radius,) if one.tag == "sphere" else (radius, float(numbers(one, "length", "", where)[0]) / 2)
