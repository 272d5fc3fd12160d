"""Distances of points to what stands around a robot: negative inside, with their derivatives."""

from __future__ import annotations

from collections.abc import Callable
from functools import singledispatch

import numpy as np
from numpy.typing import NDArray

from dynident.excitation.spaces.space import Box, Cylinder, Floor

__all__ = ["obstacle_name", "signed"]

Array = NDArray[np.float64]
Signed = Callable[[Array], tuple[Array, Array]]
LEAST = 1e-12  # m: below it there is no direction


def obstacle_name(obstacle: Floor | Box | Cylinder) -> str:
    """Return what an obstacle is called."""
    return "floor" if isinstance(obstacle, Floor) else obstacle.name


@singledispatch
def signed(obstacle: object) -> Signed:
    """Return the function from points (..., 3) to their distance (...) from an obstacle, negative inside, with its
    derivative (..., 3): a unit vector away from it."""
    raise TypeError(f"{type(obstacle).__name__} is no obstacle.")


@signed.register
def _(floor: Floor) -> Signed:
    def above(point: Array) -> tuple[Array, Array]:
        normal = np.zeros_like(point)
        normal[..., 2] = 1.0
        return point[..., 2] - floor.height, normal

    return above


@signed.register
def _(box: Box) -> Signed:
    centre, half, axes = np.array(box.centre), np.array(box.size) / 2, np.array(box.axes)

    def outside(point: Array) -> tuple[Array, Array]:
        away = (point - centre) @ axes.T
        distance, normal = _corner(np.abs(away) - half)
        return distance, (normal * np.where(away < 0, -1.0, 1.0)) @ axes

    return outside


@signed.register
def _(cylinder: Cylinder) -> Signed:
    def outside(point: Array) -> tuple[Array, Array]:
        x, y = point[..., 0] - cylinder.centre[0], point[..., 1] - cylinder.centre[1]
        reach = np.hypot(x, y)
        over, under = point[..., 2] - cylinder.top, cylinder.bottom - point[..., 2]
        distance, normal = _corner(np.stack((reach - cylinder.radius, np.maximum(over, under)), axis=-1))
        reach = np.maximum(reach, LEAST)
        radial, up = normal[..., 0] / reach, normal[..., 1] * np.where(over < under, -1.0, 1.0)
        return distance, np.stack((radial * x, radial * y, up), axis=-1)

    return outside


def _corner(beyond: Array) -> tuple[Array, Array]:
    """Return the distance (...) from the corner of the region where all of ``beyond`` (..., k) are negative, and its
    derivative (..., k) by these."""
    out = np.maximum(beyond, 0.0)
    distance = np.sqrt(np.einsum("...i,...i->...", out, out))
    inside = distance < LEAST
    nearest = np.arange(beyond.shape[-1]) == beyond.argmax(axis=-1)[..., None]
    normal = np.where(inside[..., None], nearest, out / np.maximum(distance, LEAST)[..., None])
    return np.where(inside, beyond.max(axis=-1), distance), normal
