"""Solid shapes of an arm, as far as its file and the meshes that it names are available."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from operator import itemgetter
from typing import ClassVar, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from dynident.models.rigid_bodies import RigidBodies
from dynident.models.robot_files import LinkShapes, Shape, ShapeKind, motion_matrix
from dynident.runtime import Noun, WordedEnum
from dynident.runtime.arrays import Array


@dataclass(frozen=True)
class Floor:
    """Everything below ``height`` (m) along the z axis of the robot's root link."""

    height: float = 0.0
    name: ClassVar[str] = "floor"


@dataclass(frozen=True)
class Box:
    """A box around ``centre`` (m), of ``size`` (m) along the axes x, y and z of the root link, or along
    ``axes``.

    The axes are three unit vectors in the frame of the root link.
    """

    name: str
    centre: tuple[float, float, float]
    size: tuple[float, float, float]
    axes: tuple[tuple[float, ...], ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True)
class Cylinder:
    """An upright cylinder around (x, y) of ``radius`` (m), from ``bottom`` to ``top`` (m): a keep-out volume."""

    name: str
    centre: tuple[float, float]
    radius: float
    bottom: float = -np.inf
    top: float = np.inf


Obstacle = Floor | Box | Cylinder


class Distances(Protocol):
    """Distances of the links of an arm to each other and to obstacles, for P pairs."""

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """Names of the P pairs: two links, or a link and an obstacle; several for a pair of several parts."""

    def distances(self, q: Array, /) -> Array:
        """Return distances (N, P) in m, negative where a pair overlaps, at positions q (N, n)."""


@runtime_checkable
class LipschitzDistances(Distances, Protocol):
    """Distances with known bounds of the rates at which they change, which prove them between samples."""

    @property
    def steepest(self) -> Array:
        """Largest rate at which a distance changes with a joint, shape (P, n): m/rad, m/m."""


class Space(Distances, Protocol):
    """Distances with their derivatives, as the optimiser needs them."""

    def gradients(self, q: Array, /) -> tuple[Array, Array]:
        """Return ``distances`` and their derivatives (N, P, n) by q."""


@dataclass(frozen=True)
class EmptySpace:
    """The space of an arm whose bodies are not known: nothing can meet."""

    pairs: tuple[tuple[str, str], ...] = ()

    def distances(self, q: Array, /) -> Array:
        """Return no distances, shape (N, 0)."""
        return np.empty((len(q), 0))

    def gradients(self, q: Array, /) -> tuple[Array, Array]:
        """Return no distances, and none of their derivatives, shape (N, 0, n)."""
        return self.distances(q), np.empty((len(q), 0, q.shape[1]))


Integers = NDArray[np.intp]


class ShapeSource(WordedEnum):
    """Source of the shape of a body: its shapes for collision, those that are seen, or only its joints."""

    COLLISION = "collision", "their collision shapes"
    VISUAL = "visual", "what is seen of them, as the file has no collision shapes of them"
    JOINTS = (
        "joints",
        "the lines between their joints, as their shapes are not known: look whether they are as thick",
    )


class Mesh(Noun):
    """A surface of triangles: ``vertices`` (V, 3) in m, and the three corners of each of the ``triangles`` (F, 3)."""

    vertices: Array
    triangles: Integers


class Solid(Noun):
    """A shape of ``link``, with its ``frame`` (4, 4) in that of a body.

    ``body`` is the index in ``Arm.bodies`` (-1: the root link); ``size`` is that of a ``Shape``. A mesh is
    already scaled.
    """

    link: str
    body: int
    kind: ShapeKind
    size: tuple[float, ...]
    frame: Array
    mesh: Mesh | None = None


