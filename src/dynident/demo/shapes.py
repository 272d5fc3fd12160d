"""Capsules, the shapes of the demo arm's links: their inertia and their meshes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynident.models import from_physical

__all__ = ["Capsule"]

Array = NDArray[np.float64]
AROUND, ALONG = 16, 4  # facets around a capsule, and from its end to its cylinder


@dataclass(frozen=True)
class Capsule:
    """A cylinder with half balls at its ends: from ``start`` to ``end`` (m, in the link's frame), with its radius."""

    start: tuple[float, float, float]
    end: tuple[float, float, float]
    radius: float

    def inertia(self, mass: float) -> Array:
        """Return the ten parameters of a capsule of this mass (kg) and of one density."""
        along, r = np.subtract(self.end, self.start), self.radius
        L = float(np.linalg.norm(along))
        tube = mass * L / (L + 4 * r / 3)
        balls = mass - tube
        axial = tube * r**2 / 2 + balls * 2 * r**2 / 5
        across = tube * (L**2 / 12 + r**2 / 4) + balls * (2 * r**2 / 5 + L**2 / 4 + 3 * L * r / 8)
        u = along / L if L else np.zeros(3)
        tensor = across * np.eye(3) + (axial - across) * np.outer(u, u)
        return from_physical(mass, np.add(self.start, self.end) / 2, tensor)

    def stl(self) -> bytes:
        """Return the surface as binary STL, normals outwards."""
        corners = self._corners()
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        sizes = np.linalg.norm(normals, axis=1, keepdims=True)
        there = sizes[:, 0] > 0  # a ball has no cylinder
        corners, normals = corners[there], normals[there] / sizes[there]
        facets = np.zeros(len(corners), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
        facets["normal"], facets["corners"] = normals, corners
        return b"dynident demo arm".ljust(80) + len(corners).to_bytes(4, "little") + facets.tobytes()

    def _corners(self) -> Array:
        """Return the corners (facets, 3, 3) of triangles, counter-clockwise from outside."""
        x, y, z = _frame(np.subtract(self.end, self.start))
        up = np.linspace(-np.pi / 2, np.pi / 2, 2 * ALONG)
        up[ALONG - 1], up[ALONG] = 0.0, 0.0  # the ends of the cylinder
        across = np.cos(up)
        across[0], across[-1] = 0.0, 0.0
        turn = 2 * np.pi * np.arange(AROUND) / AROUND
        ring = np.outer(np.cos(turn), x) + np.outer(np.sin(turn), y)
        middle = np.where(np.arange(len(up))[:, None] < ALONG, self.start, self.end)
        axes = middle + self.radius * np.outer(np.sin(up), z)
        rings = axes[:, None] + self.radius * across[:, None, None] * ring
        low, high = rings[:-1], rings[1:]
        following = np.roll(low, -1, axis=1), np.roll(high, -1, axis=1)
        first = np.stack((low, following[0], following[1]), axis=2)[1:]  # the first ring is a point
        second = np.stack((low, following[1], high), axis=2)[:-1]  # and so is the last
        return np.concatenate((first.reshape(-1, 3, 3), second.reshape(-1, 3, 3)))


def _frame(along: Array) -> Array:
    """Return three axes (3, 3), the last of them along a vector; any of them where it is zero."""
    size = np.linalg.norm(along)
    z = along / size if size else np.array([0.0, 0.0, 1.0])
    x = np.cross(np.eye(3)[int(np.argmin(np.abs(z)))], z)
    x /= np.linalg.norm(x)
    return np.array([x, np.cross(z, x), z])
