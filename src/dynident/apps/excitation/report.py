"""The report of a designed motion: what it will tell, the motion and its limits, the arm along its path, what to do."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from dynident.apps.excitation.clearance import CapsuleSpace
from dynident.apps.excitation.design import Design
from dynident.apps.excitation.expected_report import (
    design_facts,
    design_figure,
    distance_figure,
    excitation_findings,
    expected_section,
)
from dynident.apps.excitation.limits import JointLimits
from dynident.apps.excitation.robot import ExcitationProject
from dynident.apps.excitation.trajectory import Trajectory
from dynident.apps.excitation.verify import QUANTITIES
from dynident.identification import versions
from dynident.models import Floor, Geometry, Joint, Mesh, Obstacle, ShapeSource, outlines, solid_surface
from dynident.models.geometry import obstacle_solid
from dynident.report import METAL, STILL, Replay, path_trace, root_surface, scene_figure, solid, surface
from dynident.report.identification.parameters import missing_mesh_notes
from dynident.report.page import UNIT, Beside, Figure, Gallery, PageBlock, PageSection, PageTable, pair_table, render
from dynident.runtime import number, setting_text
from dynident.runtime.arrays import Array

FRAMES = 400  # of the arm along its path
MAX_DISTANCE_RATE = 100.0  # Hz, at most, of the distances that are drawn
MAX_DISTANCE_SAMPLES = 6000  # samples of them
MAX_PAIRS = 12  # in the table
FLOOR_MARGIN = 0.15  # m of a floor around the path
OPEN_CYLINDER_HEIGHT = 3.0  # m: a cylinder without end is drawn so far
_VIEW_NOTE = (
    "The motion, with the path of the last body, in the frame of the root link (m). Play moves the arm as fast as it "
    "will move. Distances are between the capsules around the bodies."
)
VIEW_HEIGHT = 430  # px

DRAWING_RATE, MAX_DRAWN_SAMPLES = 250.0, 20_000  # Hz and samples of what is drawn
MOTIONS = ("motion", "validation")
TRIAL, SLOWER = "trial", 4.0  # the first run: its name, and how many times slower it is
_SLOWLY = (
    f"Run `{TRIAL}.csv` first, with nobody near and a hand at the stop: the same path, {SLOWER:g} times slower. The "
    "limits and the distances are those of the files, not of your room."
)
NO_TRIAL = (
    f"There is no slower motion for a first run: {SLOWER:g} times slower, without momentum, the arm needs more torque "
    "on this path than is allowed, and it may sink where it is stopped. For the first run design another motion, with "
    "a low `velocity` of each joint under `limits`."
)
_RECORD = (
    "Record position and torque of both motions, at the rate of the settings or faster, and save the recordings under "
    "the names in `identify.yaml`."
)
_STEPS = (
    _RECORD,
    "`dynident check identify.yaml`, then `dynident identify identify.yaml --out result`.",
    "For what is still open then: `dynident excite result/result.json -o next`.",
)


def scene_section(project: ExcitationProject, design: Design) -> PageSection:
    """Return the section of what the arm keeps clear of: distances over time, the closest pairs, the links' shapes."""
    is_known = project.geometry is not None and isinstance(design.space, CapsuleSpace)
    remark = "The model is not made of a robot file, so that its bodies can neither be drawn nor be kept clear."
    return PageSection(
        "Distances along the path", (*(() if is_known else (remark,)), *_distance_blocks(project, design))
    )


