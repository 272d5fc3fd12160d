"""Where the bodies of a tree are: their axes, origins and joints in the frame of the root link, and points on them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynident.errors import ModelError, brief
from dynident.models.tree import Layout, Tree

__all__ = ["Placements", "placements"]

Array = NDArray[np.float64]
Integers = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Placements:
    """Axes ``rotations`` (N, B, 3, 3) and ``origins`` (N, B, 3) (m) of B bodies at N samples, and the ``axes``
    (N, B, 3) of their joints, all in the frame of the root link. The bodies are those of ``RigidBodies.arm.bodies``.

    In all methods ``body`` (P) holds the bodies of P points; -1 is the root link, which does not move.
    """

    layout: Layout
    rotations: Array
    origins: Array
    axes: Array

    __repr__ = brief

    def points(self, body: ArrayLike, local: ArrayLike) -> Array:
        """Return points (N, P, 3) that are at ``local`` (P, 3) in the frames of their bodies."""
        body, local = np.asarray(body, dtype=np.intp), np.asarray(local, dtype=float)
        placed = (self.rotations[:, body] @ local[:, :, None])[..., 0] + self.origins[:, body]
        return np.where((body < 0)[:, None], local, placed)

    def pulled(self, body: ArrayLike, points: Array, along: Array) -> Array:
        """Return how points (N, P, 3) of bodies move ``along`` (N, P, 3) with the joints: J' along, shape (N, P, n).

        With the forces ``along`` on the points, these are the torques of the joints.
        """
        layout = self.layout
        spins, slides = ~layout.prismatic[:, None], layout.prismatic[:, None]
        turning, pushing = self.axes * spins, self.axes * slides - np.cross(self.axes * spins, self.origins)
        wrench = np.concatenate((np.cross(points, along), along), axis=2)
        by_body = wrench @ np.concatenate((turning, pushing), axis=2).swapaxes(1, 2)
        return np.asarray((by_body * self._carries(body)) @ layout.drive)

    def _carries(self, body: ArrayLike) -> Array:
        """Return whether bodies (columns) carry or are those of points (rows): ones and zeros (P, B)."""
        body = np.asarray(body, dtype=np.intp)
        return np.asarray(self.layout.above[body] * (body >= 0)[:, None])


def placements(tree: Tree, first: Array, q: Array) -> Placements:
    """Return the placements of a tree at positions q (N, n), rad or m; ``first`` (3) is where its first body begins.

    Raises ModelError where q has another shape.
    """
    layout = tree.layout
    if q.ndim != 2 or q.shape[1] != layout.joints:
        raise ModelError(f"q has the shape {q.shape}, expected (N, {layout.joints}).")
    q = q @ layout.drive.T + layout.rest
    sine, cosine = (wave(q)[..., None, None] for wave in (np.sin, np.cos))
    relative = tree.turns[0] + sine * tree.turns[1] + cosine * tree.turns[2]
    offset = tree.origin + (layout.prismatic * q)[..., None] * tree.axis
    R, p, z = np.empty((*q.shape, 3, 3)), np.empty((*q.shape, 3)), np.empty((*q.shape, 3))
    for k, parent in enumerate(layout.parent):
        if parent < 0:
            R[:, k], p[:, k], z[:, k] = relative[:, k], first + offset[:, k], tree.axis[k]
        else:
            R[:, k] = R[:, parent] @ relative[:, k]
            p[:, k] = p[:, parent] + (R[:, parent] @ offset[:, k, :, None])[..., 0]
            z[:, k] = R[:, parent] @ tree.axis[k]
    return Placements(layout, R, p, z)
