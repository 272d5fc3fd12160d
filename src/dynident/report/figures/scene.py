"""An arm along a path in three dimensions: triangles of its bodies, which the page moves, and what stands around it."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.report.figures.canvas import AMBER, GRID, TEMPLATE, Array, Drawing, Trace, plain, trace

__all__ = ["Mesh", "box", "capsule", "cylinder", "joined", "plate", "scene_figure"]

SIDES = 12  # of what is round
RINGS = 3  # of half a sphere
METAL = ("#8fa7c4", "#5f7da3")  # of bodies, in turn
STILL = "#9a9a9a"
HEIGHT = 620
Faces = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles of a body: ``vertices`` (V, 3) in m in its frame, and ``faces`` (F, 3), their places there."""

    name: str
    vertices: Array
    faces: Faces

    __repr__ = brief


def joined(name: str, meshes: Sequence[Mesh]) -> Mesh:
    """Return several meshes as one."""
    starts = np.cumsum([0, *(len(one.vertices) for one in meshes)])
    faces = [one.faces + start for one, start in zip(meshes, starts, strict=False)]
    return Mesh(name, np.concatenate([one.vertices for one in meshes]), np.concatenate(faces))


def capsule(name: str, start: Array, end: Array, radius: float) -> Mesh:
    """Return all points within ``radius`` of the segment from ``start`` to ``end`` (3), roughly."""
    along = np.asarray(end, dtype=float) - start
    length = float(np.linalg.norm(along))
    axis = along / length if length > 0 else np.array([0.0, 0.0, 1.0])
    latitude = np.linspace(-np.pi / 2, np.pi / 2, 2 * RINGS + 2)
    middles = np.where((latitude < 0)[:, None], start, end)
    return _turned(name, middles, radius * np.cos(latitude), radius * np.sin(latitude), axis)


def cylinder(name: str, start: Array, end: Array, radius: float) -> Mesh:
    """Return a cylinder with closed ends."""
    axis = (np.asarray(end, dtype=float) - start) / np.linalg.norm(np.asarray(end, dtype=float) - start)
    ends = np.stack([start, start, end, end])
    return _turned(name, ends, np.array([0.0, radius, radius, 0.0]), np.zeros(4), axis)


def _turned(name: str, middles: Array, radii: Array, heights: Array, axis: Array) -> Mesh:
    """Return rings about an axis (3), each with its middle (R, 3), radius (R) and height (R) above that."""
    side = np.cross(axis, np.eye(3)[int(np.abs(axis).argmin())])
    side /= np.linalg.norm(side)
    angle = 2 * np.pi * np.arange(SIDES) / SIDES
    circle = np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * np.cross(axis, side)
    rings = (middles + heights[:, None] * axis)[:, None] + radii[:, None, None] * circle
    k, j = np.meshgrid(np.arange(len(radii) - 1), np.arange(SIDES), indexing="ij")
    a, b = (k * SIDES + j).ravel(), (k * SIDES + (j + 1) % SIDES).ravel()
    faces = np.concatenate([np.stack([a, b + SIDES, b], axis=1), np.stack([a, a + SIDES, b + SIDES], axis=1)])
    return Mesh(name, rings.reshape(-1, 3), faces)


def box(name: str, centre: Array, size: Array) -> Mesh:
    """Return a box along the axes."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [face for a, b, c, d in sides for face in ((a, b, c), (a, c, d))]
    return Mesh(name, np.asarray(centre) + corners * size, np.array(faces))


def plate(name: str, height: float, reach: float) -> Mesh:
    """Return a square about the z axis."""
    corners = reach * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    return Mesh(name, corners + np.array([0.0, 0.0, height]), np.array([[0, 1, 2], [0, 2, 3]]))


def scene_figure(
    t: Array, moving: Mapping[int, Mesh], rotations: Array, origins: Array, still: Sequence[Mesh], path: Array
) -> Drawing:
    """Draw an arm that the page moves along its path: ``moving`` meshes by the place of their body, whose axes
    ``rotations`` (T, B, 3, 3) and ``origins`` (T, B, 3) are known at times t (T); ``still`` meshes; the ``path`` (M, 3)
    of the last body."""
    bodies = list(moving)
    data = [
        _solid(Mesh(mesh.name, mesh.vertices @ rotations[0, k].T + origins[0, k], mesh.faces), METAL[place % 2])
        for place, (k, mesh) in enumerate(moving.items())
    ]
    data += [_solid(mesh, STILL, 0.35 if place else 1.0) for place, mesh in enumerate(still)]
    data.append(
        trace(
            "scatter3d",
            x=path[:, 0],
            y=path[:, 1],
            z=path[:, 2],
            mode="lines",
            line={"color": AMBER, "width": 3},
            name="path",
            hoverinfo="skip",
        )
    )
    places = np.concatenate([rotations[:, bodies], origins[:, bodies, :, None]], axis=3)  # (T, moving, 3, 4)
    motion = {
        "t": _packed(t),
        "places": _packed(places),
        "vertices": [_packed(mesh.vertices) for mesh in moving.values()],
    }
    return Drawing(data, _layout(), motion)


def _solid(mesh: Mesh, colour: str, opacity: float = 1.0) -> Trace:
    x, y, z = mesh.vertices.T
    i, j, k = mesh.faces.T
    shine = {"ambient": 0.55, "diffuse": 0.7, "specular": 0.15, "roughness": 0.8}
    return trace(
        "mesh3d",
        x=x.astype(np.float32),
        y=y.astype(np.float32),
        z=z.astype(np.float32),
        i=i.astype(np.int32),
        j=j.astype(np.int32),
        k=k.astype(np.int32),
        color=colour,
        opacity=opacity,
        flatshading=True,
        lighting=shine,
        name=plain(mesh.name),
        hoverinfo="name",
    )


def _packed(values: Array) -> str:
    """Return numbers as single precision in base 64, which the page reads."""
    return b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode("ascii")


def _layout() -> dict[str, Any]:
    axis = {"backgroundcolor": "rgba(0, 0, 0, 0)", "gridcolor": GRID, "showspikes": False, "zerolinecolor": GRID}
    scene = {
        "aspectmode": "data",
        "dragmode": "turntable",
        "camera": {"eye": {"x": 1.15, "y": 0.95, "z": 0.55}},
        **{f"{one}axis": {**axis, "title": {"text": f"{one}, m"}} for one in "xyz"},
    }
    return {
        "template": TEMPLATE,
        "height": HEIGHT,
        "scene": scene,
        "showlegend": False,
        "hovermode": "closest",
        "margin": {"t": 0, "l": 0, "r": 0, "b": 0},
        "uirevision": "kept",
    }
