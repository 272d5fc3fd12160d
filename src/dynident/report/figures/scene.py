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

__all__ = ["Mesh", "box", "cylinder", "plate", "scene_figure"]

SIDES = 24  # of a cylinder
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


def cylinder(name: str, centre: Array, radius: float, bottom: float, top: float) -> Mesh:
    """Return an upright cylinder about ``centre`` (2)."""
    angle = 2 * np.pi * np.arange(SIDES) / SIDES
    circle = centre + radius * np.column_stack([np.cos(angle), np.sin(angle)])
    rings = [np.column_stack([xy, np.full(SIDES, z)]) for xy, z in ((circle, bottom), (circle, top))]
    middles = [[*centre, bottom], [*centre, top]]
    a, b = np.arange(SIDES), (np.arange(SIDES) + 1) % SIDES
    low, high = np.full(SIDES, 2 * SIDES), np.full(SIDES, 2 * SIDES + 1)
    sides = [(a, b, b + SIDES), (a, b + SIDES, a + SIDES), (b, a, low), (a + SIDES, b + SIDES, high)]
    return Mesh(name, np.concatenate([*rings, middles]), np.concatenate([np.stack(one, axis=1) for one in sides]))


def box(name: str, centre: Array, size: Array, axes: Array | None = None) -> Mesh:
    """Return a box along the rows of ``axes`` (3, 3), by default x, y and z."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [face for a, b, c, d in sides for face in ((a, b, c), (a, c, d))]
    turned = np.eye(3) if axes is None else axes
    return Mesh(name, np.asarray(centre) + (corners * size) @ turned, np.array(faces))


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
    font = {"family": "sans-serif", "size": 12}  # WebGL knows no inherited ones
    axis = {
        "tickfont": font,
        "backgroundcolor": "rgba(0, 0, 0, 0)",
        "gridcolor": GRID,
        "showspikes": False,
        "zerolinecolor": GRID,
    }
    scene = {
        "aspectmode": "data",
        "dragmode": "turntable",
        "camera": {"eye": {"x": 1.15, "y": 0.95, "z": 0.55}},
        **{f"{one}axis": {**axis, "title": {"text": f"{one}, m", "font": font}} for one in "xyz"},
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
