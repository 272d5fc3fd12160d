"""Capsules around the links of an arm, from which its distances are computed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from dynident.models.geometry import Balls, Box, Capsule, Geometry, Mesh, ShapeSource, Solid
from dynident.models.rigid_bodies import RigidBodies
from dynident.models.robot_files import ShapeKind
from dynident.runtime import Noun
from dynident.runtime.arrays import Array

CIRCLE_POINTS = 16  # points around a circle that stands for a round shape
CUT_HEIGHTS = (0.3, 0.5, 0.7)  # of the length of a mesh, where it is cut


def bounding_balls(solid: Solid) -> Balls:
    """Return balls whose hull contains a solid, in the frame of its body; hardly more than are needed."""
    if solid.mesh is not None:
        return _point_balls(_to_body_frame(solid.mesh.vertices, solid.frame))
    size = np.array(solid.size)
    if solid.kind is ShapeKind.BOX:
        return _point_balls(_to_body_frame(size * (2.0 * np.indices((2, 2, 2)).reshape(3, -1).T - 1), solid.frame))
    if solid.kind is ShapeKind.SPHERE:
        return Balls(_to_body_frame(np.zeros((1, 3)), solid.frame), size)
    ends = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]) * size[-1]
    if solid.kind is ShapeKind.CAPSULE:
        return Balls(_to_body_frame(ends, solid.frame), np.full(2, size[0]))
    angles = 2 * np.pi * np.arange(CIRCLE_POINTS) / CIRCLE_POINTS
    # a polygon around the circle, so that the hull contains the round shape
    ring = np.stack((np.cos(angles), np.sin(angles), 0 * angles), axis=1) / np.cos(np.pi / CIRCLE_POINTS)
    if solid.kind is ShapeKind.CYLINDER:
        return _point_balls(_to_body_frame((size[0] * ring + ends[:, None]).reshape(-1, 3), solid.frame))
    elevations = np.pi * (np.arange(CIRCLE_POINTS // 2 + 1) / (CIRCLE_POINTS // 2) - 0.5)
    sphere = ring * np.cos(elevations)[:, None, None] + np.array([0.0, 0.0, 1.0]) * np.sin(elevations)[:, None, None]
    return _point_balls(_to_body_frame(size / np.cos(np.pi / CIRCLE_POINTS) * sphere.reshape(-1, 3), solid.frame))


def cut_halves(solid: Solid) -> Iterator[tuple[Balls, Balls]]:
    """Yield the two sides of a mesh at planes across its principal axes; nothing for a simple shape."""
    if solid.mesh is None:
        return
    points = _to_body_frame(solid.mesh.vertices, solid.frame)
    edges = np.concatenate([solid.mesh.triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    for axis in np.linalg.eigh(np.cov(points.T, bias=True))[1].T:
        along = points @ axis
        for share in CUT_HEIGHTS:
            height = along - (along.min() + share * np.ptp(along))
            # edges that cross the plane: both halves get the crossing points, so that their hulls contain the whole
            # surface
            crossing = edges[height[edges].prod(axis=1) < 0]
            fraction = height[crossing[:, :1]] / (height[crossing[:, :1]] - height[crossing[:, 1:]])
            crossing_points = points[crossing[:, 0]] + fraction * (points[crossing[:, 1]] - points[crossing[:, 0]])
            sides = (np.concatenate((points[side], crossing_points)) for side in (height <= 0, height >= 0))
            low, high = (_point_balls(side) for side in sides)
            yield low, high


def _point_balls(centres: Array) -> Balls:
    return Balls(centres, np.zeros(len(centres)))


def _to_body_frame(points: Array, frame: Array) -> Array:
    return np.asarray(points @ frame[:3, :3].T + frame[:3, 3])


LINK_RADIUS_SHARE = 0.1  # radius of a link of unknown shape, as a share of the arm's reach
DEFAULT_RADIUS = 0.05  # m: of an arm without reach
MAX_MERGED_VOLUME = 1.0  # two capsules become one of up to so many times their volume
MAX_CUT_VOLUME = 0.8  # a mesh is cut in two where that leaves less than this share of the volume


class _BodyPart(Noun):
    """A part of a body: its link, the balls that it occupies, and the capsule around them."""

    link: str
    balls: Balls
    capsule: Capsule


def body_capsules(geometry: Geometry) -> tuple[Capsule, ...]:
    """Return capsules that contain the solids of an arm, body by body.

    A mesh is cut in two where that saves much volume; capsules of a body that are hardly smaller than one
    around both are merged. Boxes of the root link are left to ``fixed_boxes``. A body of which only the
    joints are known (``ShapeSource.JOINTS``) has one capsule around the origins of its links and of the
    joints that it carries, with the radius of ``default_link_radius``.
    """
    out: list[Capsule] = []
    for body, source in geometry.sources.items():
        solids = [shape for shape in geometry.solids if shape.body == body and not _is_fixed_box(shape)]
        parts = [part for solid in solids for part in _split_solid(solid)]
        if source is ShapeSource.JOINTS:
            balls = _default_balls(geometry, body)
            parts.append(_BodyPart(geometry.link(body), balls, balls.capsule()))
        out += [replace(part.capsule, link=part.link, body=body) for part in _merge_parts(parts, geometry.link(body))]
    return tuple(out)


def fixed_boxes(geometry: Geometry) -> tuple[Box, ...]:
    """Return the boxes of links that stand still, such as a table: a capsule would fit them badly."""
    return tuple(
        Box(
            solid.link,
            (float(solid.frame[0, 3]), float(solid.frame[1, 3]), float(solid.frame[2, 3])),
            (2 * solid.size[0], 2 * solid.size[1], 2 * solid.size[2]),
            tuple(tuple(axis.tolist()) for axis in solid.frame[:3, :3].T),
        )
        for solid in geometry.solids
        if _is_fixed_box(solid)
    )


def joint_rod(geometry: Geometry, body: int) -> Capsule:
    """Return the capsule that stands for a body of which only the joints are known, in drawings.

    It is around the joints or, where the body carries none, reaches to its centre of mass, if the file has
    that.
    """
    capsule, link = _default_balls(geometry, body).quick_capsule(), geometry.link(body)
    theta = geometry.bodies.arm.bodies[body].theta if body >= 0 else np.zeros(10)
    is_short = np.linalg.norm(capsule.end - capsule.start) < capsule.radius
    end = theta[1:4] / theta[0] if is_short and np.isfinite(theta).all() and theta[0] > 0 else capsule.end
    return replace(capsule, link=link, body=body, end=end)


def default_link_radius(bodies: RigidBodies) -> float:
    """Return the radius (m) of a link of unknown shape: 10 % of the longest chain of joints from the first on."""
    reach: list[float] = []
    for body in bodies.arm.bodies:
        distance = 0.0 if body.parent is None else reach[body.parent] + float(np.linalg.norm(body.placement[:3, 3]))
        reach.append(distance)
    return LINK_RADIUS_SHARE * max(reach) or DEFAULT_RADIUS


def _default_balls(geometry: Geometry, body: int) -> Balls:
    arm = geometry.bodies.arm
    origins = [node.frame[:3, 3] for node in geometry.places if node.body == body]
    joint_origins = [
        node.placement[:3, 3] for node in arm.bodies if (-1 if node.parent is None else node.parent) == body
    ]
    centres = np.array([*origins, *joint_origins])
    return Balls(centres, np.full(len(centres), default_link_radius(geometry.bodies)))


def _is_fixed_box(solid: Solid) -> bool:
    return solid.body == -1 and solid.kind is ShapeKind.BOX


def _split_solid(solid: Solid) -> list[_BodyPart]:
    """Return a solid as one part, or as two where that saves volume."""
    balls = bounding_balls(solid)
    capsule = balls.capsule()
    # three cheap fits choose the cut, the exact fit is done once for the best
    halves = min(cut_halves(solid), key=lambda pair: sum(half.quick_capsule().volume for half in pair), default=None)
    if halves is not None:
        pair = [half.capsule() for half in halves]
        if sum(half.volume for half in pair) < MAX_CUT_VOLUME * capsule.volume:
            return [_BodyPart(solid.link, *half) for half in zip(halves, pair, strict=True)]
    return [_BodyPart(solid.link, balls, capsule)]


def _merge_parts(parts: list[_BodyPart], body: str) -> list[_BodyPart]:
    """Merge parts two by two as long as that costs little volume; a part of two links is the ``body``'s."""
    # merge the pair that costs least volume, by the cheap fit, until the exact fit says that it does not pay
    while len(parts) > 1:
        trials = []
        for first, second in combinations(parts, 2):
            balls, volume = Balls.join(first.balls, second.balls), first.capsule.volume + second.capsule.volume
            trials.append((balls.quick_capsule().volume / volume, volume, balls, first, second))
        _, volume, balls, first, second = min(trials, key=lambda pair: pair[0])
        around = balls.capsule()
        if around.volume > MAX_MERGED_VOLUME * volume:
            break
        link = first.link if first.link == second.link else body
        parts = [_BodyPart(link, balls, around), *(part for part in parts if part not in (first, second))]
    return parts


