"""Which pairs of an arm and its surroundings are watched: all that can meet and do not always touch."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from dynident.errors import ConfigError, InputError
from dynident.excitation.spaces.capsules import Capsule, capsules_of, still_boxes
from dynident.excitation.spaces.clearance import CapsuleSpace
from dynident.excitation.spaces.geometry import Geometry
from dynident.excitation.spaces.obstacles import obstacle_name
from dynident.excitation.spaces.space import Box, Distances, Obstacle
from dynident.models import RigidBodies

__all__ = [
    "CLEARANCE",
    "always_near",
    "candidates",
    "capsule_space",
    "neighbours",
    "poses",
    "refuse_contact",
    "space_of",
    "spread",
]

Array = NDArray[np.float64]
Integers = NDArray[np.intp]
POSES = 600
CLEARANCE, BESIDE = 0.01, 0.01  # m: what is kept free, and more than that by which links are near each other
USUAL = 0.9  # share of the poses in which links are near each other that are left out
WITHIN = 0.15  # m inside an obstacle: more than a link reaches that is mounted on it
WHOLE = np.pi  # rad or m: the range of a joint without limits, to both sides


def capsule_space(
    bodies: RigidBodies,
    capsules: Sequence[Capsule],
    obstacles: Sequence[Obstacle] = (),
    lower: Array | None = None,
    upper: Array | None = None,
    own: Sequence[Box] = (),
    clearance: float = CLEARANCE,
) -> CapsuleSpace:
    """Return the distances of an arm whose links have these capsules, with the pairs to be watched.

    These are all pairs of links, but not a body and the next one (of those that have capsules), and all pairs of a
    moving link and an obstacle. Left out, and named, are links that in at least 90 % of 600 poses are nearer than 10 mm
    more than the ``clearance`` (m), because they are parts of a wrist, and what is nearer to an obstacle than the
    clearance in all of them, because it stands there. The poses are spread evenly between ``lower`` and ``upper`` (n;
    None: of the file). Boxes of its ``own`` are parts of links that stand still.

    Raises ConfigError for an obstacle that the end of the arm is at in all of them, or another link 150 mm inside it.
    """
    capsules, obstacles = tuple(capsules), (*own, *obstacles)
    # boxes of its own count as parts of the root link here
    pairs = candidates(bodies, [*(one.body for one in capsules), *(-1 for _ in own)])
    count = len(capsules)
    meetings = _places([pair for pair in pairs if max(pair) < count])
    on_own = sorted(((one, other - count) for one, other in pairs if other >= count), key=lambda pair: pair[1])
    moving = [place for place, one in enumerate(capsules) if one.body >= 0]
    encounters = _places([*on_own, *((one, other) for other in range(len(own), len(obstacles)) for one in moving)])
    every = CapsuleSpace(bodies, capsules, obstacles, meetings, encounters)
    distances = every.distances(spread(bodies, lower, upper))
    kept = ~always_near(distances, len(meetings) + len(on_own), clearance)
    met, near = kept[: len(meetings)], kept[len(meetings) :]
    _refuse_within(every, distances[:, len(meetings) :].max(axis=0), near, len(own))
    unwatched = meetings[~met], encounters[~near]
    return CapsuleSpace(bodies, capsules, obstacles, meetings[met], encounters[near], unwatched)


def _refuse_within(space: CapsuleSpace, best: Array, near: NDArray[np.bool_], own: int) -> None:
    """Raise ConfigError where a link at the end of the arm is at an obstacle in every pose, or another one deep inside
    it; ``best`` are the largest distances (M) of the encounters, of which ``near`` ones are kept. The first obstacles
    are the arm's ``own``."""
    inner = {body.parent for body in space.bodies.arm.bodies}
    for k in np.flatnonzero(~near & (space.encounters[:, 1] >= own)):
        capsule, obstacle = space.capsules[space.encounters[k, 0]], space.obstacles[space.encounters[k, 1]]
        if capsule.body not in inner or best[k] < -WITHIN:
            where = f"overlaps it by {-1e3 * best[k]:.0f} mm or more" if best[k] < 0 else "is nearer than the clearance"
            raise ConfigError(
                f"{obstacle_name(obstacle)!r}: in every pose {capsule.link!r} {where}, so that no motion keeps clear "
                "of it. Correct its place and size, in m along the axes of the root link, or leave it out."
            )


