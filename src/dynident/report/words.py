"""What the parts of an identification's report share: its logs by role, numbers as text, and points per curve."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from math import inf
from typing import NamedTuple

from dynident.identification import Identification
from dynident.identification.links import DeterminedBy
from dynident.models import Joint
from dynident.motion.smoothers import strip_time_offset
from dynident.report.figures import AMBER, BLUE, GREEN, VIOLET, points_per_curve
from dynident.report.page import Figure, Gallery
from dynident.runtime import Note, Severity, angles, join_names, number, part_text, short
from dynident.validation import LogValidation

ROLES = {"train": "training", "validation": "held out"}
ROUNDING = 1e-12
CURVES_PER_JOINT = 11  # of a log and joint: torques, motion, free simulation


class Source(NamedTuple):
    """How a source of values is called: its ``name``, the ``state`` of a parameter, and in a legend its ``colour`` and
    ``key`` with a ``meaning``."""

    name: str
    state: str
    colour: str
    key: str
    meaning: str


SOURCES = {
    DeterminedBy.DATA: Source("the data", "data", GREEN, "well determined", "by the data alone"),
    DeterminedBy.COMBINATION: Source(
        "the data, with other links", "in combination", BLUE, "by combination",
        "the data determine only sums with other links",
    ),
    DeterminedBy.PRIOR: Source(
        "the prior", "prior", "#7d8ea6", "by the file or prior",  # calm: of a link it is usual
        "the data determine only sums, which the file or prior splits; this is usual for a good model",
    ),
    DeterminedBy.BOUND: Source("a bound", "at a bound", VIOLET, "at a bound", "held by a physical constraint"),
    DeterminedBy.NOTHING: Source(
        "nothing", "not identifiable", AMBER, "not identified", "neither by data nor by a prior"
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Line:
    """A line of text for a terminal, and its severity."""

    text: str
    severity: Severity = Severity.INFO


def note_lines(notes: Iterable[Note]) -> list[Line]:
    """Return notes as lines for a terminal, each with its severity in front and a full stop at its end."""
    texts = ((note, str(note)) for note in notes)
    return [
        Line(f"{note.severity.prefix}{text}{'' if text.endswith(('.', '?')) else '.'}", note.severity)
        for note, text in texts
    ]


def motion_known(identification: Identification) -> str:
    """Return whether the standard errors count the errors of the motion, and what they do not count, as sentences."""
    if identification.estimate.information is not None:
        return "They count the errors of the motion, too."
    if identification.errors.allows_correlation:
        return (
            "They count the noise left in the motion, but not what the model lacks: the true uncertainty is larger "
            "where the torque error is larger than the noise."
        )
    return (
        "They take the motion as exactly known: the true uncertainty is larger, especially where the torque error is "
        "large."
    )


def labelled_logs(identification: Identification) -> list[tuple[str, LogValidation]]:
    """Return the logs as a reader chooses among them, each with its label; held-out ones come first."""
    return [(label_of(log), log) for log in sorted(identification.validations, key=lambda log: log.role == "train")]


def label_of(log: LogValidation) -> str:
    """Return the label of a log: its name and role."""
    return f"{log.name} ({ROLES.get(log.role, log.role)})"


def day(stamp: str) -> str:
    """Word a time that is given in ISO 8601, such as "2026-11-22 14:05 UTC"; "" stays."""
    return f"{stamp[:10]} {stamp[11:16]} UTC" if stamp else ""


def tiny(value: float, digits: int = 2) -> str:
    """Format a number; one that is no more than rounding is given as below it."""
    return f"below {ROUNDING:g}" if 0 < abs(value) < ROUNDING else number(value, digits)


def huge(value: float) -> str:
    """Format a ratio; one that rounding makes of infinity is given as above a limit."""
    return f"above {1 / ROUNDING:g}" if 1 / ROUNDING < value < inf else number(value, 2)


def figure_gallery(
    identification: Identification, draw: Callable[[LogValidation, Joint], Figure | None]
) -> tuple[Gallery, ...]:
    """Return a gallery of what ``draw`` makes of each log and joint, each tied to its run; none where it makes none."""
    views = [
        ((label, joint.name), (replace(figure, figure=figure.figure.follow_run(label)),))
        for label, log in labelled_logs(identification)
        for joint in identification.model.joints
        if (figure := draw(log, joint)) is not None
    ]
    return (Gallery(("log", "joint"), tuple(views)),) if views else ()


def points(identification: Identification) -> int:
    """Return the number of points of each curve such that the page stays small."""
    return points_per_curve(CURVES_PER_JOINT * len(identification.validations) * len(identification.model.joints))


def signed_text(value: float) -> str:
    """Return the size of a change with its sign, in three digits."""
    return f"{'+' if value > 0 else ''}{number(float(value), 3)}"


def settings_of(identification: Identification) -> dict[str, str]:
    """Return the settings of a run as text: the recipe as used, and what was chosen and calibrated."""
    recipe, calibration = identification.recipe, identification.calibration
    tilt = recipe.base_tilt
    settings = {"estimator": part_text(recipe.estimator)}
    settings |= {"low-pass": part_text(recipe.filter)} if recipe.filter is not None else {}
    settings["seed of the random poses"] = str(identification.provenance.seed)
    settings["smoother used"] = "; ".join(part_text(strip_time_offset(smoother)) for smoother in recipe.smoothers)
    numbers = {
        "low speeds left out": _speed_text(recipe.min_speed),
        "time offset used": f"{short(1e3 * float(recipe.time_offset), 4)} ms" if recipe.time_offset else None,
        "base tilt used": angles(*tilt, 3) if isinstance(tilt, tuple) and any(tilt) else None,
        "free simulation": f"begun anew every {short(recipe.restart)} s" if recipe.restart else None,
    }
    choices = {
        "smoother": calibration.smoother,
        "time offset": calibration.time_offset,
        "base tilt": calibration.base_tilt,
        "strength of the prior": calibration.prior_strength,
    }
    settings |= {key: str(value) for key, value in numbers.items() if value is not None}
    return settings | {key: str(choice) for key, choice in choices.items() if choice is not None}


def _speed_text(speed: Mapping[str, float] | float | None) -> str | None:
    """Return the minimum speed, or that of each joint, in words."""
    if speed is None:
        return None
    if isinstance(speed, Mapping):
        return f"{join_names(f'{name} below {short(float(limit))}' for name, limit in speed.items())} rad/s or m/s"
    return f"below {short(float(speed))} rad/s or m/s"
