"""Distances of the real shapes of an arm by Pinocchio and Coal: what checks a motion that was designed with capsules.

Nothing of ``clearance.py`` is used: Pinocchio moves the bodies, Coal finds the distances.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.excitation.spaces.capsules import still_boxes
from dynident.excitation.spaces.clearance import CapsuleSpace
from dynident.excitation.spaces.geometry import Geometry, Made, Mesh, Solid
from dynident.excitation.spaces.obstacles import obstacle_name
from dynident.excitation.spaces.pairing import CLEARANCE, always_near, candidates, spread
from dynident.excitation.spaces.space import Box, Floor, Obstacle
from dynident.models import RigidBodies
from dynident.models.robot_file import ShapeKind

__all__ = ["ExactSpace", "exact_space"]

Array = NDArray[np.float64]
Pair = tuple[int, int]
NEAR = 0.02  # m: nearer than this by their convex hulls, the triangles of meshes are compared
CONVEX = 0.999  # of the volume of its hull: a mesh is convex
FEW = 200  # poses in which the pairs are tried
HUGE = 100.0  # m: the length of a cylinder without an end


@dataclass(frozen=True, eq=False)
class ExactSpace:
    """The ``solids`` of an arm, and ``obstacles``, of which ``watched`` are pairs of places in (*solids, *obstacles).

    A mesh counts as its convex hull where that is 20 mm away, else as its triangles. ``left_out`` are pairs of links
    that touch in nearly every pose.
    """

    bodies: RigidBodies
    solids: tuple[Solid, ...]
    obstacles: tuple[Obstacle, ...]
    watched: tuple[Pair, ...]
    left_out: tuple[tuple[str, str], ...] = ()

    __repr__ = brief

    def __getstate__(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """The names of the P pairs: links, or a link and an obstacle."""
        names = [*(one.link for one in self.solids), *map(obstacle_name, self.obstacles)]
        return tuple((names[one], names[other]) for one, other in self.watched)

    def distances(self, q: Array, /) -> Array:
        """Return distances (N, P) in m, negative where a pair overlaps, at positions q (N, n)."""
        positions = self.bodies.arm.moved(q, 0 * q, 0 * q)[0]
        return np.array([self._scene.at(one) for one in positions]).reshape(len(q), len(self.watched))

    @cached_property
    def _scene(self) -> _Scene:
        return _Scene(self.bodies, self.solids, self.obstacles, self.watched)


def exact_space(
    geometry: Geometry,
    space: CapsuleSpace,
    lower: Array | None = None,
    upper: Array | None = None,
    clearance: float = CLEARANCE,
) -> ExactSpace | None:
    """Return the real shapes of an arm among the obstacles of ``space``; None where Pinocchio is not installed.

    A body of which only the joints are known has the capsules of ``space``. All pairs are watched but a body and the
    next one, and those that are near each other in nearly all of 200 poses (``capsule_space``) between ``lower`` and
    ``upper`` (n), or, where ``space`` does not watch the two bodies, so that no motion in it keeps them apart, nearer
    than the ``clearance`` (m) in any.
    """
    if any(importlib.util.find_spec(name) is None for name in ("pinocchio", "coal")):
        return None
    by_rule = [one for one in space.capsules if geometry.made.get(one.body) is Made.JOINTS]
    solids = (*geometry.solids, *(one.solid for one in by_rule))
    own = still_boxes(geometry)
    obstacles = tuple(one for one in space.obstacles if one not in own)
    parts = [*(one.body for one in solids), *map(obstacle_name, obstacles)]
    met = candidates(geometry.bodies, [one.body for one in solids])
    moving = [place for place, one in enumerate(solids) if one.body >= 0]
    near = [(one, len(solids) + other) for other in range(len(obstacles)) for one in moving]
    every = ExactSpace(geometry.bodies, solids, obstacles, (*met, *near))
    distances = every.distances(spread(geometry.bodies, lower, upper, FEW))
    meets = np.any(distances < clearance, axis=0).tolist()
    named = [frozenset((parts[one], parts[other])) for one, other in every.watched]
    lost = _unwatched(space, own) & {one for one, near in zip(named, meets, strict=True) if near}
    kept = ~always_near(distances, len(met), clearance) & np.array([one not in lost for one in named], dtype=bool)
    watched = tuple(pair for pair, stays in zip(every.watched, kept, strict=True) if stays)
    names = dict.fromkeys(pair for pair, stays in zip(every.pairs, kept, strict=True) if not stays)
    return replace(every, watched=watched, left_out=tuple(names))


def _unwatched(space: CapsuleSpace, own: Sequence[Box]) -> set[frozenset[int | str]]:
    """Return the pairs of bodies, or of a body and the name of an obstacle, of which capsules are not watched."""
    body = [one.body for one in space.capsules]
    other = [-1 if one in own else obstacle_name(one) for one in space.obstacles]
    meetings, encounters = space.unwatched
    met = (frozenset[int | str]((body[a], body[b])) for a, b in meetings)
    return {*met, *(frozenset[int | str]((body[a], other[b])) for a, b in encounters)}


class _Scene:
    """The shapes as Pinocchio and Coal hold them."""

    def __init__(
        self, bodies: RigidBodies, solids: Sequence[Solid], obstacles: Sequence[Obstacle], watched: Sequence[Pair]
    ) -> None:
        import coal
        import pinocchio as pin

        self._pin, self._coal = pin, coal
        self._model, self._shapes = _moving(bodies), pin.GeometryModel()
        self._meshes: dict[int, Any] = {}
        for k, solid in enumerate(solids):
            shape = _shape(solid)
            if solid.mesh is not None and (filled := _filled(solid.mesh)):
                triangles, shape = shape, _hull(shape)
                if filled < CONVEX:
                    self._meshes[k] = triangles
            self._add(shape, solid.body + 1, solid.frame)
        for obstacle in obstacles:
            shape, frame = _standing(obstacle)
            self._add(shape, 0, frame)
        for one, other in watched:
            self._shapes.addCollisionPair(pin.CollisionPair(one, other))
        self._watched = watched
        self._data, self._found = self._model.createData(), self._shapes.createData()

    def at(self, positions: Array) -> list[float]:
        """Return the distances of all pairs at the positions (B) of the bodies."""
        self._pin.computeDistances(self._model, self._data, self._shapes, self._found, positions)
        found = [one.min_distance for one in self._found.distanceResults]
        for k, distance in enumerate(found):
            if distance < NEAR and not self._meshes.keys().isdisjoint(self._watched[k]):
                found[k] = self._between(*self._watched[k], distance)
        return found

    def _between(self, one: int, other: int, hulls: float) -> float:
        """Return the distance of two shapes, meshes by their triangles; where they overlap, by their ``hulls``."""
        shapes, places = [], []
        for k in (one, other):
            placed = self._found.oMg[k]
            shapes.append(self._meshes.get(k) or self._shapes.geometryObjects[k].geometry)
            places.append(self._coal.Transform3s(placed.rotation, placed.translation))
        sides, coal = (shapes[0], places[0], shapes[1], places[1]), self._coal
        if hulls < 0 and coal.collide(*sides, coal.CollisionRequest(), coal.CollisionResult()):
            return hulls
        return float(coal.distance(*sides, coal.DistanceRequest(), coal.DistanceResult()))

    def _add(self, shape: Any, joint: int, frame: Array) -> None:
        place = self._pin.SE3(np.ascontiguousarray(frame[:3, :3]), frame[:3, 3].copy())
        name = str(len(self._shapes.geometryObjects))
        self._shapes.addGeometryObject(self._pin.GeometryObject(name, joint, place, shape))


def _moving(bodies: RigidBodies) -> Any:
    """Return Pinocchio's model of the bodies: one joint for each, in their order."""
    import pinocchio as pin

    model = pin.Model()
    for k, body in enumerate(bodies.arm.bodies):
        slides = body.joint.kind == "prismatic"
        axis = np.array(body.joint.axis)
        joint = pin.JointModelPrismaticUnaligned(axis) if slides else pin.JointModelRevoluteUnaligned(axis)
        place = pin.SE3(body.placement[:3, :3].copy(), body.placement[:3, 3].copy())
        model.addJoint(0 if body.parent is None else body.parent + 1, joint, place, str(k))
    return model


