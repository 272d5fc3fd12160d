"""The arm along a designed motion: in three dimensions, and its distances to itself and to what stands around it."""

from __future__ import annotations

from collections.abc import Iterator
from functools import singledispatch
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dynident.excitation import Box, CapsuleSpace, Cylinder, Floor, Geometry, Made, outlines
from dynident.report import figures
from dynident.report.links import missing_words
from dynident.report.page import Column, Figure, PageBlock, PageSection, PageTable, number

if TYPE_CHECKING:
    from dynident.excitation import Design
    from dynident.io.excitation import ExcitationProject

__all__ = ["scene_section"]

Array = NDArray[np.float64]
FRAMES = 400  # of the arm along its path
CHECKED = 100.0  # Hz, at most, of the distances that are drawn
MOST = 6000  # samples of them
PAIRS = 12  # in the table
BEYOND = 0.15  # m of a floor around the path
TALL = 3.0  # m: a cylinder without end is drawn so far
_MADE = {
    Made.COLLISION: "their collision shapes",
    Made.VISUAL: "what is seen of them, as the file has no collision shapes of them",
    Made.JOINTS: "the lines between their joints, as their shapes are not known: look whether they are as thick",
}
_WHAT = (
    "Drag to turn the view; Play moves the arm along the motion as fast as it will move, Turn goes around it. The "
    "bodies are drawn with few triangles; distances are between the capsules around them."
)


def scene_section(project: ExcitationProject, found: Design) -> PageSection:
    """Return the section of the arm: the view, the distances over time, the closest pairs, how the links are made."""
    return PageSection("The arm along its path", (*_view(project, found), *_distances(project, found)))


def _view(project: ExcitationProject, found: Design) -> Iterator[PageBlock]:
    """Yield the arm in three dimensions, where its bodies are known."""
    space, geometry = found.space, project.geometry
    if geometry is None or not isinstance(space, CapsuleSpace):
        yield "The model is not made of a robot file, so that its bodies can neither be drawn nor be kept clear."
        return
    bodies, stop = geometry.bodies, found.trajectory.duration
    q = found.trajectory.states(np.linspace(0.0, stop, FRAMES))[0]
    shown = outlines(geometry, space.capsules)
    arm = sorted((one for one in shown if one.body >= 0), key=lambda one: one.body)
    if not arm:
        return
    moving = [
        figures.surface(one, ", ".join(bodies.arm.bodies[one.body].links), figures.METAL[place % 2])
        for place, one in enumerate(arm)
    ]
    last = arm[-1]
    tip = last.mesh.vertices.mean(axis=0)
    path = bodies.placements(q).points([last.body], tip[None])[:, 0]
    reach = float(np.abs(path[:, :2]).max()) + BEYOND
    still = [
        *(figures.standing(one) for one in shown if one.body < 0),
        *(figures.solid(drawn(one, reach), figures.STILL, 0.35) for one in project.obstacles),
        figures.path_of(path),
    ]
    figure = figures.scene_figure(bodies, [figures.Replay("", 0.0, stop, q)], moving, still)
    yield _WHAT
    yield Figure(figure, "The motion, with the path of the last body, in the frame of the root link (m).")


@singledispatch
def drawn(obstacle: object, reach: float) -> figures.Mesh:  # noqa: ARG001
    """Return an obstacle as triangles; one without end as far as the arm ``reach``es (m)."""
    raise TypeError(f"{type(obstacle).__name__} is no obstacle.")


@drawn.register
def _(floor: Floor, reach: float) -> figures.Mesh:
    return figures.plate("floor", floor.height, reach)


@drawn.register
def _(box: Box, reach: float) -> figures.Mesh:  # noqa: ARG001
    return figures.box(box.name, np.array(box.centre), np.array(box.size), np.array(box.axes))


@drawn.register
def _(one: Cylinder, reach: float) -> figures.Mesh:
    bottom = one.bottom if np.isfinite(one.bottom) else min(-reach, one.top - TALL)
    top = one.top if np.isfinite(one.top) else max(reach, bottom + TALL)
    return figures.cylinder(one.name, np.array(one.centre), one.radius, bottom, top)


def _distances(project: ExcitationProject, found: Design) -> Iterator[PageBlock]:
    """Yield the smallest distance over time, the closest pairs, how the links are made, and what is not watched."""
    space = found.space
    if not space.pairs:
        yield "Nothing that could meet is known: no collision was looked at."
        return
    t = found.trajectory.times(min(CHECKED, MOST / found.trajectory.duration))
    all_of = space.distances(found.trajectory.states(t)[0])
    caption = f"Smallest distance of all pairs over time; {1e3 * found.request.clearance:.0f} mm are kept (dashed)."
    yield Figure(figures.distance_figure(t, all_of.min(axis=1), found.request.clearance), caption)
    yield _closest(space.pairs, t, all_of)
    if isinstance(space, CapsuleSpace) and project.geometry is not None:
        yield tuple(_made(project.geometry))


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


def _made(geometry: Geometry) -> Iterator[str]:
    """Yield what the capsules of the links are made of, and which meshes are missing."""
    for made in Made:
        if links := [geometry.link(body) for body, one in geometry.made.items() if one is made]:
            yield f"Distances of {', '.join(links)}: by capsules around {_MADE[made]}."
    yield from missing_words(geometry)
