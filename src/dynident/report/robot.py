"""The robot in a report: in three dimensions, along its recordings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dynident.excitation import Geometry, Outline, outlines, rods_of
from dynident.identification.links import BodyInertia, DeterminedBy, LinkInertia, link_inertias, rigid_bodies
from dynident.report import figures
from dynident.report.figures.canvas import AMBER, BLUE, GREEN, RED, VIOLET, Trace, origin, plain
from dynident.report.links import WORDS, title_of
from dynident.report.page import Figure, PageBlock, number
from dynident.report.words import labelled

if TYPE_CHECKING:
    from dynident.identification import Identification
    from dynident.models import RigidBodies

__all__ = ["COLOURS", "robot_blocks", "robot_view"]

Array = NDArray[np.float64]
TRIANGLES = 300  # of a link
RATE = 25.0  # Hz, of the poses along a recording, which the page draws a line between
POSES = 60_000  # positions of single bodies in all recordings of a page
VIEW, SMALL = 470, 250  # px, heights
ROUND = 1.4  # diagonals of the arm from which the small view looks at it
LEGEND = {
    "orientation": "h",
    "x": 0,
    "y": 0,
    "yref": "container",
    "yanchor": "bottom",
    "itemclick": False,
    "itemdoubleclick": False,
}
COLOURS = {
    DeterminedBy.DATA: BLUE,
    DeterminedBy.COMBINATION: GREEN,
    DeterminedBy.PRIOR: AMBER,
    DeterminedBy.BOUND: RED,
    DeterminedBy.NOTHING: VIOLET,
}
_VIEW = (
    "Play moves the arm along the recording, with the line in the torques; so does a pointer in a figure over time. "
    "Drag to turn the view. A link has the colour of what determined most of its ten parameters."
)
_INERTIA = (
    " Inertia shows in each link the ellipsoid of even density that has its mass and inertia, solid as found and as "
    "circles as in the file."
)


def robot_blocks(identification: Identification, geometry: Geometry | None = None) -> Iterator[PageBlock]:
    """Yield words on the robot and, last, its view, which the page moves along the recordings; none where the model is
    not of a robot file."""
    bodies = rigid_bodies(identification)
    if bodies is None or not identification.validations:
        return
    links, shown = link_inertias(identification), _outlines(geometry or rods_of(bodies))
    moving = _surfaces(bodies, links, shown)
    inertia = list(_inertia_traces(links))
    still = [*(figures.standing(one) for one in shown if one.body < 0), *_keys(links)]
    first, end = len(moving), len(moving) + len(inertia)
    layers = [figures.Layer("Inertia", tuple(range(first, end)), tuple(range(first)))] if inertia else []
    figure = figures.scene_figure(bodies, _replays(identification), [*moving, *inertia], still, layers, VIEW)
    figure.layout.update(showlegend=True, legend=LEGEND, margin={"t": 0, "l": 0, "r": 0, "b": 50})
    yield _VIEW + (_INERTIA if inertia else "")
    yield Figure(figure, "The arm, in the frame of the root link (m).")


def robot_view(identification: Identification, geometry: Geometry | None = None) -> Figure | None:
    """Return a small view of the robot without axes, which follows the others; None where the model is not of a robot
    file."""
    bodies = rigid_bodies(identification)
    if bodies is None or not identification.validations:
        return None
    shown = _outlines(geometry or rods_of(bodies))
    moving = _surfaces(bodies, link_inertias(identification), shown)
    still = [figures.standing(one) for one in shown if one.body < 0]
    if not moving:
        return None
    figure = figures.scene_figure(bodies, _replays(identification), moving, still, (), SMALL)
    scene = figure.layout["scene"]
    scene["camera"] = _towards(figure.data[: len(moving)], scene)
    for axis in "xyz":
        scene[f"{axis}axis"]["visible"] = False
    return Figure(figure, "Links in the colour of what determined them (see below).", player=False)


def _towards(arm: Sequence[Trace], scene: dict[str, Any]) -> dict[str, Any]:
    """Return the camera of a ``scene`` that looks at the ``arm`` as it is drawn, from the side that it has already."""
    low, high = (np.array([edge([edge(one[axis]) for one in arm]) for axis in "xyz"]) for edge in (np.min, np.max))
    start, stop = np.array([scene[f"{axis}axis"]["range"] for axis in "xyz"]).T
    whole = (stop - start).max()
    middle = ((low + high) - (start + stop)) / (2 * whole)
    side = np.array([scene["camera"]["eye"][axis] for axis in "xyz"])
    away = ROUND * float(np.linalg.norm(high - low)) / whole * side / np.linalg.norm(side)
    return {key: dict(zip("xyz", at.tolist(), strict=True)) for key, at in (("center", middle), ("eye", middle + away))}


@lru_cache(maxsize=1)
def _outlines(geometry: Geometry) -> tuple[Outline, ...]:
    """Return the surfaces of the links; kept, because a page may have several views."""
    return outlines(geometry, most=TRIANGLES)


def _surfaces(bodies: RigidBodies, links: Sequence[LinkInertia], shown: Sequence[Outline]) -> list[figures.Moving]:
    """Return the surfaces of the bodies, in the colour of what determined them, with what to say of each."""
    known = {one.body: one for one in links}
    out: list[figures.Moving] = []
    for one in shown:
        if one.body < 0:
            continue
        link = known.get(one.body)
        name = title_of(bodies.arm.bodies[one.body].links)
        said = "<br>".join(map(plain, [name] if link is None else _hover(link)))
        colour = figures.STILL if link is None else COLOURS[link.mostly]
        colour = figures.lighter(colour) if len(out) % 2 else colour
        out.append(figures.surface(one, name, colour, hoverinfo="text", hovertext=said))
    return out


def _hover(link: LinkInertia) -> Iterator[str]:
    yield title_of(link.links)
    masses = ((what, one.mass) for what, one in (("found", link.found), ("file", link.file)) if one is not None)
    if known := ", ".join(f"{number(mass, 3)} kg ({what})" for what, mass in masses if np.isfinite(mass)):
        yield f"mass {known}"
    yield "by " + ", ".join(f"{WORDS[one]} {link.by[one]}" for one in DeterminedBy if link.by.get(one))


def _inertia_traces(links: Sequence[LinkInertia]) -> Iterator[figures.Moving]:
    """Yield what shows the inertia of links, as found and as in the file, hidden at first."""
    found, file = ({one.body: one.found for one in links}, {one.body: one.file for one in links})
    colours = {one.body: COLOURS[one.mostly] for one in links}
    traces: list[figures.Moving] = []
    if solid := _ellipsoids(found, colours):
        traces.append(figures.ellipsoids(solid, "found"))
    if outline := _ellipsoids(file, colours):
        traces.append(figures.outlined(outline, "inertia in the file"))
    for known, name, symbol in ((found, "centre found", "circle"), (file, "centre in the file", "circle-open")):
        points = {body: one.centre for body, one in known.items() if one is not None and np.isfinite(one.centre).all()}
        if points:
            traces.append(figures.centres(points, name, symbol))
    for one in traces:
        one.trace["visible"] = False
        yield one


def _ellipsoids(known: Mapping[int, BodyInertia | None], colours: Mapping[int, str]) -> list[figures.Ellipsoid]:
    return [
        figures.Ellipsoid(body, one.centre, one.ellipsoid, one.axes, colours[body])
        for body, one in known.items()
        if one is not None and one.ellipsoid is not None and one.ellipsoid.any()
    ]


def _keys(links: Sequence[LinkInertia]) -> list[Trace]:
    """Return the legend of the colours that there are."""
    there = {one.mostly for one in links}
    return [figures.key(f"by {WORDS[one]}", COLOURS[one]) for one in DeterminedBy if one in there]


def _replays(identification: Identification) -> list[figures.Replay]:
    """Return the recordings, those held out first, at even times as the figures count them."""
    bodies = len(identification.model.joints)
    most = max(int(POSES / (bodies * len(identification.validations))), 2)
    out = []
    for label, k in labelled(identification):
        motion = identification.validations[k].motion
        t, columns = motion.t - origin(motion.t), [motion.joints.index(one.name) for one in identification.model.joints]
        even = np.linspace(t[0], t[-1], min(int((t[-1] - t[0]) * RATE) + 2, most))
        q = np.stack([np.interp(even, t, np.nan_to_num(motion.q[:, column])) for column in columns], axis=1)
        out.append(figures.Replay(label, float(t[0]), float(t[-1]), q))
    return out
