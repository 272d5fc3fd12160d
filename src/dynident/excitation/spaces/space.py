"""What an arm must keep clear of: itself, and what stands around it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

__all__ = ["Box", "Cylinder", "Distances", "Floor", "Nothing", "Obstacle", "Space", "Steep"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Floor:
    """All below ``height`` (m) along the z axis of the robot's root link."""

    height: float = 0.0


@dataclass(frozen=True)
class Box:
    """A box with its middle at ``centre`` (m), of ``size`` (m) along the axes x, y and z of the root link, or along
    ``axes``, three unit vectors in its frame."""

    name: str
    centre: tuple[float, float, float]
    size: tuple[float, float, float]
    axes: tuple[tuple[float, ...], ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True)
class Cylinder:
    """An upright cylinder about (x, y) of ``radius`` (m), from ``bottom`` to ``top`` (m): a keep-out volume."""

    name: str
    centre: tuple[float, float]
    radius: float
    bottom: float = -np.inf
    top: float = np.inf


Obstacle = Floor | Box | Cylinder


class Distances(Protocol):
    """Distances of the links of an arm to each other and to obstacles, for P pairs."""

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """The names of the P pairs: links, or a link and an obstacle; a pair may be there several times, by parts."""

    def distances(self, q: Array, /) -> Array:
        """Return distances (N, P) in m, negative where a pair overlaps, at positions q (N, n)."""


@runtime_checkable
class Steep(Distances, Protocol):
    """Distances that are known not to change faster than so much with the joints: what proves them between samples."""

    @property
    def steepest(self) -> Array:
        """The most that a distance changes with a joint, shape (P, n): m/rad, m/m."""


class Space(Distances, Protocol):
    """Distances with their derivatives: what the optimiser keeps to."""

    def gradients(self, q: Array, /) -> tuple[Array, Array]:
        """Return ``distances`` and their derivatives (N, P, n) by q."""


@dataclass(frozen=True)
class Nothing:
    """The space of an arm of ``joints`` whose bodies are not known: nothing can meet."""

    joints: int
    pairs: tuple[tuple[str, str], ...] = ()

    def distances(self, q: Array, /) -> Array:
        """Return no distances, shape (N, 0)."""
        return np.empty((len(q), 0))

    def gradients(self, q: Array, /) -> tuple[Array, Array]:
        """Return no distances, and none of their derivatives, shape (N, 0, n)."""
        return self.distances(q), np.empty((len(q), 0, self.joints))
