"""Surfaces of few triangles that show the bodies of an arm in a drawing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.excitation.spaces.capsules import Capsule, rod
from dynident.excitation.spaces.geometry import Geometry, Made, Mesh, Solid
from dynident.models.robot_file import ShapeKind

__all__ = ["Outline", "outlines", "simplified"]

Array = NDArray[np.float64]
MOST = 600  # triangles of a body
AROUND, ALONG = 12, 3  # corners of a circle, and rings of a half ball
FINER, TRIES = 0.8, 40  # steps between sizes of cells


@dataclass(frozen=True, eq=False)
class Outline:
    """The surface of a body, by its place in ``Arm.bodies`` (-1: the root link), in its frame: ``mesh.vertices`` (V, 3)
    in m and ``mesh.triangles`` (F, 3)."""

    link: str
    body: int
    mesh: Mesh

    __repr__ = brief


def outlines(geometry: Geometry, capsules: Sequence[Capsule] | None = None, most: int = MOST) -> tuple[Outline, ...]:
    """Return the surfaces of the bodies of an arm, of about ``most`` triangles each.

    They are those of its solids or, where only the joints are known, of its ``capsules``; without these, a ``rod`` is
    added to what is known of the solids.
    """
    out = []
    for body, made in geometry.made.items():
        parts = [_surface(one) for one in geometry.solids if one.body == body]
        if made is Made.JOINTS and capsules is None:
            parts.append(_surface(rod(geometry, body).solid))
        elif made is Made.JOINTS:
            parts = [_surface(one.solid) for one in capsules or () if one.body == body]
        if parts:
            each = max(most // len(parts), 4)
            out.append(Outline(geometry.link(body), body, _joined([simplified(one, each) for one in parts])))
    return tuple(out)


def simplified(mesh: Mesh, most: int = MOST) -> Mesh:
    """Return a mesh of at most ``most`` triangles, but of all where no cells give so few.

    Corners in one cell of a grid become their mean, and triangles without an area go (Rossignac and Borrel, 1993).
    """
    size, coarse = float(np.ptp(mesh.vertices, axis=0).max()), mesh
    cell = size / most**0.5 / 2
    for _ in range(TRIES):
        if len(coarse.triangles) <= most:
            break
        coarse, cell = _clustered(mesh, cell), cell / FINER
    return coarse


def _clustered(mesh: Mesh, cell: float) -> Mesh:
    cells = np.round(mesh.vertices / cell).astype(np.int64)
    cells -= cells.min(axis=0)
    along = cells.max(axis=0) + 1
    one = (cells[:, 0] * along[1] + cells[:, 1]) * along[2] + cells[:, 2]  # one number is found faster than three
    _, place, count = np.unique(one, return_inverse=True, return_counts=True)
    means = np.stack([np.bincount(place, one) for one in mesh.vertices.T], axis=1) / count[:, None]
    triangles = place[mesh.triangles]
    whole = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    _, first = np.unique(np.sort(triangles[whole], axis=1), axis=0, return_index=True)
    return Mesh(means, triangles[whole][np.sort(first)])


def _surface(solid: Solid) -> Mesh:
    """Return the surface of a solid in the frame of its body."""
    size = np.array(solid.size)
    if solid.mesh is not None:
        mesh = solid.mesh
    elif solid.kind is ShapeKind.BOX:
        mesh = _box(size)
    elif solid.kind is ShapeKind.CAPSULE:
        mesh = _capsule(size[1], size[0])
    elif solid.kind is ShapeKind.CYLINDER:
        mesh = _turned(np.array([[0, -size[1]], [size[0], -size[1]], [size[0], size[1]], [0, size[1]]]))
    else:
        ball = _capsule(0.0, 1.0)
        mesh = Mesh(ball.vertices * size, ball.triangles)
    return Mesh(mesh.vertices @ solid.frame[:3, :3].T + solid.frame[:3, 3], mesh.triangles)


def _capsule(half: float, radius: float) -> Mesh:
    """Return the surface of a capsule along z about the origin."""
    up = np.linspace(0.0, np.pi / 2, ALONG + 1)
    cap = radius * np.stack((np.cos(up), np.sin(up)), axis=1) + np.array([0.0, half])
    return _turned(np.concatenate((cap[::-1] * np.array([1.0, -1.0]), cap)))


def _turned(profile: Array) -> Mesh:
    """Return the surface of a profile (K, 2), distance from and height along z, turned about that."""
    turn = 2 * np.pi * np.arange(AROUND) / AROUND
    ring = np.stack((np.cos(turn), np.sin(turn), 0 * turn), axis=1)
    points = profile[:, None, :1] * ring + profile[:, None, 1:] * np.array([0.0, 0.0, 1.0])
    here = np.arange(len(points) * AROUND).reshape(-1, AROUND)
    low, high = here[:-1], here[1:]
    after_low, after_high = np.roll(low, -1, axis=1), np.roll(high, -1, axis=1)
    sides = np.stack(((low, after_low, after_high), (low, after_high, high))).transpose(0, 2, 3, 1)
    return _clean(Mesh(points.reshape(-1, 3), sides.reshape(-1, 3)))


def _clean(mesh: Mesh) -> Mesh:
    """Return a mesh with equal corners made one, and without triangles that have no area."""
    return _clustered(mesh, 1e-9 + 1e-6 * float(np.ptp(mesh.vertices, axis=0).max()))


def _box(half: Array) -> Mesh:
    corners = (2.0 * np.indices((2, 2, 2)).reshape(3, -1).T - 1) * half
    faces = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    return Mesh(corners, np.concatenate((faces[:, [0, 1, 2]], faces[:, [0, 2, 3]])))


def _joined(parts: Sequence[Mesh]) -> Mesh:
    starts = np.cumsum([0, *(len(one.vertices) for one in parts[:-1])])
    triangles = [one.triangles + start for one, start in zip(parts, starts, strict=True)]
    return Mesh(np.concatenate([one.vertices for one in parts]), np.concatenate(triangles))
