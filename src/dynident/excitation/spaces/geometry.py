"""The solid shapes of an arm, as far as its file and the meshes that it names are there."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.models import RigidBodies
from dynident.models.robot_file import LinkShapes, Shape, ShapeKind, motion

__all__ = ["Geometry", "LinkPlace", "Made", "Mesh", "Solid", "geometry_of", "link_places", "rods_of"]

Array = NDArray[np.float64]
Integers = NDArray[np.intp]


class Made(StrEnum):
    """What is known of the shape of a body: its shapes for collision, those that are seen, or only its joints."""

    COLLISION = "collision"
    VISUAL = "visual"
    JOINTS = "joints"


@dataclass(frozen=True, eq=False)
class Mesh:
    """A surface of triangles: ``vertices`` (V, 3) in m, and the three corners of each of the ``triangles`` (F, 3)."""

    vertices: Array
    triangles: Integers

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class Solid:
    """A shape of ``link``, with its ``frame`` (4, 4) in that of a body, given by its place in ``Arm.bodies`` (-1: the
    root link); ``size`` as of a ``Shape``. A mesh is scaled already.
    """

    link: str
    body: int
    kind: ShapeKind
    size: tuple[float, ...]
    frame: Array
    mesh: Mesh | None = None

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class LinkPlace:
    """A link, the place of its body in ``Arm.bodies`` (-1: the root link), and its frame (4, 4) in that body's."""

    link: str
    body: int
    frame: Array

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class Geometry:
    """The ``solids`` of an arm; of each body that can touch something how they are ``made``, by its place. ``missing``
    are the files of meshes that are not there, or cannot be read, each with the reason."""

    bodies: RigidBodies
    solids: tuple[Solid, ...]
    made: Mapping[int, Made]
    missing: Mapping[str, str]

    __repr__ = brief

    @cached_property
    def places(self) -> tuple[LinkPlace, ...]:
        """Where the links are."""
        return link_places(self.bodies)

    def link(self, body: int) -> str:
        """Return the name of a body: that of its first link."""
        return self.bodies.arm.bodies[body].name if body >= 0 else self.bodies.file.root


def geometry_of(bodies: RigidBodies, mesh: Callable[[str], Mesh | None] = lambda _: None) -> Geometry:
    """Return the shapes of an arm; ``mesh`` gives a mesh by the name that the file has for it, None where it cannot.

    Of a link, its shapes for collision are taken where all of them are known, else those that are seen where all of
    these are, else what is known of the first. A body with a link of the last sort, or with a mass but no shape, is
    ``Made.JOINTS``.
    """
    shapes = bodies.shapes
    solids: list[Solid] = []
    made: dict[int, Made] = {}
    for place in link_places(bodies):
        of_link, how = _chosen(shapes.get(place.link, LinkShapes()), place, mesh)
        if how is not None:
            made[place.body] = max(how, made.get(place.body, how), key=list(Made).index)
        solids += of_link
    for k, body in enumerate(bodies.arm.bodies):
        if k not in made and not body.massless and body.theta[0] != 0:
            made[k] = Made.JOINTS
    return Geometry(bodies, tuple(solids), dict(sorted(made.items())), {})


def rods_of(bodies: RigidBodies) -> Geometry:
    """Return the geometry of an arm of which only the joints are known, or used."""
    made = {k: Made.JOINTS for k, body in enumerate(bodies.arm.bodies) if not body.massless}
    return Geometry(bodies, (), made, {})


def link_places(bodies: RigidBodies) -> tuple[LinkPlace, ...]:
    """Return where all links of an arm are, those that stand still first."""
    still = [LinkPlace(link, -1, frame) for link, frame in _standing(bodies).items()]
    moving = [
        LinkPlace(link, k, frame)
        for k, body in enumerate(bodies.arm.bodies)
        for link, frame in zip(body.links, body.frames, strict=True)
    ]
    return (*still, *moving)


def _chosen(
    shapes: LinkShapes, place: LinkPlace, mesh: Callable[[str], Mesh | None]
) -> tuple[list[Solid], Made | None]:
    """Return the solids of a link that are used, and how it is made: None where it has none."""
    known: list[Solid] = []
    for given, how in ((shapes.collision, Made.COLLISION), (shapes.visual, Made.VISUAL)):
        found = [solid for one in given if (solid := _solid(one, place, mesh)) is not None]
        if given and len(found) == len(given):
            return found, how
        known = known if how is Made.VISUAL else found
    return known, Made.JOINTS if shapes.collision or shapes.visual else None


def _solid(shape: Shape, place: LinkPlace, mesh: Callable[[str], Mesh | None]) -> Solid | None:
    """Return a shape in the frame of its body, None where its mesh is not known."""
    frame = place.frame @ shape.frame
    if shape.kind is not ShapeKind.MESH:
        return Solid(place.link, place.body, shape.kind, shape.size, frame)
    found = mesh(shape.file) if shape.file else None
    if found is None:
        return None
    scaled = Mesh(found.vertices * np.array(shape.size), found.triangles)
    return Solid(place.link, place.body, shape.kind, shape.size, frame, scaled)


def _standing(bodies: RigidBodies) -> dict[str, Array]:
    """Return the frames (4, 4) of the links that stand still, in that of the root link."""
    file, arm = bodies.file, bodies.arm
    still, frames = set(arm.still), {file.root: np.eye(4)}
    todo = [file.root]
    while todo:
        link = todo.pop()
        for joint in file.joints:
            if joint.parent == link and joint.child in still:
                turned = motion(joint, arm.standing.get(joint.name, 0.0))
                frames[joint.child] = frames[link] @ joint.placement @ turned
                todo.append(joint.child)
    return frames