def candidates(bodies: RigidBodies, parts: Sequence[int]) -> list[tuple[int, int]]:
    """Return the pairs of ``parts``, each given by its body, that may meet: not of a body and the next one (of those
    that have parts), nor of one body."""
    next_to = neighbours(bodies, set(parts))
    return [
        (one, other)
        for one, other in combinations(range(len(parts)), 2)
        if parts[one] != parts[other] and frozenset((parts[one], parts[other])) not in next_to
    ]


def space_of(
    geometry: Geometry,
    obstacles: Sequence[Obstacle] = (),
    lower: Array | None = None,
    upper: Array | None = None,
    clearance: float = CLEARANCE,
) -> CapsuleSpace:
    """Return the distances of an arm with these shapes, by capsules and the boxes of links that stand still; the pairs
    are those of ``capsule_space``."""
    capsules, own = capsules_of(geometry), still_boxes(geometry)
    return capsule_space(geometry.bodies, capsules, obstacles, lower, upper, own, clearance)


def always_near(distances: Array, links: int, clearance: float) -> NDArray[np.bool_]:
    """Return which pairs (P) are near each other by construction, from ``distances`` (N, P) in many poses; the first
    ``links`` pairs are of two links."""
    beside = np.mean(distances < clearance + BESIDE, axis=0) >= USUAL
    return np.where(np.arange(distances.shape[1]) < links, beside, (distances < clearance).all(axis=0))


def spread(bodies: RigidBodies, lower: Array | None, upper: Array | None, count: int = POSES) -> Array:
    """Return ``count`` poses spread evenly between ``lower`` and ``upper`` (n), of the file where None."""
    return poses(*_ranges(bodies, lower, upper), count)


def poses(lower: Array, upper: Array, count: int) -> Array:
    """Return poses (count, n) that fill the range of the joints evenly: the same ones each time.

    An additive recurrence by powers of the root of x^(n + 1) = x + 1 (M. Roberts, 2018).
    """
    n, root = len(lower), 2.0
    for _ in range(40):
        root = (1 + root) ** (1 / (n + 1))
    steps = root ** -np.arange(1.0, n + 1)
    share = (0.5 + np.arange(1, count + 1)[:, None] * steps) % 1.0
    return np.asarray(lower + share * (upper - lower))


def refuse_contact(space: Distances, q: Array, clearance: float, what: str) -> None:
    """Raise InputError where a pose q (n), called ``what``, is nearer to contact than ``clearance`` (m)."""
    distances = space.distances(q[None])[0]
    if distances.size and distances.min() < clearance:
        nearest = int(distances.argmin())
        one, other = space.pairs[nearest]
        apart = float(distances[nearest])
        found = f"overlap by {-1e3 * apart:.0f} mm" if apart < 0 else f"are {1e3 * apart:.0f} mm apart"
        raise InputError(
            f"{what}: {one!r} and {other!r} {found}, and {1e3 * clearance:.0f} mm are to be kept between them; give "
            "another start, correct the obstacles, or ask for less clearance."
        )


def _ranges(bodies: RigidBodies, lower: Array | None, upper: Array | None) -> tuple[Array, Array]:
    """Return the ends (n) of the joints' ranges, as given or of the file; of one without, -pi to pi."""
    limits = [bodies.limits[joint.name] for joint in bodies.joints]
    low = np.array([one.lower for one in limits], dtype=float) if lower is None else np.asarray(lower, dtype=float)
    high = np.array([one.upper for one in limits], dtype=float) if upper is None else np.asarray(upper, dtype=float)
    return np.where(np.isfinite(low), low, -WHOLE), np.where(np.isfinite(high), high, WHOLE)


def neighbours(bodies: RigidBodies, having: set[int]) -> set[frozenset[int]]:
    """Return the pairs of a body and the next one towards the root, of those ``having`` capsules."""
    found = set()
    for body in having - {-1}:
        parent = body
        while parent != -1:
            above = bodies.arm.bodies[parent].parent
            parent = -1 if above is None else above
            if parent in having:
                break
        found.add(frozenset((body, parent)))
    return found


def _places(pairs: Sequence[tuple[int, int]]) -> Integers:
    return np.array(pairs, dtype=np.intp).reshape(-1, 2)