def obstacle_solid(obstacle: Box | Cylinder, reach: float, min_height: float = 0.0) -> Solid:
    """Return an obstacle as a solid of the root link; a cylinder without an end goes to ``reach`` (m) there, and is at
    least ``min_height`` (m) high.
    """
    frame = np.eye(4)
    if isinstance(obstacle, Box):
        frame[:3, :3], frame[:3, 3] = np.transpose(obstacle.axes), obstacle.centre
        return Solid(obstacle.name, -1, ShapeKind.BOX, tuple((0.5 * np.array(obstacle.size)).tolist()), frame)
    bottom = obstacle.bottom if np.isfinite(obstacle.bottom) else min(-reach, obstacle.top - min_height)
    top = obstacle.top if np.isfinite(obstacle.top) else max(reach, bottom + min_height)
    frame[:3, 3] = *obstacle.centre, (bottom + top) / 2
    return Solid(obstacle.name, -1, ShapeKind.CYLINDER, (obstacle.radius, (top - bottom) / 2), frame)


class LinkPlace(Noun):
    """A link, the index of its body in ``Arm.bodies`` (-1: the root link), and its frame (4, 4) in that of the
    body.
    """

    link: str
    body: int
    frame: Array


class Geometry(Noun):
    """The ``solids`` of an arm, and by index the ``sources`` of the shapes of each body that can touch
    something.

    ``missing`` are the files of meshes that are not there, or cannot be read, each with the reason.
    """

    bodies: RigidBodies
    solids: tuple[Solid, ...]
    sources: Mapping[int, ShapeSource]
    missing: Mapping[str, str]

    @cached_property
    def places(self) -> tuple[LinkPlace, ...]:
        """The frames of the links."""
        return link_places(self.bodies)

    def link(self, body: int) -> str:
        """Return the name of a body: that of its first link."""
        return self.bodies.arm.bodies[body].name if body >= 0 else self.bodies.file.root


def build_geometry(bodies: RigidBodies, mesh: Callable[[str], Mesh | None] = lambda _: None) -> Geometry:
    """Return the shapes of an arm; ``mesh`` returns a mesh by its name in the file, None where it cannot.

    The shapes for collision of a link are taken where all of them are known, else those that are seen where
    all of these are, else what is known of the first. A body with a link of the last sort, or with a mass
    but no shape, is ``ShapeSource.JOINTS``.
    """
    shapes = bodies.shapes
    solids: list[Solid] = []
    sources: dict[int, ShapeSource] = {}
    for place in link_places(bodies):
        link_solids, source = _choose_solids(shapes.get(place.link, LinkShapes()), place, mesh)
        if source is not None:
            # a body counts as the least known of its links
            sources[place.body] = max(source, sources.get(place.body, source), key=list(ShapeSource).index)
        solids += link_solids
    for k, body in enumerate(bodies.arm.bodies):
        # a body with mass but without shapes still occupies space
        if k not in sources and not body.massless and body.theta[0] != 0:
            sources[k] = ShapeSource.JOINTS
    return Geometry(bodies, tuple(solids), dict(sorted(sources.items())), {})


def rod_geometry(bodies: RigidBodies) -> Geometry:
    """Return the geometry of an arm of which only the joints are known, or used."""
    sources = {k: ShapeSource.JOINTS for k, body in enumerate(bodies.arm.bodies) if not body.massless}
    return Geometry(bodies, (), sources, {})


def link_places(bodies: RigidBodies) -> tuple[LinkPlace, ...]:
    """Return the places of all links of an arm, those that stand still first."""
    fixed = [LinkPlace(link, -1, frame) for link, frame in _fixed_frames(bodies).items()]
    moving = [
        LinkPlace(link, k, frame)
        for k, body in enumerate(bodies.arm.bodies)
        for link, frame in zip(body.links, body.frames, strict=True)
    ]
    return (*fixed, *moving)


def _choose_solids(
    shapes: LinkShapes, place: LinkPlace, mesh: Callable[[str], Mesh | None]
) -> tuple[list[Solid], ShapeSource | None]:
    """Return the solids of a link that are used, and their source: None where the link has no shape."""
    known_solids: list[Solid] = []
    for candidates, source in ((shapes.collision, ShapeSource.COLLISION), (shapes.visual, ShapeSource.VISUAL)):
        solids = [solid for shape in candidates if (solid := _place_solid(shape, place, mesh)) is not None]
        # shapes that are partly unknown would leave holes: take a kind only where all of it is known
        if candidates and len(solids) == len(candidates):
            return solids, source
        known_solids = known_solids if source is ShapeSource.VISUAL else solids
    return known_solids, ShapeSource.JOINTS if shapes.collision or shapes.visual else None


