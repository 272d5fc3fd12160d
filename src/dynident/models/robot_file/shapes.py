"""The shapes of links, as a robot file gives them: simple ones, and the names of mesh files."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief

__all__ = ["LinkShapes", "Shape", "ShapeKind"]

Array = NDArray[np.float64]


class ShapeKind(StrEnum):
    """The kinds of shapes, each about the origin of its frame."""

    BOX = "box"
    SPHERE = "sphere"
    CYLINDER = "cylinder"
    CAPSULE = "capsule"
    ELLIPSOID = "ellipsoid"
    MESH = "mesh"


@dataclass(frozen=True, eq=False)
class Shape:
    """A shape with its ``frame`` (4, 4) in that of its link.

    ``size``, in m: the half edges of a box, the radius of a sphere, radius and half length (of its cylinder) of a
    cylinder or capsule along z, the half axes of an ellipsoid; of a mesh the factors (3) of its coordinates. ``file``
    is the name of a mesh as the robot file has it, empty where it names none.
    """

    kind: ShapeKind
    size: tuple[float, ...]
    frame: Array
    file: str = ""

    __repr__ = brief


@dataclass(frozen=True)
class LinkShapes:
    """The shapes of a link: those for ``collision``, and those that are seen."""

    collision: tuple[Shape, ...] = ()
    visual: tuple[Shape, ...] = ()
