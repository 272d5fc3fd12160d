"""Distances of an arm, as capsules, to itself and to what stands around it, with exact derivatives by its positions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dynident.errors import brief
from dynident.excitation.spaces.capsules import Capsule
from dynident.excitation.spaces.obstacles import obstacle_name, signed
from dynident.excitation.spaces.reach import reaches, steepest
from dynident.excitation.spaces.segments import between, to_body
from dynident.excitation.spaces.space import Obstacle
from dynident.models import Placements, RigidBodies

__all__ = ["CapsuleSpace"]

Array = NDArray[np.float64]
Integers = NDArray[np.intp]
Found = tuple[Array, Array, Array]  # distances (N, K), the points and the directions (N, K, 3) they grow with
NONE = np.empty((0, 2), dtype=np.intp)
STRETCH = 1.03  # of the smooth distances against the true ones, where axes are 30 mm apart or more
BLOCK = 2000  # samples at once


@dataclass(frozen=True, eq=False)
class CapsuleSpace:
    """The ``capsules`` around the links of an arm, and ``obstacles``.

    Watched are ``meetings``, pairs of capsules (K, 2), and ``encounters`` (M, 2) of a capsule with an obstacle, both
    by their places: P = K + M pairs, in this order. A pair of links with several capsules has several. ``unwatched``
    are the meetings and encounters that are left out because they touch in nearly every pose. Distances are smooth, and
    less than the true ones by at most 1 mm where that is not below 50 mm (``segments.py``).
    """

    bodies: RigidBodies
    capsules: tuple[Capsule, ...]
    obstacles: tuple[Obstacle, ...]
    meetings: Integers
    encounters: Integers
    unwatched: tuple[Integers, Integers] = (NONE, NONE)

    __repr__ = brief

    @property
    def pairs(self) -> tuple[tuple[str, str], ...]:
        """The names of the P pairs: links, or a link and an obstacle."""
        return self._named(self.meetings, self.encounters)

    @cached_property
    def steepest(self) -> Array:
        """The most that a distance changes with a joint, shape (P, n)."""
        far = [one.radius + max(float(np.linalg.norm(end)) for end in (one.start, one.end)) for one in self.capsules]
        bodies, count = [*self._body, -1], len(self.capsules)
        moved = np.array([reaches(self.bodies, body, r) for body, r in zip(bodies, [*far, 0.0], strict=True)])
        pairs = [*self.meetings.tolist(), *((one, count) for one in self.encounters[:, 0].tolist())]
        return STRETCH * steepest(self.bodies, moved, pairs)

    @property
    def left_out(self) -> tuple[tuple[str, str], ...]:
        """The names of the pairs that are not watched, each once."""
        return tuple(dict.fromkeys(self._named(*self.unwatched)))

    def distances(self, q: Array, /) -> Array:
        """Return distances (N, P) in m, negative where a pair overlaps, at positions q (N, n)."""
        blocks = [q[k : k + BLOCK] for k in range(0, len(q), BLOCK)]
        found = [self._distances(self.bodies.placements(block)) for block in blocks]
        return np.concatenate([np.empty((0, len(self.pairs))), *found])

    def gradients(self, q: Array, /) -> tuple[Array, Array]:
        """Return ``distances`` and their derivatives (N, P, n) by q."""
        placed = self.bodies.placements(q)
        starts, along = self._segments(placed)
        met, near = self._met(starts, along), self._near(starts, along)
        distances, points, away = (np.concatenate(pair, axis=1) for pair in zip(met, near, strict=True))
        # a point and the one nearest to it are on one line along the direction, so that both have one moment
        first = self._body[np.concatenate((self.meetings[:, 0], self.encounters[:, 0]))]
        second = np.concatenate((self._body[self.meetings[:, 1]], np.full(len(self.encounters), -1)))
        return distances, placed.pulled(first, points, away) - placed.pulled(second, points, away)

    def _distances(self, placed: Placements) -> Array:
        starts, along = self._segments(placed)
        return np.concatenate((self._met(starts, along)[0], self._near(starts, along)[0]), axis=1)

    def _segments(self, placed: Placements) -> tuple[Array, Array]:
        """Return where the capsules begin (N, C, 3), and what leads to their ends."""
        starts = placed.points(self._body, np.array([one.start for one in self.capsules]).reshape(-1, 3))
        ends = placed.points(self._body, np.array([one.end for one in self.capsules]).reshape(-1, 3))
        return starts, ends - starts

    def _met(self, starts: Array, along: Array) -> Found:
        one, other = self.meetings.T
        distance, point, away = between(starts[:, one], along[:, one], starts[:, other], along[:, other])
        return distance - self._radius[one] - self._radius[other], point, away

    def _near(self, starts: Array, along: Array) -> Found:
        empty = np.empty((len(starts), 0, 3))
        found: list[Found] = [(empty[..., 0], empty, empty)]
        for place, obstacle in enumerate(self.obstacles):
            chosen = self.encounters[self.encounters[:, 1] == place, 0]
            distance, point, away = to_body(starts[:, chosen], along[:, chosen], signed(obstacle))
            found.append((distance - self._radius[chosen], point, away))
        distances, points, away = (np.concatenate(parts, axis=1) for parts in zip(*found, strict=True))
        return distances, points, away

    def _named(self, meetings: Integers, encounters: Integers) -> tuple[tuple[str, str], ...]:
        links, names = [one.link for one in self.capsules], [obstacle_name(one) for one in self.obstacles]
        met = [(links[one], links[other]) for one, other in meetings]
        return (*met, *((links[one], names[other]) for one, other in encounters))

    @cached_property
    def _body(self) -> Integers:
        return np.array([one.body for one in self.capsules], dtype=np.intp)

    @cached_property
    def _radius(self) -> Array:
        return np.array([one.radius for one in self.capsules])
