"""The inertias of an MJCF's meshes, written into its text: a model is a text, and needs no other files then."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dynident.files.opener import afford, content
from dynident.files.xml_text import XmlNode, XmlText
from dynident.models import to_physical
from dynident.models.robot_files import UNNAMED, compile_mjcf, parse
from dynident.runtime import InputError, ModelError

Array = NDArray[np.float64]
FULL_INERTIA = ([0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2])  # rows and columns of a tensor
MESH_WEIGHT = 40  # memory of a compiled mesh, per byte of its file


def with_mesh_inertias(xml: str, path: Path) -> str:
    """Return the text of an MJCF at ``path`` with an ``<inertial>`` in each body whose inertia follows from meshes.

    It is what MuJoCo computes from the files, which are named from the folder of ``path``. A body of which one is not
    there, or is no mesh, stays as it is, and so does a file whose compiler changes inertias. Raises ModelError for a
    file that MuJoCo cannot compile.
    """
    if "<mesh" not in xml or (root := parse(xml, path.name)).tag != "mujoco":
        return xml
    compiled = compile_mjcf(root, path.name)
    unknown = {name for name, theta in compiled.inertias.items() if theta is None}
    if not unknown or compiled.alters:
        return xml
    contents: dict[str, bytes] = {}
    for name in compiled.mesh_files:
        try:
            contents[name] = content(path.parent / name, weight=MESH_WEIGHT)
        except InputError:
            continue
        afford(MESH_WEIGHT * sum(map(len, contents.values())), f"{path.name}: its meshes would take", ModelError)
    try:
        thetas = compile_mjcf(parse(xml, path.name), path.name, contents).inertias
    except ModelError:
        return xml  # a file that is no mesh
    text = XmlText(xml)
    for name, node in named_body_nodes(text):
        if name in unknown and (theta := thetas[name]) is not None and theta.any():
            text.insert(node, inertial_element(theta, np.zeros(3), name))
    return str(text)


def named_body_nodes(text: XmlText) -> Iterator[tuple[str, XmlNode]]:
    """Yield the bodies of an MJCF with their names; those without one are numbered, as the reader of models does."""
    nodes = [node for world in text.root.children if world.tag == "worldbody" for node in world.walk()]
    for place, node in enumerate((node for node in nodes if node.tag == "body"), start=1):
        yield node.attributes.get("name") or UNNAMED.format(place), node


def inertial_element(theta: Array, origin: Array, name: str) -> str:
    """Return an <inertial> of parameters (10) about ``origin`` (3) in the frame of the body ``name``."""
    mass, centre, tensor = to_physical(theta, name)
    pos, full = (" ".join(repr(float(x)) for x in values) for values in (origin + centre, tensor[FULL_INERTIA]))
    return f'<inertial pos="{pos}" mass="{float(mass)!r}" fullinertia="{full}"/>'