MAX_TRIANGLES = 600  # triangles of a body
CIRCLE_CORNERS, CAP_RINGS = 12, 3  # corners of a circle, and rings of a half ball
CELL_RATIO, MAX_CELL_STEPS = 0.8, 40  # steps between sizes of cells


class Outline(Noun):
    """Surface of a body in its frame: ``mesh.vertices`` (V, 3) in m and ``mesh.triangles`` (F, 3).

    ``body`` is the index in ``Arm.bodies`` (-1: the root link).
    """

    link: str
    body: int
    mesh: Mesh


def outlines(
    geometry: Geometry, capsules: Sequence[Capsule] | None = None, max_triangles: int = MAX_TRIANGLES
) -> tuple[Outline, ...]:
    """Return the surfaces of the bodies of an arm, of about ``max_triangles`` each.

    They are those of its solids or, where only the joints are known, of its ``capsules``. Without capsules,
    ``joint_rod`` is added to what is known of the solids.
    """
    out = []
    for body, source in geometry.sources.items():
        parts = [solid_surface(shape) for shape in geometry.solids if shape.body == body]
        if source is ShapeSource.JOINTS and capsules is None:
            parts.append(solid_surface(joint_rod(geometry, body).solid))
        elif source is ShapeSource.JOINTS:
            parts = [solid_surface(shape.solid) for shape in capsules or () if shape.body == body]
        if parts:
            parts = [simplify_mesh(shape, max(max_triangles // len(parts), 4)) for shape in parts]
            starts = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])
            triangles = [part.triangles + start for part, start in zip(parts, starts, strict=True)]
            mesh = Mesh(np.concatenate([part.vertices for part in parts]), np.concatenate(triangles))
            out.append(Outline(geometry.link(body), body, mesh))
    return tuple(out)


def simplify_mesh(mesh: Mesh, max_triangles: int = MAX_TRIANGLES) -> Mesh:
    """Simplify a mesh to at most ``max_triangles``, or not at all where no size of cells gives so few.

    Corners in one cell of a grid become their mean, and triangles without an area are removed (Rossignac and
    Borrel, 1993).
    """
    size, coarse = float(np.ptp(mesh.vertices, axis=0).max()), mesh
    # cells of about this size give as many triangles as are allowed; grow them until they do
    cell = size / max_triangles**0.5 / 2
    for _ in range(MAX_CELL_STEPS):
        if len(coarse.triangles) <= max_triangles:
            break
        coarse, cell = _cluster_vertices(mesh, cell), cell / CELL_RATIO
    return coarse


def _cluster_vertices(mesh: Mesh, cell: float) -> Mesh:
    cells = np.round(mesh.vertices / cell).astype(np.int64)
    cells -= cells.min(axis=0)
    cell_counts = cells.max(axis=0) + 1
    # one number is found faster than three
    coordinate = (cells[:, 0] * cell_counts[1] + cells[:, 1]) * cell_counts[2] + cells[:, 2]
    _, cluster, count = np.unique(coordinate, return_inverse=True, return_counts=True)
    means = np.stack([np.bincount(cluster, coordinate) for coordinate in mesh.vertices.T], axis=1) / count[:, None]
    triangles = cluster[mesh.triangles]
    # triangles with two corners in one cell have no area; those that became equal are kept once
    has_area = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    _, first_rows = np.unique(np.sort(triangles[has_area], axis=1), axis=0, return_index=True)
    return Mesh(means, triangles[has_area][np.sort(first_rows)])


def solid_surface(solid: Solid) -> Mesh:
    """Return the surface of a solid in the frame of its body."""
    size = np.array(solid.size)
    if solid.mesh is not None:
        mesh = solid.mesh
    elif solid.kind is ShapeKind.BOX:
        mesh = _box_surface(size)
    elif solid.kind is ShapeKind.CAPSULE:
        mesh = _capsule_surface(size[1], size[0])
    elif solid.kind is ShapeKind.CYLINDER:
        mesh = _revolve(np.array([[0, -size[1]], [size[0], -size[1]], [size[0], size[1]], [0, size[1]]]))
    else:
        ball = _capsule_surface(0.0, 1.0)
        mesh = Mesh(ball.vertices * size, ball.triangles)
    return Mesh(mesh.vertices @ solid.frame[:3, :3].T + solid.frame[:3, 3], mesh.triangles)


def _capsule_surface(half: float, radius: float) -> Mesh:
    """Return the surface of a capsule along z about the origin."""
    up = np.linspace(0.0, np.pi / 2, CAP_RINGS + 1)
    cap = radius * np.stack((np.cos(up), np.sin(up)), axis=1) + np.array([0.0, half])
    return _revolve(np.concatenate((cap[::-1] * np.array([1.0, -1.0]), cap)))


def _revolve(profile: Array) -> Mesh:
    """Return the surface of revolution of a profile (K, 2), distance from and height along z."""
    angles = 2 * np.pi * np.arange(CIRCLE_CORNERS) / CIRCLE_CORNERS
    ring = np.stack((np.cos(angles), np.sin(angles), 0 * angles), axis=1)
    points = profile[:, None, :1] * ring + profile[:, None, 1:] * np.array([0.0, 0.0, 1.0])
    indices = np.arange(len(points) * CIRCLE_CORNERS).reshape(-1, CIRCLE_CORNERS)
    # each quadrilateral between two rings is two triangles with the same orientation
    low, high = indices[:-1], indices[1:]
    after_low, after_high = np.roll(low, -1, axis=1), np.roll(high, -1, axis=1)
    sides = np.stack(((low, after_low, after_high), (low, after_high, high))).transpose(0, 2, 3, 1)
    vertices = points.reshape(-1, 3)
    # equal corners are merged, and triangles that have no area removed
    return _cluster_vertices(Mesh(vertices, sides.reshape(-1, 3)), 1e-9 + 1e-6 * float(np.ptp(vertices, axis=0).max()))


def _box_surface(half: Array) -> Mesh:
    corners = (2.0 * np.indices((2, 2, 2)).reshape(3, -1).T - 1) * half
    faces = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    return Mesh(corners, np.concatenate((faces[:, [0, 1, 2]], faces[:, [0, 2, 3]])))