def _shape(solid: Solid) -> Any:
    import coal

    size = solid.size
    if solid.mesh is not None:
        return _triangles(solid.mesh)
    makers = {
        ShapeKind.BOX: lambda: coal.Box(*(2 * x for x in size)),
        ShapeKind.SPHERE: lambda: coal.Sphere(*size),
        ShapeKind.CYLINDER: lambda: coal.Cylinder(size[0], 2 * size[1]),
        ShapeKind.CAPSULE: lambda: coal.Capsule(size[0], 2 * size[1]),
        ShapeKind.ELLIPSOID: lambda: coal.Ellipsoid(*size),
    }
    return makers[solid.kind]()


def _triangles(mesh: Mesh) -> Any:
    import coal

    out = coal.BVHModelOBBRSS()
    out.beginModel(len(mesh.triangles), len(mesh.vertices))
    out.addVertices(mesh.vertices)
    out.addTriangles(mesh.triangles.astype(np.int64))
    out.endModel()
    return out


def _hull(triangles: Any) -> Any:
    triangles.buildConvexHull(True, "Qt")
    return triangles.convex


def _filled(mesh: Mesh) -> float:
    """Return the share of the volume of their convex hull that triangles enclose; 0 where they are flat."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(mesh.vertices).volume
    except (QhullError, ValueError):
        return 0.0
    one, two, three = (mesh.vertices[mesh.triangles[:, k]] - mesh.vertices.mean(axis=0) for k in range(3))
    volume = abs(np.einsum("ki,ki->", one, np.cross(two, three))) / 6
    return float(volume / hull)


def _standing(obstacle: Obstacle) -> tuple[Any, Array]:
    """Return the shape and frame (4, 4) of an obstacle."""
    import coal

    frame = np.eye(4)
    if isinstance(obstacle, Floor):
        return coal.Halfspace(np.array([0.0, 0.0, 1.0]), obstacle.height), frame
    if isinstance(obstacle, Box):
        frame[:3, :3], frame[:3, 3] = np.array(obstacle.axes).T, obstacle.centre
        return coal.Box(*obstacle.size), frame
    low, high = np.clip((obstacle.bottom, obstacle.top), -HUGE, HUGE)
    frame[:3, 3] = *obstacle.centre, (low + high) / 2
    return coal.Cylinder(obstacle.radius, float(high - low)), frame
