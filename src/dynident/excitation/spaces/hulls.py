"""Balls and points whose hull contains a solid, as a whole or in two halves."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from dynident.excitation.spaces.fitting import Balls
from dynident.excitation.spaces.geometry import Solid
from dynident.models.robot_file import ShapeKind

__all__ = ["balls_of", "cuts"]

Array = NDArray[np.float64]
AROUND = 16  # points around a circle that stands for a round shape
CUTS = (0.3, 0.5, 0.7)  # of the length of a mesh, where it is cut


def balls_of(solid: Solid) -> Balls:
    """Return balls whose hull contains a solid, in the frame of its body: few more than are needed."""
    if solid.mesh is not None:
        return _points(_placed(solid.mesh.vertices, solid.frame))
    size = np.array(solid.size)
    if solid.kind is ShapeKind.BOX:
        return _points(_placed(size * (2.0 * np.indices((2, 2, 2)).reshape(3, -1).T - 1), solid.frame))
    if solid.kind is ShapeKind.SPHERE:
        return Balls(_placed(np.zeros((1, 3)), solid.frame), size)
    ends = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]) * size[-1]
    if solid.kind is ShapeKind.CAPSULE:
        return Balls(_placed(ends, solid.frame), np.full(2, size[0]))
    turn = 2 * np.pi * np.arange(AROUND) / AROUND
    ring = np.stack((np.cos(turn), np.sin(turn), 0 * turn), axis=1) / np.cos(np.pi / AROUND)  # touches from outside
    if solid.kind is ShapeKind.CYLINDER:
        return _points(_placed((size[0] * ring + ends[:, None]).reshape(-1, 3), solid.frame))
    up = np.pi * (np.arange(AROUND // 2 + 1) / (AROUND // 2) - 0.5)
    ball = ring * np.cos(up)[:, None, None] + np.array([0.0, 0.0, 1.0]) * np.sin(up)[:, None, None]
    return _points(_placed(size / np.cos(np.pi / AROUND) * ball.reshape(-1, 3), solid.frame))


def cuts(solid: Solid) -> Iterator[tuple[Balls, Balls]]:
    """Yield the two sides of a mesh at planes across its principal axes; nothing for a simple shape."""
    if solid.mesh is None:
        return
    points = _placed(solid.mesh.vertices, solid.frame)
    edges = np.concatenate([solid.mesh.triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    for axis in np.linalg.eigh(np.cov(points.T, bias=True))[1].T:
        along = points @ axis
        for share in CUTS:
            height = along - (along.min() + share * np.ptp(along))
            crossing = edges[height[edges].prod(axis=1) < 0]
            part = height[crossing[:, :1]] / (height[crossing[:, :1]] - height[crossing[:, 1:]])
            met = points[crossing[:, 0]] + part * (points[crossing[:, 1]] - points[crossing[:, 0]])
            sides = (np.concatenate((points[side], met)) for side in (height <= 0, height >= 0))
            low, high = (_points(side) for side in sides)
            yield low, high


def _points(centres: Array) -> Balls:
    return Balls(centres, np.zeros(len(centres)))


def _placed(points: Array, frame: Array) -> Array:
    return np.asarray(points @ frame[:3, :3].T + frame[:3, 3])
