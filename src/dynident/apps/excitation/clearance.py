"""Distances of an arm, as capsules, to itself and to obstacles, with exact derivatives by its positions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property, partial
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from dynident.models import Box, Capsule, Distances, Floor, Obstacle, Placements, RigidBodies
from dynident.runtime import InputError, Noun
from dynident.runtime.arrays import Array

SignedDistance = Callable[[Array], tuple[Array, Array]]
SQUARED_PREFERENCE = 1e-4  # m^2: preference between segments; where they are 0.1 m apart, it costs at most 0.25 mm
LINEAR_PREFERENCE = 2e-3  # m: preference beside a body; it costs at most a quarter
MIN_SLOPE_CHANGE = 1e-300
BISECTIONS = 20  # of a segment
MIN_DISTANCE = 1e-12  # m: below it there is no direction

DEFAULT_TRAVEL = 10.0  # m: the travel of a prismatic joint without limits

Integers = NDArray[np.intp]
PairDistances = tuple[Array, Array, Array]  # distances (N, K), the points and the directions (N, K, 3) they grow with
SMOOTHING_FACTOR = 1.03  # of the smooth distances against the true ones, where axes are 30 mm apart or more
BLOCK = 2000  # samples at once


def segment_distance(p: Array, u: Array, r: Array, v: Array) -> tuple[Array, Array, Array]:
    """Return the distance (...) in m of segments from p along u to segments from r along v, all (..., 3).

    Returns also a point (..., 3) on each of the first, and the derivative (..., 3) by it, which is minus
    that by the point on the second.

    The points p + s u and r + t v minimise d^2 + SQUARED_PREFERENCE ((s - 1/2)^2 + (t - 1/2)^2), of which at
    most SQUARED_PREFERENCE / 2 is not d^2. Where d is below 10 mm, the tangent replaces the square root,
    which has no derivative at zero.
    """
    w = p - r
    a, e, b = _dot(u, u) + SQUARED_PREFERENCE, _dot(v, v) + SQUARED_PREFERENCE, _dot(u, v)
    c, f = _dot(u, w) - SQUARED_PREFERENCE / 2, _dot(v, w) + SQUARED_PREFERENCE / 2
    # minimise over s, then over t, then over s again: clipping one part changes the best other part
    s = np.clip((b * f - c * e) / (a * e - b * b), 0.0, 1.0)
    t = np.clip((b * s + f) / e, 0.0, 1.0)
    s = np.clip((b * t - c) / a, 0.0, 1.0)
    point = p + s[..., None] * u
    offset = point - r - t[..., None] * v
    # the preference is part of the value, and its largest amount is taken off again below
    value = _dot(offset, offset) + SQUARED_PREFERENCE * ((s - 0.5) ** 2 + (t - 0.5) ** 2)
    root = np.sqrt(np.maximum(value, SQUARED_PREFERENCE) - SQUARED_PREFERENCE / 2)
    return root + np.minimum(value - SQUARED_PREFERENCE, 0.0) / (2 * root), point, offset / root[..., None]


def body_distance(p: Array, u: Array, signed_distance: SignedDistance) -> tuple[Array, Array, Array]:
    """Return the distance (...) in m of segments from p along u (..., 3) to a convex body.

    Returns also a point (..., 3) on each segment, and the derivative (..., 3) by it.

    ``signed_distance`` gives the distance of points, negative inside, and its derivative. As it is convex
    along a segment, the nearest part s is where the slope of distance + LINEAR_PREFERENCE (s - 1/2)^2
    changes its sign: between two parts close to each other, whose tangents then give the rest. Where the
    slope jumps, as inside a box, the derivative is the mean of those on both sides at which it is zero.
    """
    low, high = np.zeros(p.shape[:-1]), np.ones(p.shape[:-1])
    # bisect on the sign of the slope, which rises along the segment as the distance is convex
    for _ in range(BISECTIONS):
        s = (low + high) / 2
        is_rising = _dot(signed_distance(p + s[..., None] * u)[1], u) + 2 * LINEAR_PREFERENCE * (s - 0.5) > 0
        low, high = np.where(is_rising, low, s), np.where(is_rising, s, high)
    low_value, low_normal, low_slope = _value_and_slope(p, u, low, signed_distance)
    high_value, high_normal, high_slope = _value_and_slope(p, u, high, signed_distance)
    # the tangents at both ends meet at the kink, if there is one
    share = np.clip(-low_slope / np.maximum(high_slope - low_slope, MIN_SLOPE_CHANGE), 0.0, 1.0)
    width = high - low
    low_value, high_value = low_value + low_slope * share * width, high_value - high_slope * (1 - share) * width
    point = p + (low + share * width)[..., None] * u
    return (
        low_value + share * (high_value - low_value),
        point,
        low_normal + share[..., None] * (high_normal - low_normal),
    )


def _value_and_slope(p: Array, u: Array, s: Array, signed_distance: SignedDistance) -> tuple[Array, Array, Array]:
    """Return distance and preference at the parts s, the derivative of the distance, and the slope of both by s."""
    distance, normal = signed_distance(p + s[..., None] * u)
    return (
        distance + LINEAR_PREFERENCE * ((s - 0.5) ** 2 - 0.25),
        normal,
        _dot(normal, u) + 2 * LINEAR_PREFERENCE * (s - 0.5),
    )


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("...i,...i->...", a, b))


def signed_distance(obstacle: Obstacle, point: Array) -> tuple[Array, Array]:
    """Return the signed distance (...) of points (..., 3) from an obstacle, negative inside, and its derivative
    (..., 3): a unit vector away from the obstacle."""
    if isinstance(obstacle, Floor):
        return point[..., 2] - obstacle.height, np.broadcast_to([0.0, 0.0, 1.0], point.shape)
    if isinstance(obstacle, Box):
        axes = np.array(obstacle.axes)
        away = (point - np.array(obstacle.centre)) @ axes.T
        distance, normal = _corner_distance(np.abs(away) - np.array(obstacle.size) / 2)
        return distance, (normal * np.where(away < 0, -1.0, 1.0)) @ axes
    x, y = point[..., 0] - obstacle.centre[0], point[..., 1] - obstacle.centre[1]
    radius = np.hypot(x, y)
    over, under = point[..., 2] - obstacle.top, obstacle.bottom - point[..., 2]
    # a cylinder is a corner in the plane of radius and height
    distance, normal = _corner_distance(np.stack((radius - obstacle.radius, np.maximum(over, under)), axis=-1))
    radius = np.maximum(radius, MIN_DISTANCE)
    radial, up = normal[..., 0] / radius, normal[..., 1] * np.where(over < under, -1.0, 1.0)
    return distance, np.stack((radial * x, radial * y, up), axis=-1)


def _corner_distance(excess: Array) -> tuple[Array, Array]:
    """Return the distance (...) from the corner of the region where all of ``excess`` (..., k) are negative.

    Returns also its derivative (..., k) by these.
    """
    out = np.maximum(excess, 0.0)
    distance = np.sqrt(np.einsum("...i,...i->...", out, out))
    inside = distance < MIN_DISTANCE
    # inside, the distance is that of the nearest face
    nearest = np.arange(excess.shape[-1]) == excess.argmax(axis=-1)[..., None]
    normal = np.where(inside[..., None], nearest, out / np.maximum(distance, MIN_DISTANCE)[..., None])
    return np.where(inside, excess.max(axis=-1), distance), normal


def reach_bounds(bodies: RigidBodies, body: int, radius: float) -> Array:
    """Return by how much (m/rad, m/m) points within ``radius`` (m) of a body's origin move at most with each body (B).

    The bodies are those on which it stands, itself included; the bound is 0 for others. A point moves with a
    revolute joint by its distance from the axis, which is bounded by the lengths of the links between and
    the travel of prismatic joints.
    """
    all_bodies, out, reach = bodies.arm.bodies, np.zeros(len(bodies.arm.bodies)), radius
    travel = _max_travel(bodies)
    index: int | None = body if body >= 0 else None
    # from the body to the root: each link can add its length to the distance from the next axis
    while index is not None:
        is_prismatic = all_bodies[index].joint.kind == "prismatic"
        out[index] = 1.0 if is_prismatic else reach
        reach += float(np.linalg.norm(all_bodies[index].placement[:3, 3])) + (travel[index] if is_prismatic else 0.0)
        index = all_bodies[index].parent
    return out


def _max_travel(bodies: RigidBodies) -> Array:
    """Return how far (B) the positions of the bodies are from 0 at most."""
    limits = [bodies.limits[joint.name] for joint in bodies.joints]
    ends = np.array([(limit.lower, limit.upper) for limit in limits], dtype=float).reshape(-1, 2)
    max_positions = np.where(np.isfinite(ends), np.abs(ends), DEFAULT_TRAVEL).max(axis=1)
    return np.asarray(np.abs(bodies.arm.drive) @ max_positions + np.abs(bodies.arm.offset))


class CapsuleSpace(Noun):
    """The ``capsules`` around the links of an arm, and ``obstacles``.

    ``watched`` are the P pairs (P, 2), by index in (*capsules, *obstacles): of two capsules, then of a capsule with an
    obstacle, obstacle by obstacle. A pair of links with several capsules has several. ``unwatched`` are those that are
    left out because they touch in nearly every pose. Distances are smooth, and less than the true ones by at most 1 mm
    where that is not below 50 mm (``segment_distance``).
    """

    bodies: RigidBodies
    capsules: tuple[Capsule, ...]
    obstacles: tuple[Obstacle, ...]
    watched: Integers
    unwatched: Integers

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """Names of the P pairs: two links, or a link and an obstacle."""
        return self._pair_names(self.watched)

    @cached_property
    def steepest(self) -> Array:
        """Largest rate at which a distance changes with a joint, shape (P, n)."""
        radii = [
            capsule.radius + max(float(np.linalg.norm(end)) for end in (capsule.start, capsule.end))
            for capsule in self.capsules
        ]
        radii += [0.0] * len(self.obstacles)  # they do not move
        reaches = [reach_bounds(self.bodies, body, r) for body, r in zip(self._part_bodies, radii, strict=True)]
        first, second = np.reshape(reaches, (-1, len(self.bodies.arm.bodies)))[self.watched.T]
        # a joint that carries both parts moves them alike and does not change their distance
        rates = np.where((first > 0) & (second > 0), 0.0, first + second)
        return np.asarray(SMOOTHING_FACTOR * (rates @ np.abs(self.bodies.arm.drive)))

    @property
    def left_out(self) -> tuple[tuple[str, str], ...]:
        """Names of the pairs that are not watched, each once."""
        return tuple(dict.fromkeys(self._pair_names(self.unwatched)))

    def distances(self, q: Array, /) -> Array:
        """Return the distances (N, P) in m, negative where a pair overlaps, at positions q (N, n)."""
        # in blocks of samples, as the placements of all bodies take much memory
        blocks = [q[k : k + BLOCK] for k in range(0, len(q), BLOCK)]
        block_distances = [self._all_pairs(self.bodies.placements(block))[0] for block in blocks]
        return np.concatenate([np.empty((0, len(self.pairs))), *block_distances])

    def gradients(self, q: Array, /) -> tuple[Array, Array]:
        """Return ``distances`` and their derivatives (N, P, n) by q."""
        placements = self.bodies.placements(q)
        distances, points, directions = self._all_pairs(placements)
        # a point and the one nearest to it are on one line along the direction, so that both have one moment
        first, second = (
            placements.project_on_joints(part_bodies, points, directions)
            for part_bodies in self._part_bodies[self.watched.T]
        )
        return distances, first - second

    def _all_pairs(self, placements: Placements) -> PairDistances:
        axes = ([capsule.start for capsule in self.capsules], [capsule.end for capsule in self.capsules])
        count, bodies = len(self.capsules), self._part_bodies[: len(self.capsules)]
        starts, ends = (placements.points(bodies, np.array(end).reshape(-1, 3)) for end in axes)
        along, radii = ends - starts, np.array([capsule.radius for capsule in self.capsules])
        first, second = self.watched[self.watched[:, 1] < count].T
        distance, point, direction = segment_distance(
            starts[:, first], along[:, first], starts[:, second], along[:, second]
        )
        rows = [(distance - radii[first] - radii[second], point, direction)]
        for index, obstacle in enumerate(self.obstacles, start=count):
            capsules = self.watched[self.watched[:, 1] == index, 0]
            distance, point, direction = body_distance(
                starts[:, capsules], along[:, capsules], partial(signed_distance, obstacle)
            )
            rows.append((distance - radii[capsules], point, direction))
        distances, points, directions = (np.concatenate(parts, axis=1) for parts in zip(*rows, strict=True))
        return distances, points, directions

    def _pair_names(self, pairs: Integers) -> tuple[tuple[str, str], ...]:
        names = [*(capsule.link for capsule in self.capsules), *(obstacle.name for obstacle in self.obstacles)]
        return tuple((names[first], names[second]) for first, second in pairs)

    @cached_property
    def _part_bodies(self) -> Integers:
        """Bodies of the capsules, and the root for the obstacles."""
        return np.array([*(capsule.body for capsule in self.capsules), *(-1 for _ in self.obstacles)], dtype=np.intp)


def candidate_pairs(bodies: RigidBodies, parts: Sequence[int], obstacles: int) -> tuple[Integers, int]:
    """Return the pairs (P, 2) that may meet, by index in (*parts, *obstacles), and the number of those of two parts,
    which come first.

    ``parts`` are given by their bodies. Those of one body, and of a body and the next one (of those that have parts),
    do not meet, nor does what stands still.
    """
    neighbour_pairs = neighbours(bodies, set(parts))
    meetings = [
        (first, second)
        for first, second in combinations(range(len(parts)), 2)
        if parts[first] != parts[second] and frozenset((parts[first], parts[second])) not in neighbour_pairs
    ]
    moving_parts = [part for part, body in enumerate(parts) if body >= 0]
    encounters = [(part, len(parts) + obstacle) for obstacle in range(obstacles) for part in moving_parts]
    return np.array([*meetings, *encounters], dtype=np.intp).reshape(-1, 2), len(meetings)


def refuse_contact(space: Distances, q: Array, clearance: float, pose_name: str) -> None:
    """Raise InputError where the pose q (n), called ``pose_name``, is nearer to contact than ``clearance`` (m)."""
    distances = space.distances(q[None])[0]
    if distances.size and distances.min() < clearance:
        nearest = int(distances.argmin())
        first, second = space.pairs[nearest]
        distance = float(distances[nearest])
        relation = f"overlap by {-1e3 * distance:.0f} mm" if distance < 0 else f"are {1e3 * distance:.0f} mm apart"
        raise InputError(
            f"{pose_name}: {first!r} and {second!r} {relation}, and {1e3 * clearance:.0f} mm are to be kept between "
            "them; give another start, correct the obstacles, or ask for less clearance."
        )


def neighbours(bodies: RigidBodies, occupied: set[int]) -> set[frozenset[int]]:
    """Return the pairs of a body and the next one towards the root, of the bodies ``occupied`` by capsules."""
    pairs = set()
    # bodies without shapes are skipped: the next one that has some is the neighbour
    for body in occupied - {-1}:
        parent = body
        while parent != -1:
            next_parent = bodies.arm.bodies[parent].parent
            parent = -1 if next_parent is None else next_parent
            if parent in occupied:
                break
        pairs.add(frozenset((body, parent)))
    return pairs
