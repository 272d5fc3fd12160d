"""The links of a robot as traces that move: their surfaces, and the ellipsoids of their inertia."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from dynident.errors import brief
from dynident.excitation import Outline
from dynident.report.figures.canvas import AMBER, INK, Array, Trace, trace
from dynident.report.figures.scene import STILL, Faces, Mesh, Moving, solid

__all__ = ["Ellipsoid", "centres", "ellipsoids", "key", "lighter", "outlined", "path_of", "standing", "surface"]

ROUND, UP = 16, 8  # corners of a parallel of an ellipsoid, and steps from pole to pole
SMOOTH = 32  # corners of a circle around it
LIGHTER = 0.28  # share of the way to white
THIN = 0.02  # least half axis, as a share of the largest: what is drawn of a rod or plate


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """An ellipsoid in the frame of a ``body``, by its place in ``Arm.bodies``: its ``centre`` (3) and ``half`` axes (3)
    along the columns of ``axes`` (3, 3), in m, and its colour."""

    body: int
    centre: Array
    half: Array
    axes: Array
    colour: str

    __repr__ = brief

    def placed(self, points: Array) -> Array:
        """Return points (V, 3) of the unit ball on it."""
        half = np.maximum(self.half, THIN * self.half.max())
        return np.asarray(self.centre + (points * half) @ self.axes.T)


def surface(outline: Outline, name: str, colour: str, opacity: float = 1.0, **more: Any) -> Moving:
    """Return the surface of a body as it moves."""
    mesh = Mesh(name, outline.mesh.vertices, outline.mesh.triangles)
    body = np.full(len(mesh.vertices), outline.body, dtype=np.intp)
    return Moving(solid(mesh, colour, opacity, **more), mesh.vertices, body)


def lighter(colour: str) -> str:
    """Return a colour (#rrggbb) a little lighter, to tell neighbours of one colour apart."""
    parts = [int(colour[k : k + 2], 16) for k in (1, 3, 5)]
    return "#" + "".join(f"{round(one + LIGHTER * (255 - one)):02x}" for one in parts)


def standing(outline: Outline) -> Trace:
    """Return the surface of the root link, with all that is fixed to it."""
    return solid(Mesh(outline.link, outline.mesh.vertices, outline.mesh.triangles), STILL)


def ellipsoids(found: Sequence[Ellipsoid], name: str) -> Moving:
    """Return solid ellipsoids in one trace, each in its colour."""
    points, faces = _ball()
    mesh = Mesh(
        name,
        np.concatenate([one.placed(points) for one in found]),
        np.concatenate([faces + k * len(points) for k in range(len(found))]),
    )
    colours = [one.colour for one in found for _ in faces]
    body = np.repeat([one.body for one in found], len(points))
    return Moving(solid(mesh, found[0].colour, facecolor=colours, hoverinfo="skip"), mesh.vertices, body)


def outlined(found: Sequence[Ellipsoid], name: str) -> Moving:
    """Return ellipsoids as three circles each, in one trace; gaps are between them."""
    angle = 2 * np.pi * np.arange(SMOOTH + 1) / SMOOTH
    flat = np.stack((np.cos(angle), np.sin(angle), 0 * angle), axis=1)
    gap = np.full((1, 3), np.nan)
    circles = np.concatenate([part for k in range(3) for part in (np.roll(flat, k, axis=1), gap)])
    points = np.concatenate([one.placed(circles) for one in found])
    look = trace("scatter3d", mode="lines", line={"color": INK, "width": 3}, meta="ink", name=name, hoverinfo="skip")
    return Moving(look | {"showlegend": True}, points, np.repeat([one.body for one in found], len(circles)))


def centres(points: Mapping[int, Array], name: str, symbol: str) -> Moving:
    """Return points (3) of bodies as marks."""
    marker = {"color": INK, "size": 5, "symbol": symbol, "line": {"width": 1}}
    look = trace("scatter3d", mode="markers", marker=marker, meta="ink", name=name, hoverinfo="skip")
    body = np.array(list(points), dtype=np.intp)
    return Moving(look | {"showlegend": True}, np.array(list(points.values())), body)


def key(name: str, colour: str) -> Trace:
    """Return what shows a colour in the legend, and nothing else."""
    marker = {"color": colour, "size": 10, "symbol": "square"}
    nowhere = {"x": [None], "y": [None], "z": [None]}
    return (
        trace("scatter3d", mode="markers", marker=marker, name=name, hoverinfo="skip", showlegend=True, legendrank=1)
        | nowhere
    )


def path_of(points: Array) -> Trace:
    """Return a line through points (M, 3)."""
    x, y, z = points.astype(np.float32).T
    line = {"color": AMBER, "width": 3}
    return trace("scatter3d", x=x, y=y, z=z, mode="lines", line=line, name="path", hoverinfo="skip")


def _ball() -> tuple[Array, Faces]:
    """Return a ball of radius 1: points (V, 3) and triangles (F, 3)."""
    turn, up = 2 * np.pi * np.arange(ROUND) / ROUND, np.pi * np.arange(1, UP) / UP
    rings = [np.stack((np.sin(u) * np.cos(turn), np.sin(u) * np.sin(turn), np.full(ROUND, np.cos(u))), 1) for u in up]
    points = np.concatenate([*rings, [[0.0, 0, 1], [0, 0, -1]]])
    here, after = np.arange(ROUND), np.roll(np.arange(ROUND), -1)
    last = (UP - 2) * ROUND
    corners = [(len(points) - 2 + 0 * here, here, after), (len(points) - 1 + 0 * here, last + after, last + here)]
    for low in range(0, last, ROUND):
        high = low + ROUND
        corners += [(low + here, high + here, high + after), (low + here, high + after, low + after)]
    return points, np.concatenate([np.stack(three, axis=1) for three in corners])
