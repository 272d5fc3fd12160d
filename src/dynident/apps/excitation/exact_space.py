"""Distances of the real shapes of an arm by Pinocchio and Coal, to check a motion that was designed with capsules.

Nothing of ``clearance.py`` is used: Pinocchio moves the bodies, Coal computes the distances.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from dataclasses import fields, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.apps.excitation.clearance import CapsuleSpace, Integers, candidate_pairs
from dynident.models import Box, Capsule, Floor, Geometry, Mesh, Obstacle, RigidBodies, ShapeSource
from dynident.models.capsules import body_capsules, fixed_boxes
from dynident.models.geometry import Solid, obstacle_solid
from dynident.models.robot_files import ShapeKind
from dynident.runtime import ConfigError, Noun
from dynident.runtime.arrays import Array

SAMPLE_POSES = 600
# m: what is kept free, and more than that by which links are near each other
DEFAULT_CLEARANCE, ADJACENT_DISTANCE = 0.01, 0.01
MIN_NEAR_SHARE = 0.9  # share of the poses in which links are near each other that are left out
MAX_OBSTACLE_DEPTH = 0.15  # m inside an obstacle: more than a link reaches that is mounted on it
DEFAULT_HALF_RANGE = np.pi  # rad or m: the range of a joint without limits, to both sides
TRIANGLE_DISTANCE = 0.02  # m: nearer than this by their convex hulls, the triangles of meshes are compared
MIN_CONVEX_SHARE = 0.999  # of the volume of its hull: a mesh is convex
TRIAL_POSES = 200  # poses in which the pairs are tried
ENDLESS_CYLINDER_REACH = 100.0  # m: how far a cylinder without an end goes


def build_capsule_space(
    bodies: RigidBodies,
    capsules: Sequence[Capsule],
    obstacles: Sequence[Obstacle] = (),
    poses: Array | None = None,
    own_boxes: Sequence[Box] = (),
    clearance: float = DEFAULT_CLEARANCE,
) -> CapsuleSpace:
    """Return the distances of an arm whose links have these capsules, with the pairs to be watched.

    These are all pairs of links, but not a body and the next one (of those that have capsules), and all pairs of a
    moving link and an obstacle. Left out, and named, are links that in at least 90 % of the ``poses`` (N, n) are nearer
    than the ``clearance`` (m) and 10 mm, because they are parts of a wrist, and links that are nearer to an obstacle
    than the clearance in all poses, because they stand there. By default the poses are spread over the range of the
    file. ``own_boxes`` are parts of links that stand still.

    Raises ConfigError for an obstacle that the end of the arm is at in all poses, or another link 150 mm inside it.
    """
    # boxes of its own count as parts of the root link here
    parts = [*(capsule.body for capsule in capsules), *(-1 for _ in own_boxes)]
    pairs, link_count = candidate_pairs(bodies, parts, len(obstacles))
    pairs = pairs[np.argsort(np.maximum(pairs[:, 1], len(capsules) - 1), kind="stable")]  # obstacle by obstacle
    # first watch every pair, then drop those that are near each other by construction
    full_space = CapsuleSpace(bodies, tuple(capsules), (*own_boxes, *obstacles), pairs, pairs[:0])
    distances = full_space.distances(sample_robot_poses(bodies) if poses is None else poses)
    is_near = always_near_mask(distances, link_count, clearance)
    for k in link_count + np.flatnonzero(is_near[link_count:]):
        _refuse_within(full_space, pairs[k], float(distances[:, k].max()))
    return replace(full_space, watched=pairs[~is_near], unwatched=pairs[is_near])


def _refuse_within(space: CapsuleSpace, pair: Integers, distance: float) -> None:
    """Raise ConfigError where a link at the end of the arm is at an obstacle in every pose, or another deep inside it.

    They are a ``pair`` by index, whose largest ``distance`` is given (m).
    """
    inner_bodies = {body.parent for body in space.bodies.arm.bodies}
    capsule, obstacle = space.capsules[pair[0]], space.obstacles[pair[1] - len(space.capsules)]
    if capsule.body not in inner_bodies or distance < -MAX_OBSTACLE_DEPTH:
        depth = f"overlaps it by {-1e3 * distance:.0f} mm or more"
        relation = depth if distance < 0 else "is nearer than the clearance"
        raise ConfigError(
            f"{obstacle.name!r}: in every pose {capsule.link!r} {relation}, so that no motion keeps "
            "clear of it. Correct its place and size, in m along the axes of the root link, or leave it out."
        )


def build_space(
    geometry: Geometry,
    obstacles: Sequence[Obstacle] = (),
    poses: Array | None = None,
    clearance: float = DEFAULT_CLEARANCE,
) -> CapsuleSpace:
    """Return the distances of an arm with these shapes, by capsules and the boxes of links that stand still.

    The pairs are those of ``build_capsule_space``.
    """
    capsules, own_boxes = body_capsules(geometry), fixed_boxes(geometry)
    return build_capsule_space(geometry.bodies, capsules, obstacles, poses, own_boxes, clearance)


def always_near_mask(distances: Array, link_count: int, clearance: float) -> NDArray[np.bool_]:
    """Return which pairs (P) are near each other by construction, from ``distances`` (N, P) in many poses.

    The first ``link_count`` pairs are of two links.
    """
    # neighbouring links of a wrist are near in most poses; an obstacle counts only where a link is always at it
    usually_near = np.mean(distances < clearance + ADJACENT_DISTANCE, axis=0) >= MIN_NEAR_SHARE
    return np.where(np.arange(distances.shape[1]) < link_count, usually_near, (distances < clearance).all(axis=0))


def sample_robot_poses(bodies: RigidBodies) -> Array:
    """Return poses (N, n) spread evenly over the range of the joints in the robot file."""
    limits = [bodies.limits[joint.name] for joint in bodies.joints]
    ends = np.array([(limit.lower, limit.upper) for limit in limits], dtype=float).reshape(-1, 2)
    return sample_poses(*np.where(np.isfinite(ends), ends, (-DEFAULT_HALF_RANGE, DEFAULT_HALF_RANGE)).T)


def sample_poses(lower: Array, upper: Array, count: int = SAMPLE_POSES) -> Array:
    """Return poses (count, n) that fill the range of the joints evenly: the same ones each time, fewer or more.

    An additive recurrence by powers of the root of x^(n + 1) = x + 1 (M. Roberts, 2018).
    """
    n, root = len(lower), 2.0
    # fixed-point iteration for the root: the generalised golden ratio
    for _ in range(40):
        root = (1 + root) ** (1 / (n + 1))
    steps = root ** -np.arange(1.0, n + 1)
    share = (0.5 + np.arange(1, count + 1)[:, None] * steps) % 1.0
    return np.asarray(lower + share * (upper - lower))


class ExactSpace(Noun):
    """The ``solids`` of an arm, and ``obstacles``; ``watched`` are pairs (P, 2) of indices in (*solids, *obstacles).

    A mesh counts as its convex hull where that is 20 mm away, else as its triangles. ``left_out`` are pairs
    of links that touch in nearly every pose.
    """

    bodies: RigidBodies
    solids: tuple[Solid, ...]
    obstacles: tuple[Obstacle, ...]
    watched: Integers
    left_out: tuple[tuple[str, str], ...] = ()

    def __getstate__(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """Names of the P pairs: two links, or a link and an obstacle."""
        names = [*(element.link for element in self.solids), *(obstacle.name for obstacle in self.obstacles)]
        return tuple((names[element], names[partner]) for element, partner in self.watched)

    def distances(self, q: Array, /) -> Array:
        """Return the distances (N, P) in m, negative where a pair overlaps, at positions q (N, n)."""
        positions = self.bodies.arm.body_states(q, 0 * q, 0 * q)[0]
        return np.array([self._scene.pose_distances(pose) for pose in positions]).reshape(len(q), len(self.watched))

    @cached_property
    def _scene(self) -> _CollisionScene:
        return _CollisionScene(self.bodies, self.solids, self.obstacles, self.watched)


def exact_space(
    geometry: Geometry, space: CapsuleSpace, poses: Array | None = None, clearance: float = DEFAULT_CLEARANCE
) -> ExactSpace | None:
    """Return the real shapes of an arm among the obstacles of ``space``; None where Pinocchio is not installed.

    A body of which only the joints are known has the capsules of ``space``. All pairs are watched but a body
    and the next one, and those that are near each other in nearly all of the first 200 ``poses``, as those
    of ``build_capsule_space``. Where ``space`` does not watch two bodies, so that no motion in it
    keeps them apart, a pair is left out that is nearer than the ``clearance`` (m) in any of the poses.
    """
    if any(importlib.util.find_spec(name) is None for name in ("pinocchio", "coal")):
        return None
    default_capsules = [
        element for element in space.capsules if geometry.sources.get(element.body) is ShapeSource.JOINTS
    ]
    solids = (*geometry.solids, *(element.solid for element in default_capsules))
    own_boxes = fixed_boxes(geometry)
    obstacles = space.obstacles[len(own_boxes) :]
    parts = [element.body for element in solids]
    pairs, link_count = candidate_pairs(geometry.bodies, parts, len(obstacles))
    full_space = ExactSpace(geometry.bodies, solids, obstacles, pairs)
    poses = sample_robot_poses(geometry.bodies) if poses is None else poses
    distances = full_space.distances(poses[:TRIAL_POSES])
    # where the capsules of two bodies are not watched, no motion keeps them apart: leave them out here as well
    obstacle_names = [obstacle.name for obstacle in obstacles]
    body_pairs = _named_pairs(pairs, [*parts, *obstacle_names])
    touching_pairs = {body_pairs[k] for k in np.flatnonzero(np.any(distances < clearance, axis=0))}
    capsule_bodies = [capsule.body for capsule in space.capsules]
    unwatched_pairs = _named_pairs(space.unwatched, [*capsule_bodies, *(-1 for _ in own_boxes), *obstacle_names])
    unavoidable = touching_pairs.intersection(unwatched_pairs)
    is_left_out = always_near_mask(distances, link_count, clearance)
    is_left_out |= np.array([pair in unavoidable for pair in body_pairs], dtype=bool)
    left_out = dict.fromkeys(full_space.pairs[k] for k in np.flatnonzero(is_left_out))
    return replace(full_space, watched=pairs[~is_left_out], left_out=tuple(left_out))


def _named_pairs(pairs: Integers, names: Sequence[int | str]) -> list[frozenset[int | str]]:
    """Return pairs by index as pairs of bodies, or of a body and the name of an obstacle."""
    return [frozenset((names[first], names[second])) for first, second in pairs]


class _CollisionScene:
    """The shapes as objects of Pinocchio and Coal."""

    def __init__(
        self, bodies: RigidBodies, solids: Sequence[Solid], obstacles: Sequence[Obstacle], watched: Integers
    ) -> None:
        import coal
        import pinocchio as pin

        self._pin, self._coal = pin, coal
        self._model, self._shapes = _pinocchio_arm(bodies), pin.GeometryModel()
        self._meshes: dict[int, Any] = {}
        for k, solid in enumerate(solids):
            shape = _coal_shape(solid)
            # distances of convex hulls are fast; triangles are kept for meshes that are not convex
            if solid.mesh is not None and (hull_share := _hull_fill_share(solid.mesh)):
                shape.buildConvexHull(True, "Qt")
                if hull_share < MIN_CONVEX_SHARE:
                    self._meshes[k] = shape
                shape = shape.convex
            self._add(shape, solid.body + 1, solid.frame)
        for obstacle in obstacles:
            if isinstance(obstacle, Floor):
                self._add(coal.Halfspace(np.array([0.0, 0.0, 1.0]), obstacle.height), 0, np.eye(4))
            else:
                solid = obstacle_solid(obstacle, ENDLESS_CYLINDER_REACH)
                self._add(_coal_shape(solid), 0, solid.frame)
        self._watched = [(int(first), int(second)) for first, second in watched]
        for first, second in self._watched:
            self._shapes.addCollisionPair(pin.CollisionPair(first, second))
        self._data, self._found = self._model.createData(), self._shapes.createData()

    def pose_distances(self, positions: Array) -> list[float]:
        """Return the distances of all pairs at the positions (B) of the bodies."""
        self._pin.computeDistances(self._model, self._data, self._shapes, self._found, positions)
        distances = [result.min_distance for result in self._found.distanceResults]
        # the hull is an inner bound of the distance: only near contact do the triangles matter
        for k, distance in enumerate(distances):
            if distance < TRIANGLE_DISTANCE and not self._meshes.keys().isdisjoint(self._watched[k]):
                distances[k] = self._between(*self._watched[k], distance)
        return distances

    def _between(self, first: int, second: int, hull_distance: float) -> float:
        """Return the distance of two shapes, meshes by their triangles; where they overlap, ``hull_distance``."""
        shapes, poses = [], []
        for k in (first, second):
            frame = self._found.oMg[k]
            shapes.append(self._meshes.get(k) or self._shapes.geometryObjects[k].geometry)
            poses.append(self._coal.Transform3s(frame.rotation, frame.translation))
        objects, coal = (shapes[0], poses[0], shapes[1], poses[1]), self._coal
        # triangles of a mesh inside another do not intersect: their distance would be positive
        if hull_distance < 0 and coal.collide(*objects, coal.CollisionRequest(), coal.CollisionResult()):
            return hull_distance
        return float(coal.distance(*objects, coal.DistanceRequest(), coal.DistanceResult()))

    def _add(self, shape: Any, joint: int, frame: Array) -> None:
        place = self._pin.SE3(np.ascontiguousarray(frame[:3, :3]), frame[:3, 3].copy())
        name = str(len(self._shapes.geometryObjects))
        self._shapes.addGeometryObject(self._pin.GeometryObject(name, joint, place, shape))


def _pinocchio_arm(bodies: RigidBodies) -> Any:
    """Return Pinocchio's model of the bodies: one joint for each, in their order."""
    import pinocchio as pin

    model = pin.Model()
    for k, body in enumerate(bodies.arm.bodies):
        is_prismatic = body.joint.kind == "prismatic"
        axis = np.array(body.joint.axis)
        joint = pin.JointModelPrismaticUnaligned(axis) if is_prismatic else pin.JointModelRevoluteUnaligned(axis)
        placement = pin.SE3(body.placement[:3, :3].copy(), body.placement[:3, 3].copy())
        model.addJoint(0 if body.parent is None else body.parent + 1, joint, placement, str(k))
    return model