def _place_solid(shape: Shape, place: LinkPlace, mesh: Callable[[str], Mesh | None]) -> Solid | None:
    """Return a shape in the frame of its body, None where its mesh is not known."""
    frame = place.frame @ shape.frame
    if shape.kind is not ShapeKind.MESH:
        return Solid(place.link, place.body, shape.kind, shape.size, frame)
    surface = mesh(shape.file) if shape.file else None
    if surface is None:
        return None
    scaled_mesh = Mesh(surface.vertices * np.array(shape.size), surface.triangles)
    return Solid(place.link, place.body, shape.kind, shape.size, frame, scaled_mesh)


def _fixed_frames(bodies: RigidBodies) -> dict[str, Array]:
    """Return the frames (4, 4) of the links that stand still, in that of the root link."""
    file, arm = bodies.file, bodies.arm
    fixed_links, frames = set(arm.fixed_links), {file.root: np.eye(4)}
    pending = [file.root]
    while pending:
        link = pending.pop()
        for joint in file.joints_below.get(link, ()):
            if joint.child in fixed_links:
                joint_motion = motion_matrix(joint, arm.fixed_positions.get(joint.name, 0.0))
                frames[joint.child] = frames[link] @ joint.placement @ joint_motion
                pending.append(joint.child)
    return frames


OUTER_DIRECTIONS = 200  # in which the outermost balls are taken while the axis is sought
MAX_START_VOLUME = 1.3  # times the volume by the best principal axis: others are tried too
MAX_EVALUATIONS = 250  # of the search, from each start
SEARCH_TOLERANCE = 1e-4  # of the size: where the search ends


class Balls(Noun):
    """Balls around ``centres`` (M, 3) with ``radii`` (M), m; points are balls without a radius."""

    centres: Array
    radii: Array

    @classmethod
    def join(cls, *parts: Balls) -> Balls:
        """Return the balls of all parts."""
        return cls(np.concatenate([part.centres for part in parts]), np.concatenate([part.radii for part in parts]))

    def select_outermost(self) -> Balls:
        """Return the balls that are farthest out in one of many directions."""
        if len(self.radii) <= OUTER_DIRECTIONS:
            return self
        k = np.arange(OUTER_DIRECTIONS) + 0.5
        # a Fibonacci lattice spreads the directions evenly over the sphere
        azimuth, height = np.pi * (1 + 5**0.5) * k, 1 - 2 * k / OUTER_DIRECTIONS  # a Fibonacci lattice
        radius = np.sqrt(1 - height**2)
        directions = np.stack((radius * np.cos(azimuth), radius * np.sin(azimuth), height))
        indices = np.unique((self.centres @ directions + self.radii[:, None]).argmax(axis=0))
        return Balls(self.centres[indices], self.radii[indices])

    def capsule(self) -> Capsule:
        """Return a capsule of about the smallest volume that contains all balls, of no link yet.

        For a given axis and radius the ends follow. The axis and the radius are searched for by the method of
        Nelder and Mead, from those principal axes that are nearly as good as the best.
        """
        # only outermost balls touch the capsule: a few hundred suffice to find its axis
        outer = self.select_outermost()
        axes, middle, size = _principal_axes(outer)
        if len(outer.radii) < 3 or size == 0:
            return _capsule_about_line(self, middle, axes[0], 0.0)
        volumes = [_capsule_about_line(outer, middle, axis, 0.0).volume for axis in axes]
        # another principal axis may lead to a smaller capsule where volumes are about equal
        starts = [np.roll(axes, -k, axis=0) for k in range(3) if volumes[k] <= MAX_START_VOLUME * min(volumes)]
        optimum = min((_search_axis(outer, start, middle, size) for start in starts), key=itemgetter(0))
        return _capsule_about_line(self, *optimum[1:])

    def quick_capsule(self) -> Capsule:
        """Return the smallest of three capsules along the principal axes."""
        axes, middle, _ = _principal_axes(self)
        return min((_capsule_about_line(self, middle, axis, 0.0) for axis in axes), key=lambda capsule: capsule.volume)


