"""An arm in three dimensions: triangles and lines of its bodies, which the page moves along recordings, and what stands
around it."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.models import RigidBodies
from dynident.report.figures.canvas import TEMPLATE, Array, Drawing, Trace, plain, trace

__all__ = ["METAL", "STILL", "Layer", "Mesh", "Moving", "Replay", "box", "cylinder", "plate", "scene_figure", "solid"]

SIDES = 24  # of a cylinder
METAL = ("#8fa7c4", "#5f7da3")  # of bodies, in turn
STILL = "#9a9a9a"
HEIGHT = 620
POSES = 60  # of a course, within whose reach the view stays
ROOM = 0.03  # share of the view around that
LINES = "#a3a9b0"  # of the grid: thin, as WebGL draws them
LIGHT = {"x": 600, "y": 1000, "z": 3000}
CUBE = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
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


@dataclass(frozen=True, eq=False)
class Moving:
    """A trace that moves with bodies: its ``points`` (V, 3), in m, each in the frame of the ``body`` (V) at that place
    in ``Arm.bodies``, -1 in that of the root link. Points that are nan are gaps of a line."""

    trace: Trace
    points: Array
    body: Faces

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class Replay:
    """A motion along which an arm is shown: positions q (T, n), in rad or m, at T even times from ``start`` to
    ``stop`` (s), under a ``name``."""

    name: str
    start: float
    stop: float
    q: Array

    __repr__ = brief


@dataclass(frozen=True)
class Layer:
    """What a reader can switch on: a ``name``, the moving traces that then are ``shown``, by their places, and those
    that are ``faded``."""

    name: str
    shown: tuple[int, ...]
    faded: tuple[int, ...]


def scene_figure(
    bodies: RigidBodies,
    replays: Sequence[Replay],
    moving: Sequence[Moving],
    still: Iterable[Trace] = (),
    layers: Sequence[Layer] = (),
    height: int = HEIGHT,
) -> Drawing:
    """Draw an arm as at the beginning of the first of its ``replays``, and give the page what it needs to move it along
    all of them: how its bodies follow each other, and their positions. What is ``still`` stays."""
    arm = bodies.arm
    still = list(still)
    data = [one.trace | dict(zip("xyz", _placed(bodies, replays[0].q[:1], one)[0].T, strict=True)) for one in moving]
    motion = {
        "bodies": {
            "parent": [-1 if body.parent is None else body.parent for body in arm.bodies],
            "slides": [body.joint.kind == "prismatic" for body in arm.bodies],
            "placement": _packed(np.array([body.placement[:3] for body in arm.bodies])),
            "axis": _packed(np.array([body.joint.axis for body in arm.bodies])),
        },
        "replays": [
            {"name": one.name, "start": one.start, "stop": one.stop, "q": _packed(one.q @ arm.drive.T + arm.rest)}
            for one in replays
        ],
        "moving": [{"points": _packed(one.points), "body": _runs(one.body)} for one in moving],
        "layers": [{"name": one.name, "shown": one.shown, "faded": one.faded} for one in layers],
    }
    lengths = _reach(bodies, replays, moving, still)
    return Drawing([*data, *still], _layout(lengths, height), motion)


def solid(mesh: Mesh, colour: str, opacity: float = 1.0, **more: Any) -> Trace:
    """Return a mesh as a trace."""
    x, y, z = mesh.vertices.T
    i, j, k = mesh.faces.T
    shine = {"ambient": 0.6, "diffuse": 0.7, "specular": 0.15, "roughness": 0.8}
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
        lightposition=LIGHT,
        name=plain(mesh.name),
        **{"hoverinfo": "name", **more},
    )


def _placed(bodies: RigidBodies, q: Array, one: Moving) -> Array:
    """Return the points (N, V, 3) of what moves at positions q (N, n)."""
    return bodies.placements(q).points(one.body, one.points).astype(np.float32)


def _runs(body: Faces) -> list[tuple[int, int]]:
    """Return bodies (V) as runs: each with the number of points that follow each other."""
    starts = np.flatnonzero(np.diff(body, prepend=-2))
    return [(int(body[k]), int(count)) for k, count in zip(starts, np.diff([*starts, len(body)]), strict=True)]


def _reach(
    bodies: RigidBodies, replays: Sequence[Replay], moving: Sequence[Moving], still: Sequence[Trace]
) -> list[tuple[float, float]]:
    """Return from where to where all is at any time, along x, y and z, so that the view need not change."""
    poses = np.concatenate([one.q[:: -(-len(one.q) // POSES)] for one in replays])
    place, found = bodies.placements(poses), []
    for one in (one for one in moving if one.trace.get("visible", True)):
        for body in np.unique(one.body):
            own = one.points[one.body == body]
            low, high = (edge(own, axis=0) for edge in (np.nanmin, np.nanmax))
            corners = np.where(CUBE, high, low)
            found.append(place.points(np.full(len(corners), body), corners).reshape(-1, 3))
    found += [np.stack([np.asarray(one[axis], dtype=float) for axis in "xyz"], axis=1) for one in still if "x" in one]
    every = np.concatenate(found)
    low, high = np.nanmin(every, axis=0), np.nanmax(every, axis=0)
    room = ROOM * float((high - low).max())
    return list(zip((low - room).tolist(), (high + room).tolist(), strict=True))


def _packed(values: Array) -> str:
    """Return numbers as single precision in base 64, which the page reads."""
    return b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode("ascii")


def _layout(lengths: Sequence[tuple[float, float]], height: int) -> dict[str, Any]:
    font = {"family": "sans-serif", "size": 12}  # WebGL knows no inherited ones
    sizes = np.array([high - low for low, high in lengths])
    axis = {
        "tickfont": font,
        "backgroundcolor": "rgba(0, 0, 0, 0)",
        "gridcolor": LINES,
        "showspikes": False,
        "zerolinecolor": LINES,
        "nticks": 5,
    }
    scene = {
        "aspectmode": "manual",
        "aspectratio": dict(zip("xyz", (sizes / sizes.max()).tolist(), strict=True)),
        "dragmode": "turntable",
        "camera": {"eye": {"x": 1.1, "y": 0.92, "z": 0.55}},
        **{
            f"{one}axis": {**axis, "range": between, "title": {"text": f"{one}, m", "font": font}}
            for one, between in zip("xyz", lengths, strict=True)
        },
    }
    return {
        "template": TEMPLATE,
        "height": height,
        "scene": scene,
        "showlegend": False,
        "hovermode": "closest",
        "margin": {"t": 0, "l": 0, "r": 0, "b": 0},
        "uirevision": "kept",
    }
