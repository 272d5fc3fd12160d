"""A finding on a log, a robot file or both: severity, place, what is wrong and what to do."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from dynident.checks.reading import reading_words
from dynident.errors import InputError, Note, Severity

__all__ = ["Finding", "Topic", "reading_line", "require"]


class Topic(StrEnum):
    """What a finding is about: a stable name for programs."""

    ABOUT_ORIGIN = "about origin"
    AXIS = "axis"
    BASE_TILT = "base tilt"
    CONDITION = "condition"
    COPIED = "copied"
    DEAD = "dead"
    DEGREES = "degrees"
    EFFORT_LIMIT = "effort limit"
    FAR = "far"
    FOREIGN = "foreign"
    GAIN = "gain"
    GAP = "gap"
    GRAVITY = "gravity"
    IMPOSSIBLE = "impossible"
    JITTER = "jitter"
    LENGTH = "length"
    LIMITS = "limits"
    LOST = "lost"
    MASSLESS = "massless"
    MISSING_TERM = "missing term"
    MOTION = "motion"
    NOT_EXCITED = "not excited"
    PAYLOAD = "payload"
    POINT = "point"
    POSITION_LIMIT = "position limit"
    QUANTISED = "quantised"
    REST = "rest"
    REVERSALS = "reversals"
    SAMPLES = "samples"
    SATURATED = "saturated"
    SCALE = "scale"
    SHAPES = "shapes"
    SIGN = "sign"
    SPREAD = "spread"
    STALE = "stale"
    STAMPS = "stamps"
    STILL = "still"
    SWAPPED = "swapped"
    TIME_OFFSET = "time offset"
    TOTAL_MASS = "total mass"
    UNREAD = "unread"
    UNUSABLE = "unusable"
    VELOCITY_LIMIT = "velocity limit"
    ZERO = "zero"


@dataclass(frozen=True)
class Finding:
    """One finding: ``severity``, the ``joint`` it concerns (None: all of them), and what was found.

    ``message`` is a note with the figures, of ``checks/notes.py`` or of the stage that made it, which ``report`` puts
    into words with the remedy; it is a string where it comes from below, from reading a file or an error caught.
    ``topic`` groups findings of the same kind, None where there is no group; ``source`` is the log or file and ``link``
    the link concerned, each empty where there is none.
    """

    severity: Severity
    joint: str | None
    message: str | Note
    topic: Topic | None = None
    source: str = ""
    link: str = ""


def reading_line(finding: Finding) -> str:
    """Return as text what was found in reading a log, with the joint; TypeError for what only ``report`` words."""
    said = reading_words(finding.message) if isinstance(finding.message, Note) else finding.message
    return said if finding.joint is None else f"joint {finding.joint!r}: {said}"


def require(findings: Iterable[Finding], source: str) -> None:
    """Raise InputError that lists every finding that is an error, one per line; do nothing where there is none."""
    errors = [reading_line(finding) for finding in findings if finding.severity is Severity.ERROR]
    if errors:
        raise InputError(f"{source}: " + "\n  ".join(errors))