def arm_view(project: ExcitationProject, design: Design) -> Figure | None:
    """Return the arm in three dimensions along the motion, None where its bodies are not known."""
    space, geometry = design.space, project.geometry
    if geometry is None or not isinstance(space, CapsuleSpace):
        return None
    bodies, stop = geometry.bodies, design.trajectory.duration
    q = design.trajectory.states(np.linspace(0.0, stop, FRAMES))[0]
    shapes = outlines(geometry, space.capsules)
    arm = sorted((shape for shape in shapes if shape.body >= 0), key=lambda shape: shape.body)
    if not arm:
        return None
    moving = [
        surface(shape, ", ".join(bodies.arm.bodies[shape.body].links), METAL[place % 2])
        for place, shape in enumerate(arm)
    ]
    last = arm[-1]
    tip = last.mesh.vertices.mean(axis=0)
    path = bodies.placements(q).points([last.body], tip[None])[:, 0]
    # A floor is drawn a little beyond the path of the last body
    reach = float(np.abs(path[:, :2]).max()) + FLOOR_MARGIN
    still = [
        *(root_surface(shape) for shape in shapes if shape.body < 0),
        *(solid(shape.name, obstacle_mesh(shape, reach), STILL, 0.35) for shape in project.obstacles),
        path_trace(path),
    ]
    figure = scene_figure(bodies, [Replay("", 0.0, stop, q)], moving, still)
    figure.layout["height"] = VIEW_HEIGHT
    figure.layout["scene"]["camera"]["eye"] = {"x": 1.3, "y": 1.09, "z": 0.65}  # a narrow view from farther away
    return Figure(figure, _VIEW_NOTE)


def obstacle_mesh(obstacle: Obstacle, reach: float) -> Mesh:
    """Return an obstacle as triangles; one without end is drawn as far as the arm reaches, ``reach`` (m)."""
    if isinstance(obstacle, Floor):
        corners = reach * np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
        return Mesh(corners + np.array([0.0, 0.0, obstacle.height]), np.array([[0, 1, 2], [0, 2, 3]]))
    return solid_surface(obstacle_solid(obstacle, reach, OPEN_CYLINDER_HEIGHT))


def _distance_blocks(project: ExcitationProject, design: Design) -> Iterator[PageBlock]:
    """Yield the smallest distance over time, the closest pairs, and how the links are modelled."""
    space = design.space
    if not space.pairs:
        yield "Nothing that could meet is known: no collision was looked at."
        return
    t = design.trajectory.times(min(MAX_DISTANCE_RATE, MAX_DISTANCE_SAMPLES / design.trajectory.duration))
    distances = space.distances(design.trajectory.states(t)[0])
    caption = f"Smallest distance of all pairs over time; {1e3 * design.request.clearance:.0f} mm are kept (dashed)."
    yield Figure(distance_figure(t, distances.min(axis=1), design.request.clearance), caption)
    yield _closest_table(space.pairs, t, distances)
    if isinstance(space, CapsuleSpace) and project.geometry is not None:
        yield tuple(_shape_sentences(project.geometry))


def _closest_table(pairs: tuple[tuple[str, str], ...], t: Array, distances: Array) -> PageTable:
    """Return the closest pairs by name, each where it is closest."""
    # A pair of names may stand for several pairs of capsules: keep the closest
    smallest: dict[tuple[str, str], tuple[float, float]] = {}
    for pair, column in zip(pairs, distances.T, strict=True):
        when = int(column.argmin())
        if pair not in smallest or column[when] < smallest[pair][0]:
            smallest[pair] = float(column[when]), float(t[when])
    rows = sorted(smallest.items(), key=lambda entry: entry[1][0])[:MAX_PAIRS]
    cells = tuple((*pair, number(1e3 * size, 3), number(when, 3)) for pair, (size, when) in rows)
    return PageTable.of(("", "and"), ("distance, mm", "at, s"), cells, "Closest pairs")


def _shape_sentences(geometry: Geometry) -> Iterator[str]:
    """Yield what the capsules of the links are made from, and which meshes are missing."""
    for kind in ShapeSource:
        if links := [geometry.link(body) for body, body_kind in geometry.sources.items() if body_kind is kind]:
            yield f"Distances of {', '.join(links)}: by capsules around {kind.words}."
    yield from missing_mesh_notes(geometry)


def excitation_page(project: ExcitationProject, design: Design, files: Sequence[tuple[str, str]] = ()) -> str:
    """Return the design as one HTML page; ``files`` are the names of what was written, each with its use."""
    first_step = _SLOWLY if any(name.startswith(f"{TRIAL}.") for name, _ in files) else NO_TRIAL
    steps = PageTable.of(("file", "what it holds"), (), files, files=[name for name, _ in files]), (first_step, *_STEPS)
    findings, view = tuple(excitation_findings(project, design)), arm_view(project, design)
    told = findings if view is None else Beside((view,), (findings,), "left")
    sections = [
        PageSection("What it will tell", (design_facts(design), told)),
        *[PageSection("What to do with it", steps)] * bool(files),
        scene_section(project, design),
        PageSection("Motion and torque", (limit_use_table(design), _gallery(design))),
        expected_section(design),
        PageSection("Limits", tuple(_limit_blocks(design))),
        PageSection("Settings and versions", tuple(_settings_tables(project))),
    ]
    return render(f"A motion for {design.model.name}", excitation_heading(design), sections)


