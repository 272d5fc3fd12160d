"""An arm in three dimensions: triangles and lines of its bodies, which the page moves along recordings, and what stands
around it."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.models import Mesh, Outline, RigidBodies, Solid, solid_surface
from dynident.models.robot_files import ShapeKind
from dynident.report.figures import AMBER, INK, TEMPLATE, Array, Drawing, Trace, plain, trace
from dynident.runtime import Noun

METAL = ("#8fa7c4", "#5f7da3")  # of bodies, in turn
STILL = "#9a9a9a"
HEIGHT = 620
RANGE_POSES = 60  # of a course, within whose reach the view stays
VIEW_MARGIN = 0.03  # share of the view around that
GRID_COLOUR = "#a3a9b0"  # of the grid: thin, as WebGL draws them
LIGHT = {"x": 600, "y": 1000, "z": 3000}
SHINE = {"ambient": 0.6, "diffuse": 0.7, "specular": 0.15, "roughness": 0.8}
CUBE_CORNERS = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)]
Faces = NDArray[np.intp]
CIRCLE_CORNERS = 32  # corners of a circle around an ellipsoid
LIGHTER_SHARE = 0.28  # share of the way to white
MIN_AXIS_RATIO = 0.02  # least half axis, as a share of the largest: what is drawn of a rod or plate


class MovingTrace(Noun):
    """A trace that moves with bodies.

    Its ``points`` (V, 3), in m, are each in the frame of the ``body`` (V), an index of ``Arm.bodies``, or -1 for
    the root link. Points that are NaN are gaps of a line.
    """

    trace: Trace
    points: Array
    body: Faces


class Replay(Noun):
    """A motion along which an arm is shown: positions ``q`` (T, n), in rad or m, at T even times from ``start`` to
    ``stop`` (s), with a ``name``.
    """

    name: str
    start: float
    stop: float
    q: Array


class Layer(Noun):
    """What a reader can switch on: its ``name``, and the indices of the moving traces that are then ``visible`` and
    ``faded``.
    """

    name: str
    visible: tuple[int, ...]
    faded: tuple[int, ...]


def scene_figure(
    bodies: RigidBodies,
    replays: Sequence[Replay],
    moving: Sequence[MovingTrace],
    still: Iterable[Trace] = (),
    layers: Sequence[Layer] = (),
) -> Drawing:
    """Draw an arm in the first pose of its first replay, with what stands ``still``.

    The figure also holds what the page needs to move the arm along all ``replays``: how its bodies follow each
    other, and their positions.
    """
    arm = bodies.arm
    still = list(still)
    data, start = [], bodies.placements(replays[0].q[:1])
    for part in moving:
        points = start.points(part.body, part.points).astype(np.float32)[0]
        data.append(part.trace | dict(zip("xyz", points.T, strict=True)))
    motion = {
        "bodies": {
            "parent": [-1 if body.parent is None else body.parent for body in arm.bodies],
            "slides": [body.joint.kind == "prismatic" for body in arm.bodies],
            "placement": _encode_floats(np.array([body.placement[:3] for body in arm.bodies])),
            "axis": _encode_floats(np.array([body.joint.axis for body in arm.bodies])),
        },
        "replays": [
            {"name": x.name, "start": x.start, "stop": x.stop, "q": _encode_floats(x.q @ arm.drive.T + arm.offset)}
            for x in replays
        ],
        "moving": [{"points": _encode_floats(part.points), "body": _body_runs(part.body)} for part in moving],
        "layers": [{"name": layer.name, "shown": layer.visible, "faded": layer.faded} for layer in layers],
    }
    lengths = _view_range(bodies, replays, moving, still)
    return Drawing([*data, *still], _scene_layout(lengths), motion)


def solid(name: str, mesh: Mesh, colour: str, opacity: float = 1.0, **more: Any) -> Trace:
    """Return a mesh as a trace."""
    places = dict(zip("xyz", mesh.vertices.T.astype(np.float32), strict=True))
    corners = dict(zip("ijk", mesh.triangles.T.astype(np.int32), strict=True))
    look = {"color": colour, "opacity": opacity, "flatshading": True, "lighting": SHINE, "lightposition": LIGHT}
    return trace("mesh3d", **places, **corners, **look, name=plain(name), **{"hoverinfo": "name", **more})


def _body_runs(body: Faces) -> list[tuple[int, int]]:
    """Return bodies (V) as runs: each body with the number of consecutive points that it has."""
    starts = np.flatnonzero(np.diff(body, prepend=-2))
    return [(int(body[k]), int(count)) for k, count in zip(starts, np.diff([*starts, len(body)]), strict=True)]


def _view_range(
    bodies: RigidBodies, replays: Sequence[Replay], moving: Sequence[MovingTrace], still: Sequence[Trace]
) -> list[tuple[float, float]]:
    """Return the range along x, y and z of everything at any time, so that the view need not change."""
    # A few poses are enough for the range
    poses = np.concatenate([part.q[:: -(-len(part.q) // RANGE_POSES)] for part in replays])
    place, corner_points = bodies.placements(poses), []
    for part in [part for part in moving if part.trace.get("visible", True)] or moving:
        for body in np.unique(part.body):
            body_points = part.points[part.body == body]
            # Move the corners of the box around a body's points instead of all points
            low, high = (edge(body_points, axis=0) for edge in (np.nanmin, np.nanmax))
            corners = np.where(CUBE_CORNERS, high, low)
            corner_points.append(place.points(np.full(len(corners), body), corners).reshape(-1, 3))
    corner_points += [
        np.stack([np.asarray(part[axis], dtype=float) for axis in "xyz"], axis=1) for part in still if "x" in part
    ]
    all_points = np.concatenate(corner_points)
    low, high = np.nanmin(all_points, axis=0), np.nanmax(all_points, axis=0)
    room = VIEW_MARGIN * float((high - low).max())
    return list(zip((low - room).tolist(), (high + room).tolist(), strict=True))


def _encode_floats(values: Array) -> str:
    """Return numbers as single precision in base 64, as the page reads them."""
    return b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode("ascii")


def _scene_layout(lengths: Sequence[tuple[float, float]]) -> dict[str, Any]:
    font = {"family": "sans-serif", "size": 12}  # WebGL knows no inherited ones
    sizes = np.array([high - low for low, high in lengths])
    axis = {
        "tickfont": font, "backgroundcolor": "rgba(0, 0, 0, 0)", "gridcolor": GRID_COLOUR, "showspikes": False,
        "zerolinecolor": GRID_COLOUR, "nticks": 5,
    }  # fmt: skip
    scene = {
        "aspectmode": "manual",
        "aspectratio": dict(zip("xyz", (sizes / sizes.max()).tolist(), strict=True)),
        "dragmode": "turntable",
        "camera": {"eye": {"x": 1.1, "y": 0.92, "z": 0.55}},
        **{
            f"{letter}axis": {**axis, "range": limits, "title": {"text": f"{letter}, m", "font": font}}
            for letter, limits in zip("xyz", lengths, strict=True)
        },
    }
    return {
        "template": TEMPLATE, "height": HEIGHT, "scene": scene, "showlegend": False, "hovermode": "closest",
        "margin": {"t": 0, "l": 0, "r": 0, "b": 0}, "uirevision": "kept",
    }  # fmt: skip


class Ellipsoid(Noun):
    """An ellipsoid in the frame of a ``body``, by its place in ``Arm.bodies``: its ``centre`` (3) and ``half`` axes (3)
    along the columns of ``axes`` (3, 3), in m, and its colour."""

    body: int
    centre: Array
    half: Array
    axes: Array
    colour: str

    def map_points(self, points: Array) -> Array:
        """Map points (V, 3) of the unit ball onto the ellipsoid."""
        # A rod or plate would vanish: half axes have a least length
        half = np.maximum(self.half, MIN_AXIS_RATIO * self.half.max())
        return np.asarray(self.centre + (points * half) @ self.axes.T)


def surface(outline: Outline, name: str, colour: str, **more: Any) -> MovingTrace:
    """Return the surface of a body as a trace that moves with it."""
    body = np.full(len(outline.mesh.vertices), outline.body, dtype=np.intp)
    return MovingTrace(solid(name, outline.mesh, colour, **more), outline.mesh.vertices, body)


def lighten_colour(colour: str) -> str:
    """Return a colour (#rrggbb) a little lighter, to tell neighbours of one colour apart."""
    parts = [int(colour[k : k + 2], 16) for k in (1, 3, 5)]
    return "#" + "".join(f"{round(channel + LIGHTER_SHARE * (255 - channel)):02x}" for channel in parts)


def root_surface(outline: Outline) -> Trace:
    """Return the surface of the root link, with all that is fixed to it."""
    return solid(outline.link, outline.mesh, STILL)


def solid_ellipsoids(ellipsoids: Sequence[Ellipsoid], name: str) -> MovingTrace:
    """Return solid ellipsoids in one trace, each in its colour."""
    ball = solid_surface(Solid("", 0, ShapeKind.ELLIPSOID, (1.0, 1.0, 1.0), np.eye(4)))
    points, faces = ball.vertices, ball.triangles
    vertices = np.concatenate([ellipsoid.map_points(points) for ellipsoid in ellipsoids])
    mesh = Mesh(vertices, np.concatenate([faces + k * len(points) for k in range(len(ellipsoids))]))
    colours = [ellipsoid.colour for ellipsoid in ellipsoids for _ in faces]
    body = np.repeat([ellipsoid.body for ellipsoid in ellipsoids], len(points))
    return MovingTrace(solid(name, mesh, ellipsoids[0].colour, facecolor=colours, hoverinfo="skip"), vertices, body)


def ellipsoid_circles(ellipsoids: Sequence[Ellipsoid], name: str) -> MovingTrace:
    """Return ellipsoids as three circles each, in one trace; gaps are between them."""
    angle = 2 * np.pi * np.arange(CIRCLE_CORNERS + 1) / CIRCLE_CORNERS
    flat = np.stack((np.cos(angle), np.sin(angle), 0 * angle), axis=1)
    gap = np.full((1, 3), np.nan)
    # One circle about each axis; NaN points separate them in one line
    circles = np.concatenate([part for k in range(3) for part in (np.roll(flat, k, axis=1), gap)])
    points = np.concatenate([ellipsoid.map_points(circles) for ellipsoid in ellipsoids])
    look = trace("scatter3d", mode="lines", line={"color": INK, "width": 3}, name=name, hoverinfo="skip")
    body = np.repeat([ellipsoid.body for ellipsoid in ellipsoids], len(circles))
    return MovingTrace(look | {"showlegend": True}, points, body)


def centre_marks(points: Mapping[int, Array], name: str, symbol: str) -> MovingTrace:
    """Return one point (3) per body as marks that move with the bodies."""
    marker = {"color": INK, "size": 5, "symbol": symbol, "line": {"width": 1}}
    look = trace("scatter3d", mode="markers", marker=marker, name=name, hoverinfo="skip")
    body = np.array(list(points), dtype=np.intp)
    return MovingTrace(look | {"showlegend": True}, np.array(list(points.values())), body)


def legend_key(name: str, colour: str) -> Trace:
    """Return a trace that shows a colour in the legend and nothing else."""
    marker = {"color": colour, "size": 10, "symbol": "square"}
    look = {"mode": "markers", "marker": marker, "name": name, "hoverinfo": "skip", "showlegend": True}
    return trace("scatter3d", **look, legendrank=1) | {"x": [None], "y": [None], "z": [None]}


def path_trace(points: Array) -> Trace:
    """Return a line through points (M, 3)."""
    x, y, z = points.astype(np.float32).T
    line = {"color": AMBER, "width": 3}
    return trace("scatter3d", x=x, y=y, z=z, mode="lines", line=line, name="path", hoverinfo="skip")
