"""The report of a designed motion: what it will tell, the motion and its limits, the arm along its path, what to do."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dynident.excitation import Program, Trajectory
from dynident.identification import versions
from dynident.regression import UnexcitedParameters
from dynident.report import figures
from dynident.report.excitation_expected import WELL, expected_section, told, valued_of
from dynident.report.excitation_scene import scene_section
from dynident.report.excitation_words import body_words, floor_words, limit_words, noise_words, shape_words
from dynident.report.page import (
    UNIT,
    Column,
    Facts,
    Figure,
    Gallery,
    PageBlock,
    PageSection,
    PageTable,
    number,
    pairs,
    relative,
    render,
)
from dynident.report.part_words import value_words
from dynident.report.wording import words

if TYPE_CHECKING:
    from dynident.excitation import Design
    from dynident.io.excitation import ExcitationProject

__all__ = [
    "MOTIONS",
    "NO_TRIAL",
    "SLOWER",
    "TRIAL",
    "excitation_findings",
    "excitation_heading",
    "excitation_page",
    "excitation_tables",
    "motions_of",
]

Array = NDArray[np.float64]
RATE, MOST = 250.0, 20_000  # Hz and samples of what is drawn
POINTS = 1500  # of a curve
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
PROGRAMS = {
    Program.MOTION: "An optimised motion",
    Program.FRICTION: "Each joint at constant speeds",
    Program.GRAVITY: "Poses for gravity",
    Program.ALL: "An optimised motion, constant speeds and poses for gravity",
}


def excitation_findings(project: ExcitationProject, found: Design) -> list[str]:
    """Return in plain sentences what the motion will tell, what stays open, what was assumed, and the notes."""
    notes = (words(one) for one in found.notes if not isinstance(one, UnexcitedParameters))  # a table has these
    around = (*body_words(project), *shape_words(project), *floor_words(project, found))
    return [*told(found), *around, *noise_words(project), *limit_words(found), *notes]


def excitation_tables(found: Design) -> list[PageTable]:
    """Return for a terminal how much of the limits both motions use."""
    return [_used_table(found)]


def excitation_page(project: ExcitationProject, found: Design, files: Sequence[tuple[str, str]] = ()) -> str:
    """Return the design as one HTML page; ``files`` are the names of what was written, each with its use."""
    first = _SLOWLY if any(name.startswith(f"{TRIAL}.") for name, _ in files) else NO_TRIAL
    steps = _files(files), (first, *_STEPS)
    sections = [
        PageSection("What it will tell", (_facts(found), tuple(excitation_findings(project, found)))),
        *([PageSection("What to do with it", steps)] if files else []),
        scene_section(project, found),
        PageSection("Motion and torque", (_used_table(found), _gallery(found))),
        expected_section(found),
        PageSection("Limits", tuple(_limits(found))),
        PageSection("Settings and versions", tuple(_settings(project))),
    ]
    return render(f"A motion for {found.model.name}", excitation_heading(found), sections)


def excitation_heading(found: Design) -> str:
    """Return what the motion is, in a sentence."""
    first, second = (number(one.duration, 3) for one in (found.trajectory, found.validation))
    return f"{PROGRAMS[found.request.program]}, {first} s, and another of {second} s for validation."


def _files(files: Sequence[tuple[str, str]]) -> PageTable:
    """Return the table of the files, with links to them."""
    columns = (Column("file", numeric=False), Column("what it holds", numeric=False))
    return PageTable(columns, tuple(files), links=tuple(relative(name) for name, _ in files))


def _facts(found: Design) -> Facts:
    shares = found.expected.relative[valued_of(found.expected)]
    known = shares[np.isfinite(shares)]
    facts: list[tuple[str, ...]] = [
        (f"{number(found.trajectory.duration, 3)} s", "the motion, with its ways"),
        (
            f"{int((shares <= WELL).sum())} of {len(shares)}",
            f"base parameters with a nominal value that will be known to {WELL:g} %",
        ),
        (f"{number(float(np.median(known)), 2)} %" if len(known) else "-", "median of the expected standard errors"),
    ]
    if near := found.checked[0].nearest:
        facts.append((f"{number(1e3 * near.distance, 3)} mm", "smallest distance", " and ".join(near.pair)))
    return Facts(tuple(facts))


def motions_of(found: Design) -> Mapping[str, Trajectory]:
    """Return both motions by name."""
    return dict(zip(MOTIONS, (found.trajectory, found.validation), strict=True))


def times(trajectory: Trajectory) -> Array:
    """Return the times (s) at which a trajectory is drawn."""
    return trajectory.times(min(RATE, MOST / trajectory.duration))


def _used_table(found: Design) -> PageTable:
    """Return how much of each limit the motions use, as their last check has found."""
    heads = ("position", "velocity", "acceleration", "jerk", "torque")
    columns = [Column("joint", numeric=False)]
    columns += [Column(head, f"{name}, % of the limit") for name in MOTIONS for head in heads]
    shares = np.concatenate([one.reached for one in found.checked])  # (10, n)
    cells = [[number(round(100 * share, 4), 3) for share in row] for row in shares.T.tolist()]
    rows = tuple((joint, *row) for joint, row in zip(found.limits.joints, cells, strict=True))
    title = "How much of the limits is used, the margin taken off; of the range, from its middle"
    return PageTable(tuple(columns), rows, title)


def _torque(found: Design, states: Array) -> Array:
    q, dq, ddq = states[:3]
    return found.model.torque(q, dq, ddq, found.theta)


def _gallery(found: Design) -> Gallery:
    views = []
    for name, trajectory in motions_of(found).items():
        t = times(trajectory)
        states = trajectory.states(t)
        torque = _torque(found, states)
        for k, joint in enumerate(found.model.joints):
            caption = f"Joint {joint.name}: the {name} between its limits (dashed), and the torque that it needs."
            figure = figures.designed_figure(t, list(_quantities(found, k, [*states, torque])), POINTS)
            views.append(((name, joint.name), (Figure(figure, caption),)))
    return Gallery(("Motion", "Joint"), tuple(views))


def _quantities(found: Design, k: int, states: Sequence[Array]) -> Iterator[figures.Quantity]:
    joint, limits = found.model.joints[k], found.limits
    unit = joint.unit
    titles = (f"position, {unit}", f"velocity, {unit}/s", f"acceleration, {unit}/s²", f"jerk, {unit}/s³")
    efforts = f"{'force' if joint.effort == 'N' else 'torque'}, {joint.effort}"
    most = [limits.velocity[k], limits.acceleration[k], limits.jerk[k], limits.torque[k]]
    ends = [(limits.lower[k], limits.upper[k]), *((-one, one) for one in most)]
    for title, values, (lower, upper) in zip((*titles, efforts), states, ends, strict=True):
        yield figures.Quantity(title, values[:, k], float(lower), float(upper))


def _limits(found: Design) -> Iterator[PageBlock]:
    """Yield the limits of the joints, with those made by a rule marked, and what they rest on."""
    limits = found.limits
    names = ("lower", "upper", "velocity", "acceleration", "jerk", "torque")
    rows = []
    for k, joint in enumerate(limits.joints):
        made = limits.by_rule.get(joint, ())
        ruled = [name in made or (name in ("lower", "upper") and "position" in made) for name in names]
        values = [number(float(getattr(limits, name)[k])) for name in names]
        marked = (f"{value} *" if rule else value for value, rule in zip(values, ruled, strict=True))
        rows.append((joint, found.model.joints[k].unit, *marked))
    columns = (Column("joint", numeric=False), UNIT, *map(Column, names))
    yield PageTable(columns, tuple(rows), "Limits that the motion keeps to, the margin taken off (* by rule)")
    samples = max(one.samples for one in found.checked)
    yield (
        "Between the points of a grid they hold by bounds. Both finished motions were then checked by other code, at "
        f"{samples} times, 1 kHz and finer; the torque by {' and '.join(found.checked[0].routes)}."
    )


def _given(settings: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield the settings that say something."""
    for key, value in settings.items():
        if value is not None and value not in ([], {}):
            yield key.replace("_", " "), value_words(value)


def _settings(project: ExcitationProject) -> Iterator[PageBlock]:
    given = project.settings.model_dump(mode="json")
    yield pairs("setting", [("robot", project.path.name), *_given(given)])
    yield pairs("program", list(versions().items()))