class Capsule(Noun):
    """All points within ``radius`` (m) of the segment from ``start`` to ``end`` (3) in the frame of a body.

    ``body`` is the index in ``Arm.bodies`` (-1: the root link, which stands still); ``link`` is the link
    inside.
    """

    link: str
    body: int
    start: Array
    end: Array
    radius: float

    @property
    def volume(self) -> float:
        """Its volume (m^3)."""
        return float(np.pi * self.radius**2 * (np.linalg.norm(self.end - self.start) + 4 / 3 * self.radius))

    @property
    def solid(self) -> Solid:
        """The capsule as a solid, with z along its axis."""
        along = self.end - self.start
        length = float(np.linalg.norm(along))
        z = along / length if length else np.array([0.0, 0.0, 1.0])
        # any unit vector across the axis: the one least parallel to it gives a well-conditioned frame
        x = np.cross(np.eye(3)[int(np.argmin(np.abs(z)))], z)
        x /= np.linalg.norm(x)
        frame = np.eye(4)
        frame[:3, :3], frame[:3, 3] = np.stack((x, np.cross(z, x), z), axis=1), (self.start + self.end) / 2
        return Solid(self.link, self.body, ShapeKind.CAPSULE, (self.radius, length / 2), frame)


def _principal_axes(balls: Balls) -> tuple[Array, Array, float]:
    """Return the principal axes (3, 3), the middle of the range along them (3), and the largest range."""
    axes = np.linalg.eigh(np.cov(balls.centres.T, bias=True))[1].T[::-1]
    along = balls.centres @ axes.T
    low, high = (along - balls.radii[:, None]).min(axis=0), (along + balls.radii[:, None]).max(axis=0)
    return axes, (low + high) / 2 @ axes, float((high - low).max())


def _search_axis(balls: Balls, axes: Array, middle: Array, size: float) -> tuple[float, Array, Array, float]:
    """Return the least volume found from the first axis, with point and direction of the line, and the extra
    radius.
    """
    from scipy.optimize import minimize

    def line(x: Array) -> tuple[Array, Array, float]:
        """Return point, direction and extra radius: two shifts, two tilts, and a root."""
        along = axes[0] + x[2] * axes[1] + x[3] * axes[2]
        shift = size * (x[0] * axes[1] + x[1] * axes[2])
        # the square keeps the extra radius positive, and lets the search reach zero
        return middle + shift, along / np.linalg.norm(along), size * float(x[4]) ** 2

    simplex = np.vstack((np.zeros(5), 0.1 * np.eye(5)))
    options = {
        "maxfev": MAX_EVALUATIONS,
        "initial_simplex": simplex,
        "fatol": SEARCH_TOLERANCE,
        "xatol": SEARCH_TOLERANCE,
    }
    solution = minimize(
        lambda x: _capsule_about_line(balls, *line(x)).volume / size**3,
        simplex[0],
        method="Nelder-Mead",
        options=options,
    )
    return float(solution.fun), *line(solution.x)


def _capsule_about_line(balls: Balls, point: Array, along: Array, extra: float) -> Capsule:
    """Return the shortest capsule along a line that contains all balls, ``extra`` (m) wider than needed."""
    offsets = balls.centres - point
    t = offsets @ along
    distances = np.sqrt(np.maximum(np.einsum("ki,ki->k", offsets, offsets) - t * t, 0.0))
    radius = float((distances + balls.radii).max()) + extra
    # each ball needs the axis within its own reach along the line
    reach = np.sqrt(np.maximum((radius - balls.radii) ** 2 - distances**2, 0.0))
    low_end, high_end = float((t + reach).min()), float((t - reach).max())
    if low_end > high_end:  # a ball is enough
        low_end = high_end = (low_end + high_end) / 2
    return Capsule("", -1, point + low_end * along, point + high_end * along, radius)
