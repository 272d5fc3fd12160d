"""The robot in a report: in three dimensions, along its recordings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import lru_cache
from hashlib import sha256
from typing import Any

import numpy as np
from markupsafe import Markup

from dynident.identification import Identification
from dynident.identification.links import BodyInertia, DeterminedBy, LinkInertia, link_inertias, rigid_bodies
from dynident.models import Geometry, Outline, RigidBodies, outlines, rod_geometry
from dynident.project.export import Export, FileError
from dynident.report.figures import AMBER, Trace, plain, time_origin
from dynident.report.identification.parameters import link_title
from dynident.report.page import Column, Figure, PageBlock, PageSection, PageTable, relative_link
from dynident.report.scene import (
    STILL,
    Ellipsoid,
    Layer,
    MovingTrace,
    Replay,
    centre_marks,
    ellipsoid_circles,
    legend_key,
    lighten_colour,
    root_surface,
    scene_figure,
    solid_ellipsoids,
    surface,
)
from dynident.report.words import SOURCES, Source, labelled_logs, tiny
from dynident.runtime import count, number, percent

MAX_TRIANGLES = 300  # of a link
REPLAY_RATE = 25.0  # Hz, of the poses along a recording, which the page draws a line between
MAX_POSES = 60_000  # positions of single bodies in all recordings of a page
VIEW_HEIGHT, SMALL_VIEW_HEIGHT = 470, 250  # px, heights
CAMERA_DISTANCE = 1.4  # diagonals of the arm from which the small view looks at it
LEGEND = {
    "orientation": "h", "x": 0, "y": 0, "yref": "container", "yanchor": "bottom", "itemclick": False,
    "itemdoubleclick": False,
}  # fmt: skip
NO_MARGIN = {"t": 0, "l": 0, "r": 0}
_VIEW = (
    "Play moves the arm along the recording, with the line in the torques; so does a pointer in a figure over time. "
    "Drag to turn the view. The colour of a link says how most of its ten parameters were determined: "
)
_INERTIA = (
    " Inertia shows in each link the ellipsoid of even density that has its mass and inertia, solid as found and as "
    "circles as in the file."
)

_LEAD = (
    "Each file was loaded again before it was written, and its torque compared with that of the identified model, "
    "without what the format cannot hold: the largest difference of a joint, relative to the norm of its torque."
)


def robot_blocks(identification: Identification, geometry: Geometry | None = None) -> Iterator[PageBlock]:
    """Yield the words on the robot and, last, its view, which the page moves along the recordings.

    There is nothing to yield where the model is not from a robot file, or this gives its bodies no mass.
    """
    bodies = rigid_bodies(identification)
    if bodies is None or not identification.validations:
        return
    links = link_inertias(identification)
    moving, still = _arm_traces(bodies, links, geometry)
    if not moving:
        return
    inertia = list(_inertia_traces(links))
    moving_count, trace_count = len(moving), len(moving) + len(inertia)
    layers = [Layer("Inertia", tuple(range(moving_count, trace_count)), tuple(range(moving_count)))] if inertia else []
    figure = scene_figure(bodies, _recording_replays(identification), [*moving, *inertia], still, layers)
    figure.layout.update(height=VIEW_HEIGHT, showlegend=True, legend=LEGEND, margin={**NO_MARGIN, "b": 50})
    yield _VIEW + _meanings(links) + (_INERTIA if inertia else "")
    yield Figure(figure, "The arm, in the frame of the root link (m).")


def robot_view(identification: Identification, geometry: Geometry | None = None) -> Figure | None:
    """Return a small view of the robot without axes, which follows the other figures.

    None where the model is not from a robot file.
    """
    bodies = rigid_bodies(identification)
    if bodies is None or not identification.validations:
        return None
    links = link_inertias(identification)
    moving, still = _arm_traces(bodies, links, geometry)
    if not moving:
        return None
    caption = f"How most parameters of a link are determined: {_meanings(links)}"
    return _small_view(bodies, _recording_replays(identification), moving, still, caption)


def payload_view(bodies: RigidBodies, geometry: Geometry, place: int, payload: BodyInertia) -> Figure | None:
    """Return a small view of an arm, all joints at zero, with a payload on the body at ``place`` of ``Arm.bodies``.

    The payload is given in the joint frame of that body; None where no body can have its inertia.
    """
    if payload.ellipsoid is None:
        return None
    moving, still = _arm_traces(bodies, (), geometry)
    solid = Ellipsoid(place, payload.centre, payload.ellipsoid, payload.axes, AMBER)
    moving, still = [*moving, solid_ellipsoids([solid], "payload")], [*still, legend_key("payload", AMBER)]
    pose = Replay("", 0.0, 0.0, np.zeros((1, len(bodies.joints))))
    caption = "The payload on the arm, as an ellipsoid of even density with its mass and inertia; all joints at zero."
    return _small_view(bodies, [pose], moving, still, caption)


def _small_view(
    bodies: RigidBodies, replays: Sequence[Replay], moving: Sequence[MovingTrace], still: Sequence[Trace], caption: str
) -> Figure:
    """Return a view without axes and controls, from a camera near the arm."""
    figure = scene_figure(bodies, replays, moving, still)
    figure.layout.update(height=SMALL_VIEW_HEIGHT, showlegend=True, legend=LEGEND, margin={**NO_MARGIN, "b": 26})
    scene = figure.layout["scene"]
    scene["camera"] = _camera_towards(figure.data[: len(moving)], scene)
    for axis in "xyz":
        scene[f"{axis}axis"]["visible"] = False
    return Figure(figure, caption, player=False)


def _camera_towards(arm: Sequence[Trace], scene: dict[str, Any]) -> dict[str, Any]:
    """Return the camera of a ``scene`` that looks at the ``arm`` from the side from which it is already seen."""
    low, high = (np.array([edge([edge(trace[axis]) for trace in arm]) for axis in "xyz"]) for edge in (np.min, np.max))
    start, stop = np.array([scene[f"{axis}axis"]["range"] for axis in "xyz"]).T
    extent = (stop - start).max()
    # Plotly measures the camera in units of the longest side, from the centre of the view
    middle = ((low + high) - (start + stop)) / (2 * extent)
    side = np.array([scene["camera"]["eye"][axis] for axis in "xyz"])
    away = CAMERA_DISTANCE * float(np.linalg.norm(high - low)) / extent * side / np.linalg.norm(side)
    places = {"center": middle, "eye": middle + away}
    # Adding zero makes a rounded -0 plain
    return {key: dict(zip("xyz", (np.round(at, 6) + 0.0).tolist(), strict=True)) for key, at in places.items()}


@lru_cache(maxsize=1)
def _cached_outlines(geometry: Geometry) -> tuple[Outline, ...]:
    """Return the surfaces of the links; kept, because a page may have several views."""
    return outlines(geometry, max_triangles=MAX_TRIANGLES)


def _arm_traces(
    bodies: RigidBodies, links: Sequence[LinkInertia], geometry: Geometry | None
) -> tuple[list[MovingTrace], list[Trace]]:
    """Return the surfaces of the bodies, coloured by what determined them, and what stands still: root and legend."""
    shapes = _cached_outlines(geometry or rod_geometry(bodies))
    links_by_body = {link_inertia.body: link_inertia for link_inertia in links}
    moving: list[MovingTrace] = []
    for shape in (shape for shape in shapes if shape.body >= 0):
        link = links_by_body.get(shape.body)
        name = link_title(bodies.arm.bodies[shape.body].links)
        hover_text = "<br>".join(map(plain, [name] if link is None else _hover_lines(link)))
        colour = STILL if link is None else SOURCES[link.main_source].colour
        colour = lighten_colour(colour) if len(moving) % 2 else colour
        moving.append(surface(shape, name, colour, hoverinfo="text", hovertext=hover_text))
    keys = [legend_key(source.key, source.colour) for source in _main_sources(links)]
    return moving, [*(root_surface(shape) for shape in shapes if shape.body < 0), *keys]


def _hover_lines(link: LinkInertia) -> Iterator[str]:
    yield link_title(link.links)
    inertias = [(origin, x) for origin, x in (("found", link.identified), ("file", link.file)) if x is not None]
    if masses := [f"{number(x.mass, 3)} kg ({origin})" for origin, x in inertias if np.isfinite(x.mass)]:
        yield f"mass {', '.join(masses)}"
    yield "by " + ", ".join(f"{SOURCES[x].name} {link.by[x]}" for x in DeterminedBy if link.by.get(x))


def _inertia_traces(links: Sequence[LinkInertia]) -> Iterator[MovingTrace]:
    """Yield the ellipsoids and centres of the links, as found and as in the file; they are hidden at first."""
    found_inertias, file_inertias = {x.body: x.identified for x in links}, {x.body: x.file for x in links}
    colours = {entry.body: SOURCES[entry.main_source].colour for entry in links}
    traces: list[MovingTrace] = []
    if solid := _ellipsoids(found_inertias, colours):
        traces.append(solid_ellipsoids(solid, "found"))
    if outline := _ellipsoids(file_inertias, colours):
        traces.append(ellipsoid_circles(outline, "inertia in the file"))
    for inertias, name, symbol in (
        (found_inertias, "centre found", "circle"),
        (file_inertias, "centre in the file", "circle-open"),
    ):
        centres = [(body, x.centre) for body, x in inertias.items() if x is not None]
        if points := {body: centre for body, centre in centres if np.isfinite(centre).all()}:
            traces.append(centre_marks(points, name, symbol))
    for entry in traces:
        entry.trace["visible"] = False
        yield entry


def _ellipsoids(inertias: Mapping[int, BodyInertia | None], colours: Mapping[int, str]) -> list[Ellipsoid]:
    return [
        Ellipsoid(body, inertia.centre, inertia.ellipsoid, inertia.axes, colours[body])
        for body, inertia in inertias.items()
        if inertia is not None and inertia.ellipsoid is not None and inertia.ellipsoid.any()
    ]


def _meanings(links: Sequence[LinkInertia]) -> str:
    """Return what the colours that occur mean, in a sentence."""
    return f"{'; '.join(f'{source.key} ({source.meaning})' for source in _main_sources(links))}."


def _main_sources(links: Sequence[LinkInertia]) -> list[Source]:
    occurring = {link.main_source for link in links}
    return [source for kind, source in SOURCES.items() if kind in occurring]


def _recording_replays(identification: Identification) -> list[Replay]:
    """Return the recordings, held-out ones first, at even times with the origin of the figures."""
    bodies = len(identification.model.joints)
    # All recordings of the page share a number of poses
    max_poses = max(int(MAX_POSES / (bodies * len(identification.validations))), 2)
    out = []
    for label, motion in ((label, log.motion) for label, log in labelled_logs(identification)):
        t = motion.t - time_origin(motion.t)
        columns = [motion.joints.index(joint.name) for joint in identification.model.joints]
        even = np.linspace(t[0], t[-1], min(int((t[-1] - t[0]) * REPLAY_RATE) + 2, max_poses))
        q = np.stack([np.interp(even, t, np.nan_to_num(motion.q[:, column])) for column in columns], axis=1)
        out.append(Replay(label, float(t[0]), float(t[-1]), q))
    return out


def export_section(exports: Sequence[Export]) -> Iterator[PageSection]:
    """Yield the section on the files, where there are any."""
    if not exports:
        return
    rows = []
    for export in exports:
        proof = (tiny(export.proof.agreement), ", ".join(export.proof.readers)) if export.proof else ("-", "-")
        rows.append((export.file, *proof, "yes" if export.ready else "no"))
    heads = ("difference", Column("loaded by", numeric=False), Column("written", numeric=False))
    files = [export.file if export.ready else "" for export in exports]
    blocks: list[PageBlock] = [_LEAD, PageTable.of(("file",), heads, rows, "Files of the identified model", files)]
    for export in exports:
        notes = [f"Not written: {export.refusal}"] if export.refusal else []
        if export.written:
            notes += [*export.written.notes, *(f"Not in the file: {words}." for words in export.written.left_out)]
        notes += export.proof.skipped if export.proof else ()
        if notes:
            blocks.append(PageSection(export.file, (tuple(notes),)))
    costs = [(export.file, error) for export in exports for error in _file_errors(export)]
    if rows := [(file, error.log, number(error.model, 4), number(error.file, 4)) for file, error in costs]:
        caption = "Relative torque error of the model, and of files that leave something of it out"
        blocks.append(PageTable.of(("file", "log"), ("model (%)", "file (%)"), rows, caption))
    yield PageSection("Files of the model", tuple(blocks))


def export_links(exports: Sequence[Export]) -> tuple[str, ...]:
    """Return links to the files that lie beside the report, as one paragraph of HTML; nothing where there are none."""
    files = [export.file for export in exports if export.ready]
    if not files:
        return ()
    link = Markup('<a href="{}">{}</a>')
    links = Markup(", ").join(link.format(relative_link(name), name) for name in ("result.json", *files))
    return (Markup('<p class="files">Files: {}</p>').format(links),)


def _file_errors(export: Export) -> Sequence[FileError]:
    """Return the errors of a file that leaves something out, on held-out logs, or on all where none is held out."""
    if export.written is None or not export.written.left_out:
        return ()
    return [error for error in export.errors if error.role == "validation"] or export.errors


def export_notes(exports: Sequence[Export], place: str = "listed in the report") -> list[str]:
    """Return the notes for a terminal: refusals, and how much each file leaves out, listed at ``place``."""
    notes = [f"{export.file} is not written: {export.refusal}" for export in exports if export.refusal]
    for export in exports:
        if export.ready and export.written:
            if left_out := export.written.left_out:
                notes.append(f"{export.file} cannot store {count(len(left_out), 'item')}, {place}.{_cost(export)}")
            notes += [f"{export.file}: {note}." for note in export.written.notes]
    return notes


def _cost(export: Export) -> str:
    """Return a sentence on the log on which the file is worst, compared with the model."""
    worst = max(_file_errors(export), key=lambda error: error.file - error.model, default=None)
    if worst is None:
        return ""
    file, model = percent(worst.file, 3), percent(worst.model, 3)
    return f" Used alone, its torque error on {worst.log!r} is {file}; that of the full model is {model}."


def export_results(exports: Sequence[Export]) -> list[dict[str, Any]]:
    """Return the files as plain values: file, sha256, format, agreement, proven, readers, left_out, notes,
    refusal, and errors: the torque error (%) of model and file on each log.
    """
    results = []
    for export in exports:
        written, proof = export.written, export.proof
        results.append({
            "file": export.file,
            "sha256": sha256(written.text.encode(errors="backslashreplace")).hexdigest() if written else None,
            "format": export.format, "agreement": proof.agreement if proof else None, "proven": export.ready,
            "readers": dict(proof.readers) if proof else {}, "left_out": list(written.left_out) if written else [],
            "notes": [*(written.notes if written else ()), *(proof.skipped if proof else ())],
            "refusal": export.refusal, "errors": [asdict(error) for error in export.errors],
        })  # fmt: skip
    return results