def _coal_shape(solid: Solid) -> Any:
    import coal

    size = solid.size
    if solid.mesh is not None:
        return _triangle_mesh(solid.mesh)
    factories = {
        ShapeKind.BOX: lambda: coal.Box(*(2 * x for x in size)),
        ShapeKind.SPHERE: lambda: coal.Sphere(*size),
        ShapeKind.CYLINDER: lambda: coal.Cylinder(size[0], 2 * size[1]),
        ShapeKind.CAPSULE: lambda: coal.Capsule(size[0], 2 * size[1]),
        ShapeKind.ELLIPSOID: lambda: coal.Ellipsoid(*size),
    }
    return factories[solid.kind]()


def _triangle_mesh(mesh: Mesh) -> Any:
    import coal

    out = coal.BVHModelOBBRSS()
    out.beginModel(len(mesh.triangles), len(mesh.vertices))
    out.addVertices(mesh.vertices)
    out.addTriangles(mesh.triangles.astype(np.int64))
    out.endModel()
    return out


def _hull_fill_share(mesh: Mesh) -> float:
    """Return the share of the volume of their convex hull that triangles enclose; 0 where they are flat."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(mesh.vertices).volume
    except (QhullError, ValueError):
        return 0.0
    # signed volumes of the tetrahedra from the mean to each triangle
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] - mesh.vertices.mean(axis=0) for k in range(3))
    volume = abs(np.einsum("ki,ki->", a, np.cross(b, c))) / 6
    return float(volume / hull)
