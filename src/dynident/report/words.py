"""What the parts of an identification's report share: its logs by role, counts in words, and how fine curves are."""

from __future__ import annotations

from math import inf
from typing import TYPE_CHECKING

from dynident.errors import listed
from dynident.report import figures
from dynident.report.page import number

if TYPE_CHECKING:
    from dynident.identification import Identification
    from dynident.validation import LogValidation

__all__ = [
    "ROLES",
    "count",
    "cut",
    "day",
    "huge",
    "label_of",
    "labelled",
    "listed",
    "logs_of",
    "motion_known",
    "percent",
    "points",
    "rough",
    "short",
    "tiny",
]

ROLES = {"train": "training", "validation": "held out"}
ROUNDING = 1e-12
CURVES = 11  # of a log and joint: torques, motion, free simulation


def logs_of(identification: Identification, role: str) -> list[LogValidation]:
    """Return the logs of a role, "train" or "validation"."""
    return [log for log in identification.validations if log.role == role]


def motion_known(identification: Identification) -> str:
    """Say whether the standard errors count the errors of the motion, and what they do not count."""
    if identification.estimate.information is not None:
        return "They count the errors of the motion, too."
    if identification.errors.std_hac is not None:
        return (
            "They count the noise left in the motion, but not what the model lacks: the true uncertainty is larger "
            "where the torque error is larger than the noise."
        )
    return (
        "They take the motion as exactly known: the true uncertainty is larger, especially where the torque error is "
        "large."
    )


def labelled(identification: Identification) -> list[tuple[str, int]]:
    """Return the logs as a reader chooses among them: a label, and the index in ``logs``; those held out come first."""
    logs = identification.validations
    order = sorted(range(len(logs)), key=lambda k: logs[k].role == "train")
    return [(label_of(logs[k]), k) for k in order]


def label_of(log: LogValidation) -> str:
    """Return a log as a reader chooses it."""
    return f"{log.name} ({ROLES.get(log.role, log.role)})"


def count(number_of: int, noun: str) -> str:
    """Word a count, such as "1 log" or "2 logs"."""
    return f"{number_of} {noun}{'' if number_of == 1 else 's'}"


def day(stamp: str) -> str:
    """Word a time that is given in ISO 8601, such as "2026-11-22 14:05 UTC"; "" stays."""
    return f"{stamp[:10]} {stamp[11:16]} UTC" if stamp else ""


def percent(value: float, digits: int = 3) -> str:
    """Word a share (%) to so many significant digits: never "1e+02 %" for 100 %, as a format of two digits has it."""
    return f"{short(value, digits)} %"


def rough(value: float) -> str:
    """Word a share (%) to two digits, and from 10 % on to whole ones."""
    return percent(value, 2) if value < 10 else f"{value:.0f} %"


def cut(text: str, longest: int | None) -> str:
    """Return a text without the words beyond so many signs."""
    return text if longest is None or len(text) <= longest else f"{text[:longest].rsplit(' ', 1)[0]} …"


def short(value: float, digits: int = 3) -> str:
    """Word a number to ``digits`` significant digits: never 190 as "1.9e+02", and 0.5 without zeros at its end."""
    shown = f"{value:.{digits}g}"
    return number(value, digits) if "e" in shown else shown


def tiny(value: float, digits: int = 2) -> str:
    """Word a number, of which what is no more than rounding is not told."""
    return f"below {ROUNDING:g}" if 0 < abs(value) < ROUNDING else number(value, digits)


def huge(value: float, digits: int = 2) -> str:
    """Word a ratio, of which what rounding makes of infinity is not told."""
    return f"above {1 / ROUNDING:g}" if 1 / ROUNDING < value < inf else number(value, digits)


def points(identification: Identification) -> int:
    """Return the points of each curve such that the page stays small."""
    return figures.share(CURVES * len(identification.validations) * len(identification.model.joints))
