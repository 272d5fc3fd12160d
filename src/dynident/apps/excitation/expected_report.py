"""What a designed motion is expected to tell of each base parameter, what stays open, and what to look at before."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from dynident.apps.excitation.clearance import CapsuleSpace
from dynident.apps.excitation.design import Design, ExpectedAccuracy, expected_accuracy
from dynident.apps.excitation.limits import LIMITS_FILE, usual_arm
from dynident.apps.excitation.motion import Program
from dynident.apps.excitation.robot import ExcitationProject
from dynident.checks import check_robot
from dynident.checks.file_notes import FarCentre, ImpossibleInertia, NoMass
from dynident.models import Floor, RigidBodies, ShapeSource
from dynident.regression import UnexcitedParameters
from dynident.report import Array, Drawing
from dynident.report.figures import AMBER, BLUE, GREEN, PALE, RED, Trace, curve, mark_rows, panels, plain, trace
from dynident.report.page import Facts, Figure, Fold, PageBlock, PageSection, PageTable, formula_blocks, short_formula
from dynident.runtime import count, install_command, join_names, number

MAX_JOINTS, MAX_FILES = 8, 3  # joints, and files, in a sentence
DOUBTFUL_LINKS = (ImpossibleInertia, NoMass, FarCentre)
PACKAGED = "package://"
LOWEST_POINT_RATE, MAX_LOWEST_POINT_SAMPLES = 50.0, 5000  # Hz and samples of the lowest point

CURVE_POINTS = 1500  # of a curve
RANGE_MARGIN = 0.08  # share of a range above and below it

WELL, FAIR = 10.0, 30.0  # %, of the value: standard errors of what is known well, and fairly
RATES = {"velocity": "/s", "acceleration": "/s^2", "jerk": "/s^3"}  # of the unit of a position
DURATION_FACTOR = 4.0  # times the duration
MIN_RELATIVE_VALUE = 1e-9  # of the largest value
MAX_LISTED = 6  # parameters in a sentence
OPTIMISED_PROGRAMS = (Program.MOTION, Program.ALL)
_ERRORS_NOTE = (
    "Standard errors of the base parameters, the combinations that act on the torque each in its own way, from the "
    "information of the motion: the regressor along it, weighted by the noise of the torques. They hold for the model "
    "with which the motion was designed, at the values that it was designed with, and for positions known well; what "
    "the model lacks comes on top."
)


def floor_words(project: ExcitationProject, design: Design) -> Iterator[str]:
    """Yield how low the arm reaches, where no floor is given."""
    space = design.space
    if not isinstance(space, CapsuleSpace) or any(isinstance(shape, Floor) for shape in project.obstacles):
        return
    t = design.trajectory.times(min(LOWEST_POINT_RATE, MAX_LOWEST_POINT_SAMPLES / design.trajectory.duration))
    placements = space.bodies.placements(design.trajectory.states(t)[0])
    moving = [shape for shape in space.capsules if shape.body >= 0]
    if not moving:
        return
    body, radii = [shape.body for shape in moving], np.array([shape.radius for shape in moving])
    # A capsule is lowest at one of its ends, below it by the radius
    ends = (placements.points(body, np.array([getattr(shape, end) for shape in moving])) for end in ("start", "end"))
    low = float(min((points[..., 2] - radii).min() for points in ends))
    where = f"{-low:.2f} m below" if low < 0 else f"{low:.2f} m above"
    yield (
        f"No floor is given: the arm reaches down to {where} the origin of its root link. Where it stands on "
        "something, give `floor: 0` (its height in m), and `boxes` and `cylinders` for what else is near."
    )


def body_words(project: ExcitationProject) -> Iterator[str]:
    """Yield a warning where the torque is that of a robot file whose masses or inertias cannot be right."""
    if project.prior.identification is not None:
        return
    for bodies in (term for term in project.prior.model.terms if isinstance(term, RigidBodies)):
        findings = check_robot(bodies.file, [joint.name for joint in bodies.joints])
        if links := dict.fromkeys(
            finding.link for finding in findings if isinstance(finding.message, DOUBTFUL_LINKS) and finding.link
        ):
            yield (
                f"Torques are by the robot file, where mass or inertia of {join_names(links, MAX_JOINTS)} cannot be "
                "right: see `dynident check` of it. Do not rely on the torque limits until it is corrected."
            )


def shape_words(project: ExcitationProject) -> Iterator[str]:
    """Yield which shapes of links are unknown, and where capsules alone were checked."""
    geometry = project.geometry
    if geometry is None:
        yield "The model is not made of a robot file: nothing keeps the arm clear of itself."
        return
    if unknown := [geometry.link(body) for body, kind in geometry.sources.items() if kind is ShapeSource.JOINTS]:
        missing = (f"{file}: {reason.rstrip('.')}" for file, reason in geometry.missing.items())
        files = f" ({join_names(missing, MAX_FILES)})" if geometry.missing else ""
        packaged = any(file.startswith(PACKAGED) for file in geometry.missing)
        hint = ", or name the folder of their package (`packages`, `--package`)" if packaged else ""
        yield (
            f"The shapes of {join_names(unknown, MAX_JOINTS)} are not known{files}: distances are from the lines "
            f"between their joints, with a thickness by rule. Look whether they are as thick{hint}."
        )
    standing = {obstacle.name for obstacle in project.obstacles}
    unwatched = project.space.left_out if isinstance(project.space, CapsuleSpace) else ()
    for link, neighbour in unwatched:
        if neighbour in standing:
            yield f"{link} is at {neighbour} in every pose, as what is mounted there: this pair is not watched."
    if links := [f"{link} and {neighbour}" for link, neighbour in unwatched if neighbour not in standing]:
        pairs = join_names(links, MAX_JOINTS)
        yield f"Not watched, because they are close to each other in nearly every pose: {pairs}."
    if project.space.pairs and project.shapes is None:
        yield (
            "Distances are those of capsules around the links; the last check also looks at their real shapes where "
            f"Pinocchio is installed: {install_command('pin')}."
        )


def noise_words(project: ExcitationProject) -> Iterator[str]:
    """Yield which noise of the torques was assumed, and why recordings do not count that could."""
    sigma = project.request.sigma
    sizes = (f"{name} {number(float(x), 2)}" for name, x in zip(project.limits.joints, sigma, strict=True))
    origin = f"{join_names(sizes, MAX_JOINTS)}; {project.origin.words}"
    yield f"Noise of the torques at {project.request.rate:g} Hz (N m or N): {origin}."
    if project.prior.loss_reason:
        yield f"What was recorded before does not count: {project.prior.loss_reason}."


def limit_words(design: Design) -> Iterator[str]:
    """Yield which limits neither the robot file nor the user gives, and which exceed those of the file."""
    # Group the limits by quantity: what holds for all joints is said once
    by_quantity: dict[str, list[str]] = {}
    for joint, names in design.limits.by_rule.items():
        for name in names:
            by_quantity.setdefault(name, []).append(joint)
    for name, joints in by_quantity.items():
        is_all = len(joints) == len(design.limits.joints)
        whose = "all joints" if is_all else join_names(joints, MAX_JOINTS)
        if name == "torque":
            yield f"The torque of {whose} has no limit: it was not looked at."
            continue
        k = design.limits.joints.index(joints[0])
        size = number(float(getattr(design.limits, name)[k]), 3) if name in RATES else ""
        example = f" (at {joints[0]} {size} {design.model.joints[k].unit}{RATES[name]})" if size else ""
        yield f"Limits of {name} of {whose} are by rule{example}: give your robot's own, if they are known."
    if arm := usual_arm(design.model, design.limits):
        kinds = " and ".join(next(iter(arm.limits.values())))
        yield (
            f"The joints are those of a {arm.name}, whose usual limits of {kinds} are public ({arm.source}). They are "
            f"used where you say so: --settings {LIMITS_FILE}, which is written beside the motion."
        )
    for joint, names in design.limits.beyond.items():
        yield f"The limits that are given for {joint} exceed those of the robot file: {', '.join(names)}."


def excitation_findings(project: ExcitationProject, design: Design) -> list[str]:
    """Return plain sentences: what the motion will tell, what stays open, what was assumed, and the notes."""
    return [*expected_findings(design), *noise_words(project), *room_findings(project, design)]


def room_findings(project: ExcitationProject, design: Design) -> list[str]:
    """Return what to look at before the arm moves: what was assumed of its room, shapes and limits, and the notes."""
    notes = (str(note) for note in design.notes if not isinstance(note, UnexcitedParameters))  # a table has these
    around = (
        *((str(project.gripper),) if project.gripper else ()),
        *body_words(project),
        *shape_words(project),
        *floor_words(project, design),
    )
    return [*around, *limit_words(design), *notes]


def design_figure(t: Array, titles: Sequence[str], values: Array, limits: Array) -> Drawing:
    """Draw quantities of a joint (Q, N) over time t (N), one panel each, between their limits (Q, 2), infinite where
    there is none."""
    figure = panels(titles, 60 + 150 * len(titles))
    for row, (title, quantity, bounds) in enumerate(zip(titles, values, limits.tolist(), strict=True), start=1):
        figure.add(curve(t, quantity, title.partition(",")[0], {"color": BLUE, "width": 1.4}, CURVE_POINTS), row=row)
        for limit in filter(np.isfinite, bounds):
            figure.add(_limit_line(t, limit, "limit"), row=row)
        # The panel holds the curve and its finite limits, with a margin
        ends = [x for x in (*bounds, float(quantity.min()), float(quantity.max())) if np.isfinite(x)]
        room = RANGE_MARGIN * (max(ends) - min(ends) or 1.0)
        axis = figure.layout[f"yaxis{row}" if row > 1 else "yaxis"]
        axis["range"] = [min(ends) - room, max(ends) + room]
    figure.layout.update(showlegend=False, margin={"t": 15})
    return figure


def _limit_line(t: Array, value: float, name: str) -> Trace:
    ends, line = [float(t[0]), float(t[-1])], {"color": RED, "width": 1.2, "dash": "dash"}
    return trace("scatter", x=ends, y=[value, value], mode="lines", name=name, line=line, hoverinfo="skip")


def distance_figure(t: Array, distance: Array, clearance: float) -> Drawing:
    """Draw the smallest distance (N) of all pairs over time t (N), and the clearance that is kept."""
    figure = panels(["distance, m"], 260)
    figure.add(curve(t, distance, "smallest distance", {"color": BLUE, "width": 1.4}, 2000))
    figure.add(_limit_line(t, clearance, "clearance"))
    figure.axes("y", rangemode="tozero")
    figure.layout.update(showlegend=False, margin={"t": 15})
    return figure


def expected_figure(labels: Sequence[str], percent: Array, mark: float, before: Array | None = None) -> Drawing:
    """Draw the expected standard error of each parameter in % of its value on a logarithmic axis.

    A line stands at ``mark``; ``before`` are the errors known before. What is infinite is left out.
    """
    labels = [plain(label) for label in labels]
    figure = panels([""], 120 + 20 * len(labels), shared=False)
    ends, line = [-0.5, len(labels) - 0.5], {"color": PALE, "width": 1.0, "dash": "dot"}
    look = {"mode": "lines", "line": line, "hoverinfo": "skip", "showlegend": False}
    figure.add(trace("scatter", x=[mark, mark], y=ends, **look))
    series = [(percent, "with this motion", GREEN, "circle")]
    series += [] if before is None else [(before, "known before", AMBER, "circle-open")]
    mark_rows(figure, labels, series, "expected standard error, % of the value")
    figure.layout.update(showlegend=before is not None)
    return figure


def expected_findings(design: Design) -> Iterator[str]:
    """Yield sentences on what the motion will tell, what it adds to what is known, and what stays open."""
    info = design.expected
    if not np.isfinite(info.std).any():
        yield "The motion tells nothing: it shows no base parameter."
        return
    shares = info.relative[has_value(info)]
    if len(shares):
        yield (
            f"The torque depends on {count(len(info.std), 'combination')} of masses, inertias and friction (base "
            f"parameters), {len(shares)} of them with a nominal value. Of these {_grades(shares)}, by one standard "
            "error."
        )
        # The standard error falls with the root of the duration
        longer = shares / np.sqrt(DURATION_FACTOR)
        yield (
            f"Errors fall with the root of the time: moving {DURATION_FACTOR:g} times as long would halve them, and "
            f"{_grades(longer)}."
        )
        worst = int(np.where(has_value(info) & np.isfinite(info.std), info.relative, -1.0).argmax())
        if np.isfinite(info.std[worst]):
            unit = design.model.parameters[info.basis.independent[worst]].unit
            yield (
                f"The least known is {short_formula(info.basis.groupings[worst])}: "
                f"{number(float(info.value[worst]), 3)} +- {number(float(info.std[worst]), 2)} {unit}; what is poorly "
                "known hardly acts on the torque of this motion."
            )
    if unsized := len(info.std) - len(shares):
        yield (
            f"The other {unsized}, such as friction, have no nominal value in the robot file: their standard errors "
            "are given in their units."
        )
    if (prior_info := _known_before(design)) is not None:
        yield from _gain_sentences(info, prior_info)
    if info.open_parameters:
        stay = "stays" if len(info.open_parameters) == 1 else "stay"
        hint = (
            ""
            if design.request.program in OPTIMISED_PROGRAMS
            else "; the optimised motion shows more (`--program motion`, `all`)"
        )
        names = join_names(info.open_parameters, MAX_LISTED)
        yield f"{count(len(info.open_parameters), 'base parameter')} {stay} open: {names}{hint}."


def _grades(shares: Array) -> str:
    """Return how many are known well, fairly and poorly, by their standard errors in %."""
    good, poor = int((shares <= WELL).sum()), int((~(shares <= FAIR)).sum())
    fair = len(shares) - good - poor
    return f"{good} will be known well (to {WELL:g} %), {fair} fairly (to {FAIR:g} %) and {poor} poorly"


def has_value(info: ExpectedAccuracy) -> NDArray[np.bool_]:
    """Tell which base parameters (r) have a value above rounding, of which their errors are a share."""
    # A value far below the largest one is a rounding error of zero
    size = np.abs(info.value)
    return np.asarray(size > MIN_RELATIVE_VALUE * size.max(initial=0.0))


def _gain_sentences(info: ExpectedAccuracy, prior_info: ExpectedAccuracy) -> Iterator[str]:
    # Only parameters that were known before have a gain
    finite = np.isfinite(prior_info.std) & np.isfinite(info.std)
    if finite.any():
        ratio = prior_info.std[finite] / info.std[finite]
        best = int(np.flatnonzero(finite)[ratio.argmax()])
        yield (
            "Together with what was recorded before, standard errors are smaller than now by a factor of "
            f"{number(float(np.median(ratio)), 2)} in the median, at most {number(float(ratio.max()), 3)} "
            f"({short_formula(info.basis.groupings[best])})."
        )
    if new := int((~np.isfinite(prior_info.std) & np.isfinite(info.std)).sum()):
        yield f"{count(new, 'base parameter')} that are open now will be known."


def _known_before(design: Design) -> ExpectedAccuracy | None:
    """Return the accuracy before the motion, None where nothing is known."""
    prior = design.request.prior
    return None if prior is None else expected_accuracy(design.model, design.theta, prior, design.expected.basis)


def design_facts(design: Design) -> Facts:
    """Return the few numbers to see first: the duration, how much will be known, and how near the arm comes."""
    # Parameters whose nominal value is zero have no relative error
    shares = design.expected.relative[has_value(design.expected)]
    finite = shares[np.isfinite(shares)]
    facts: list[tuple[str, ...]] = [
        (f"{number(design.trajectory.duration, 3)} s", "duration, with approach and return"),
        (
            f"{int((shares <= WELL).sum())} of {len(shares)}",
            f"base parameters with a nominal value that will be known to {WELL:g} %",
        ),
        (f"{number(float(np.median(finite)), 2)} %" if len(finite) else "-", "median of the expected standard errors"),
    ]
    if nearest := design.checks[0].nearest:
        facts.append((f"{number(1e3 * nearest.distance, 3)} mm", "smallest distance", " and ".join(nearest.pair)))
    return Facts(tuple(facts))


def expected_section(design: Design) -> PageSection:
    """Return the section of the expected standard errors: table, figure, and what no motion can show."""
    info, prior_info = design.expected, _known_before(design)
    rows = np.flatnonzero(has_value(info))
    labels = [short_formula(info.basis.groupings[k]) for k in rows.tolist()]
    caption = (
        f"Expected standard error of the base parameters that have a value, in % of it; the line is at {WELL:g} %."
    )
    prior_errors = None if prior_info is None else prior_info.relative[rows]
    blocks: list[PageBlock] = [_ERRORS_NOTE]
    if len(rows):
        blocks.append(Figure(expected_figure(labels, info.relative[rows], WELL, prior_errors), caption))
    table = Fold("All numbers", (_expected_table(info, prior_info),))
    return PageSection(
        "Expected standard errors",
        (*blocks, *_open_blocks(design), table, *formula_blocks(info.basis.groupings), *_no_effect_sentences(info)),
    )


def _expected_table(info: ExpectedAccuracy, prior_info: ExpectedAccuracy | None) -> PageTable:
    heads = ("value", "expected standard error", "%", *(() if prior_info is None else ("now, %",)))
    valued = has_value(info)
    rows = []
    for k in range(len(info.std)):
        cells = [short_formula(info.basis.groupings[k]), number(float(info.value[k])) if valued[k] else "-"]
        cells.append(number(float(info.std[k]), 2) if np.isfinite(info.std[k]) else "open")
        shares = (info.relative[k], *(() if prior_info is None else (prior_info.relative[k],)))
        rows.append((*cells, *(number(float(share), 2) if valued[k] else "-" for share in shares)))
    title = f"Base parameters; log det of the information {number(info.log_det)}, condition {number(info.condition, 3)}"
    return PageTable.of(("base parameter",), heads, rows, title)


def _open_blocks(design: Design) -> Iterator[PageBlock]:
    """Yield what stays open, with the motion that would show it."""
    rows = []
    for note in (entry for entry in design.notes if isinstance(entry, UnexcitedParameters)):
        rows += [(short_formula(name), f"it takes motion of {note.motion}") for name in note.groupings]
    if rows:
        yield PageTable.of(("base parameter", "why"), (), rows, "What stays open, and why")


def _no_effect_sentences(info: ExpectedAccuracy) -> Iterator[PageBlock]:
    """Yield what no motion of the robot shows."""
    if none := info.basis.without_effect:
        yield f"No motion shows {', '.join(none)}: they have no effect on the torque of this robot."
    if tied := len(info.basis.dependent) - len(none):
        yield f"{count(tied, 'more parameter')} can be known, by whatever motion, only within the combinations above."
