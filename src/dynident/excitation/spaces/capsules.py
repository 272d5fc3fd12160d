"""Capsules around the links of an arm: what its distances are computed of."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.excitation.spaces.fitting import Balls, Fitted, fitted, quick
from dynident.excitation.spaces.geometry import Geometry, Made, Solid
from dynident.excitation.spaces.hulls import balls_of, cuts
from dynident.excitation.spaces.space import Box
from dynident.models import RigidBodies
from dynident.models.robot_file import ShapeKind

__all__ = ["Capsule", "capsules_of", "rod", "rule_radius", "still_boxes"]

Array = NDArray[np.float64]
RULE = 0.1  # radius of a link of unknown shape, as a share of the arm's reach
USUAL = 0.05  # m: of an arm without reach
MERGED = 1.0  # two capsules become one of up to so many times their volume
CUT = 0.8  # a mesh is cut in two where that leaves less than this share of the volume


@dataclass(frozen=True, eq=False)
class Capsule:
    """All points within ``radius`` (m) of the segment from ``start`` to ``end`` (3) in the frame of a body, given by
    its place in ``Arm.bodies`` (-1: the root link, which stands still); ``link`` is the link that it is around."""

    link: str
    body: int
    start: Array
    end: Array
    radius: float

    __repr__ = brief

    @property
    def solid(self) -> Solid:
        """It as a solid, with z along it."""
        along = self.end - self.start
        length = float(np.linalg.norm(along))
        z = along / length if length else np.array([0.0, 0.0, 1.0])
        x = np.cross(np.eye(3)[int(np.argmin(np.abs(z)))], z)
        x /= np.linalg.norm(x)
        frame = np.eye(4)
        frame[:3, :3], frame[:3, 3] = np.stack((x, np.cross(z, x), z), axis=1), (self.start + self.end) / 2
        return Solid(self.link, self.body, ShapeKind.CAPSULE, (self.radius, length / 2), frame)


@dataclass(frozen=True, eq=False)
class _Part:
    """A part of a body: its link, what it occupies, and the capsule around that."""

    link: str
    balls: Balls
    around: Fitted


def capsules_of(geometry: Geometry) -> tuple[Capsule, ...]:
    """Return capsules that contain the solids of an arm, body by body.

    A mesh is cut in two where that saves much volume; capsules of a body that are hardly smaller than one around both
    become that. Boxes of the root link are left to ``still_boxes``. A body of which only the joints are known
    (``Made.JOINTS``) has one around the origins of its links and of the joints that it carries, with the radius of
    ``rule_radius``.
    """
    out: list[Capsule] = []
    for body, made in geometry.made.items():
        solids = [one for one in geometry.solids if one.body == body and not _is_still_box(one)]
        parts = [part for solid in solids for part in _parts(solid)]
        if made is Made.JOINTS:
            balls = _by_rule(geometry, body)
            parts.append(_Part(geometry.link(body), balls, fitted(balls)))
        merged = _merged(parts, geometry.link(body))
        out += [Capsule(one.link, body, one.around.start, one.around.end, one.around.radius) for one in merged]
    return tuple(out)


def still_boxes(geometry: Geometry) -> tuple[Box, ...]:
    """Return the boxes of links that stand still, such as a table: no capsule is like them."""
    return tuple(
        Box(
            one.link,
            (float(one.frame[0, 3]), float(one.frame[1, 3]), float(one.frame[2, 3])),
            (2 * one.size[0], 2 * one.size[1], 2 * one.size[2]),
            tuple(tuple(axis.tolist()) for axis in one.frame[:3, :3].T),
        )
        for one in geometry.solids
        if _is_still_box(one)
    )


def rod(geometry: Geometry, body: int) -> Capsule:
    """Return the capsule by which a body is drawn of which only the joints are known: around these or, where it carries
    none, to its centre of mass, if the file has that."""
    around, link = quick(_by_rule(geometry, body)), geometry.link(body)
    theta = geometry.bodies.arm.bodies[body].theta if body >= 0 else np.zeros(10)
    short = np.linalg.norm(around.end - around.start) < around.radius
    end = theta[1:4] / theta[0] if short and np.isfinite(theta).all() and theta[0] > 0 else around.end
    return Capsule(link, body, around.start, end, around.radius)


def rule_radius(bodies: RigidBodies) -> float:
    """Return the radius (m) of a link of unknown shape: 10 % of the longest way over the joints, from the first on."""
    reach: list[float] = []
    for body in bodies.arm.bodies:
        far = 0.0 if body.parent is None else reach[body.parent] + float(np.linalg.norm(body.placement[:3, 3]))
        reach.append(far)
    return RULE * max(reach) or USUAL


def _by_rule(geometry: Geometry, body: int) -> Balls:
    arm = geometry.bodies.arm
    own = [one.frame[:3, 3] for one in geometry.places if one.body == body]
    carried = [one.placement[:3, 3] for one in arm.bodies if (-1 if one.parent is None else one.parent) == body]
    centres = np.array([*own, *carried])
    return Balls(centres, np.full(len(centres), rule_radius(geometry.bodies)))


def _is_still_box(solid: Solid) -> bool:
    return solid.body == -1 and solid.kind is ShapeKind.BOX


def _parts(solid: Solid) -> list[_Part]:
    """Return a solid as one part, or as two."""
    whole = balls_of(solid)
    around = fitted(whole)
    halves = min(cuts(solid), key=lambda pair: sum(quick(one).volume for one in pair), default=None)
    if halves is not None:
        pair = [fitted(one) for one in halves]
        if sum(one.volume for one in pair) < CUT * around.volume:
            return [_Part(solid.link, *one) for one in zip(halves, pair, strict=True)]
    return [_Part(solid.link, whole, around)]


def _merged(parts: list[_Part], body: str) -> list[_Part]:
    """Return the parts, with two of them made one as long as that costs little volume; of two links, it is the
    ``body``'s."""
    while len(parts) > 1:
        tried = []
        for one, other in combinations(parts, 2):
            balls, before = Balls.joined(one.balls, other.balls), one.around.volume + other.around.volume
            tried.append((quick(balls).volume / before, before, balls, one, other))
        _, before, balls, one, other = min(tried, key=lambda pair: pair[0])
        around = fitted(balls)
        if around.volume > MERGED * before:
            break
        link = one.link if one.link == other.link else body
        parts = [_Part(link, balls, around), *(part for part in parts if part not in (one, other))]
    return parts
