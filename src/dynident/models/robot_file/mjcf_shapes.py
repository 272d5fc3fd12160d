"""The shapes of the bodies of a MuJoCo model: https://mujoco.readthedocs.io/en/stable/XMLreference.html#body-geom."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import PurePosixPath
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from dynident.models.robot_file.mjcf import WORLD, named_bodies
from dynident.models.robot_file.mjcf_defaults import Attributes, Defaults, read_defaults
from dynident.models.robot_file.mjcf_inertia import SIZES, sized
from dynident.models.robot_file.shapes import LinkShapes, Shape, ShapeKind
from dynident.models.robot_file.xml import numbers, placement

__all__ = ["mjcf_shapes"]

Array = NDArray[np.float64]
PLACED = ("refpos", "refquat")  # of a mesh: not read


def mjcf_shapes(root: Element, source: str, origins: Mapping[str, Array]) -> dict[str, LinkShapes]:
    """Return the shapes of each body of a <mujoco> element, in the frames of the links (``RobotFile.origins``).

    Planes and height fields are left out. Raises ModelError for a shape with a wrong size.
    """
    defaults = read_defaults(root, source)
    named_bodies(root)
    meshes = {name: one for asset in root.findall("asset") for name, one in _meshes(asset, defaults)}
    found: dict[str, LinkShapes] = {}

    def read(element: Element, name: str, inherited: str) -> None:
        """Read the shapes of a body, and of those below it."""
        where = f"{source}, body {name!r}"
        shapes: tuple[list[Shape], list[Shape]] = ([], [])
        back = placement(np.eye(3), -origins.get(name, np.zeros(3)))
        for child, given, frame in defaults.inside(element, inherited, where):
            if child.tag == "geom":
                attributes = defaults.resolved(child, given)
                seen = attributes.get("contype") == "0" and attributes.get("conaffinity") == "0"
                shapes[seen].extend(_shape(attributes, back @ frame, defaults, meshes, where))
            elif child.tag == "body":
                read(child, child.get("name", ""), child.get("childclass", given))
        before = found.get(name, LinkShapes())
        found[name] = LinkShapes((*before.collision, *shapes[0]), (*before.visual, *shapes[1]))

    for world in root.findall("worldbody"):
        read(world, WORLD, world.get("childclass", "main"))
    return found


def _shape(
    attributes: Attributes, above: Array, defaults: Defaults, meshes: Mapping[str, Attributes], where: str
) -> Iterator[Shape]:
    kind = attributes.get("type", "sphere")
    if kind in SIZES and "mesh" not in attributes:
        size, frame = sized(kind, attributes, defaults, f"{where}, <geom> {attributes.get('name', '')!r}")
        yield Shape(ShapeKind(kind), tuple(size), above @ frame)
    elif "mesh" in attributes:
        mesh = meshes.get(attributes["mesh"], {})
        name = "" if any(key in mesh for key in PLACED) else _path(mesh, defaults)
        scale = tuple(numbers(mesh, "scale", "1 1 1", where, 3).tolist())
        yield Shape(ShapeKind.MESH, scale, above @ defaults.frame(attributes, where), name)


def _meshes(asset: Element, defaults: Defaults) -> Iterator[tuple[str, Attributes]]:
    for mesh in asset.findall("mesh"):
        attributes = defaults.resolved(mesh, "main")
        yield attributes.get("name") or PurePosixPath(attributes.get("file", "")).stem, attributes


def _path(mesh: Attributes, defaults: Defaults) -> str:
    """Return the name of a mesh's file from the folder of the model, empty where it has none."""
    compiler, name = defaults.compiler, mesh.get("file", "")
    if not name:
        return ""
    name = PurePosixPath(name).name if compiler.get("strippath") == "true" else name
    return str(PurePosixPath(compiler.get("meshdir", compiler.get("assetdir", ""))) / name)