def excitation_heading(design: Design) -> str:
    """Return one sentence on what the motion is."""
    duration, other_duration = (number(trajectory.duration, 3) for trajectory in (design.trajectory, design.validation))
    return f"{design.request.program.words}, {duration} s, and another of {other_duration} s for validation."


def motions_of(design: Design) -> Mapping[str, Trajectory]:
    """Return both motions by name."""
    return dict(zip(MOTIONS, (design.trajectory, design.validation), strict=True))


def limit_use_table(design: Design) -> PageTable:
    """Return how much of each limit the motions use, as found by their last check."""
    columns = [(head, f"{name}, % of the limit") for name in MOTIONS for head in QUANTITIES]
    shares = np.concatenate([check.reached for check in design.checks])  # (10, n)
    cells = [[number(round(100 * share, 4), 3) for share in row] for row in shares.T.tolist()]
    rows = ((joint, *row) for joint, row in zip(design.limits.joints, cells, strict=True))
    title = "How much of the limits is used, the margin taken off; of the range, from its middle"
    return PageTable.of(("joint",), columns, rows, title)


def _gallery(design: Design) -> Gallery:
    views, limits = [], design.limits
    maxima = [limits.velocity, limits.acceleration, limits.jerk, limits.torque]
    bounds = np.array([(limits.lower, limits.upper), *((-maximum, maximum) for maximum in maxima)])  # (5, 2, n)
    for name, trajectory in motions_of(design).items():
        t = trajectory.times(min(DRAWING_RATE, MAX_DRAWN_SAMPLES / trajectory.duration))
        states = trajectory.states(t)
        torque = design.model.torque(states[0], states[1], states[2], design.theta)
        for k, joint in enumerate(design.model.joints):
            caption = f"Joint {joint.name}: the {name} between its limits (dashed), and the torque that it needs."
            figure = design_figure(t, _quantity_titles(joint), np.stack([*states, torque])[:, :, k], bounds[:, :, k])
            views.append(((name, joint.name), (Figure(figure, caption),)))
    return Gallery(("Motion", "Joint"), tuple(views))


def _quantity_titles(joint: Joint) -> tuple[str, ...]:
    unit, effort = joint.unit, f"{'force' if joint.effort == 'N' else 'torque'}, {joint.effort}"
    return (f"position, {unit}", f"velocity, {unit}/s", f"acceleration, {unit}/s²", f"jerk, {unit}/s³", effort)


def _limit_blocks(design: Design) -> Iterator[PageBlock]:
    """Yield the limits of the joints, with those set by a rule marked, and how they were checked."""
    limits, names, rows = design.limits, tuple(JointLimits.model_fields), []
    for k, joint in enumerate(limits.joints):
        by_rule = limits.by_rule.get(joint, ())
        # A rule for the position sets both ends of the range
        ruled = [name in by_rule or (name in ("lower", "upper") and "position" in by_rule) for name in names]
        values = [number(float(getattr(limits, name)[k])) for name in names]
        marked = (f"{value} *" if rule else value for value, rule in zip(values, ruled, strict=True))
        rows.append((joint, design.model.joints[k].unit, *marked))
    yield PageTable.of(
        ("joint",), (UNIT, *names), rows, "Limits that the motion keeps to, the margin taken off (* by rule)"
    )
    samples = max(check.samples for check in design.checks)
    yield (
        "Between the points of a grid they hold by bounds. Both finished motions were then checked by other code, at "
        f"{samples} times, 1 kHz and finer; the torque by {' and '.join(design.checks[0].routes)}."
    )


def _settings_tables(project: ExcitationProject) -> Iterator[PageBlock]:
    settings = project.settings.model_dump(mode="json").items()
    given = ((key.replace("_", " "), setting_text(value)) for key, value in settings if value not in (None, [], {}))
    yield pair_table("setting", [("robot", project.path.name), *given])
    yield pair_table("program", list(versions().items()))
