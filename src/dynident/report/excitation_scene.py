"""The arm along a designed motion: in three dimensions, and its distances to itself and to what stands around it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import singledispatch
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dynident.excitation import Box, CapsuleSpace, Cylinder, Floor, Made, Trajectory
from dynident.models import RigidBodies
from dynident.report import figures
from dynident.report.page import Column, Figure, PageBlock, PageSection, PageTable, number

if TYPE_CHECKING:
    from dynident.excitation import Design

__all__ = ["clearance_of", "scene_section"]

Array = NDArray[np.float64]
FRAMES = 400  # of the arm along its path
CHECKED = 100.0  # Hz, at most, of the distances that are drawn
MOST = 6000  # samples of them
PAIRS = 12  # in the table
TALL = 3.0  # m: a cylinder without end is drawn so far
_MADE = {
    Made.COLLISION: "collision shapes",
    Made.VISUAL: "visual shapes: it has no collision shapes",
    Made.JOINTS: "the places of its joints: it has no shapes, or they were not found",
}
_WHAT = (
    "Drag to turn the view; Play moves the arm along the motion as fast as it will move, Turn goes around it. The "
    "bodies are drawn by the capsules of which the distances are computed."
)


def _sampled(trajectory: Trajectory) -> Array:
    return trajectory.times(min(CHECKED, MOST / trajectory.duration))


def clearance_of(found: Design, trajectory: Trajectory) -> float | None:
    """Return the smallest distance (m) along a trajectory, None where nothing can meet."""
    if not found.space.pairs:
        return None
    return float(found.space.distances(trajectory.states(_sampled(trajectory))[0]).min())


def scene_section(found: Design) -> PageSection:
    """Return the section of the arm: the view, the distances over time, the closest pairs."""
    return PageSection("The arm along its path", (*_view(found), *_distances(found)))


def _view(found: Design) -> Iterator[PageBlock]:
    """Yield the arm in three dimensions, where its bodies are known."""
    bodies = next((one for one in found.model.terms if isinstance(one, RigidBodies)), None)
    if bodies is None or not isinstance(found.space, CapsuleSpace):
        yield "The model has no bodies of a robot file, which could be drawn and kept clear of each other."
        return
    t = np.linspace(0.0, found.trajectory.duration, FRAMES)
    placed = bodies.placements(found.trajectory.states(t)[0])
    meshes = _meshes(found.space)
    moving = {k: one for k, one in meshes.items() if k >= 0}
    if not moving:
        return
    last = max(moving)
    tip = moving[last].vertices.mean(axis=0)
    path = (placed.rotations[:, last] @ tip + placed.origins[:, last]).astype(np.float32)
    reach = float(np.abs(path).max()) + 0.3
    still = [*(one for k, one in meshes.items() if k < 0), *(drawn(one, reach) for one in found.space.obstacles)]
    figure = figures.scene_figure(t, moving, placed.rotations, placed.origins, still, path)
    yield _WHAT
    yield Figure(figure, "The motion, with the path of the last body, in the frame of the root link (m).")


def _meshes(space: CapsuleSpace) -> Mapping[int, figures.Mesh]:
    """Return the capsules of each body as one mesh, by the place of the body."""
    found: dict[int, list[figures.Mesh]] = {}
    for one in space.capsules:
        found.setdefault(one.body, []).append(figures.capsule(one.link, one.start, one.end, one.radius))
    names = {k: ", ".join(dict.fromkeys(one.name for one in meshes)) for k, meshes in found.items()}
    return {k: figures.joined(names[k], meshes) for k, meshes in sorted(found.items())}


@singledispatch
def drawn(obstacle: object, reach: float) -> figures.Mesh:  # noqa: ARG001
    """Return an obstacle as triangles; one without end as far as the arm ``reach``es (m)."""
    raise TypeError(f"{type(obstacle).__name__} is no obstacle.")


@drawn.register
def _(floor: Floor, reach: float) -> figures.Mesh:
    return figures.plate("floor", floor.height, reach)


@drawn.register
def _(box: Box, reach: float) -> figures.Mesh:  # noqa: ARG001
    return figures.box(box.name, np.array(box.centre), np.array(box.size))


@drawn.register
def _(one: Cylinder, reach: float) -> figures.Mesh:
    bottom = one.bottom if np.isfinite(one.bottom) else min(-reach, one.top - TALL)
    top = one.top if np.isfinite(one.top) else max(reach, bottom + TALL)
    return figures.cylinder(one.name, np.array([*one.centre, bottom]), np.array([*one.centre, top]), one.radius)


def _distances(found: Design) -> Iterator[PageBlock]:
    """Yield the smallest distance over time, the closest pairs, and what is not watched."""
    space, t = found.space, _sampled(found.trajectory)
    if not space.pairs:
        yield "Nothing that could meet is known: no collision was looked at."
        return
    all_of = space.distances(found.trajectory.states(t)[0])
    caption = f"Smallest distance of all pairs over time; {1e3 * found.request.clearance:.0f} mm are kept (dashed)."
    yield Figure(figures.distance_figure(t, all_of.min(axis=1), found.request.clearance), caption)
    yield _closest(space.pairs, t, all_of)
    if isinstance(space, CapsuleSpace):
        yield from _made(space)


def _closest(pairs: tuple[tuple[str, str], ...], t: Array, distances: Array) -> PageTable:
    """Return the closest pairs by name, each at its closest."""
    least: dict[tuple[str, str], tuple[float, float]] = {}
    for pair, column in zip(pairs, distances.T, strict=True):
        when = int(column.argmin())
        if pair not in least or column[when] < least[pair][0]:
            least[pair] = float(column[when]), float(t[when])
    rows = sorted(least.items(), key=lambda one: one[1][0])[:PAIRS]
    cells = tuple((*pair, number(1e3 * size, 3), number(when, 3)) for pair, (size, when) in rows)
    columns = (*(Column(head, numeric=False) for head in ("", "and")), Column("distance, mm"), Column("at, s"))
    return PageTable(columns, cells, "Closest pairs")


def _made(space: CapsuleSpace) -> Iterator[PageBlock]:
    """Yield what the capsules of the links are made of, and the pairs that are not watched."""
    sources = {one.link: one.made for one in space.capsules}
    for made in Made:
        links = [link for link, source in sources.items() if source is made]
        if links:
            yield f"Capsules around {', '.join(links)}: of {_MADE[made]}."
    if space.left_out:
        named = ", ".join(f"{one} and {other}" for one, other in space.left_out)
        yield f"Not watched, because they touch in nearly every pose: {named}."
