"""A finding on a log, a robot file or both: severity, place, what is wrong and what to do."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

from dynident.errors import InputError, Note, Severity

__all__ = ["Finding", "Topic", "require"]


class Topic(StrEnum):
    """What a finding is about: a stable name for programs."""

    ABOUT_ORIGIN = "about origin"
    BASE_TILT = "base tilt"
    CONDITION = "condition"
    COPIED = "copied"
    DEAD = "dead"
    DEGREES = "degrees"
    EFFORT_LIMIT = "effort limit"
    FAR = "far"
    FOREIGN = "foreign"
    GAP = "gap"
    GRAVITY = "gravity"
    IMPOSSIBLE = "impossible"
    JITTER = "jitter"
    LIMITS = "limits"
    LOST = "lost"
    MASSLESS = "massless"
    MOTION = "motion"
    NOT_EXCITED = "not excited"
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
    TIME_OFFSET = "time offset"
    TOTAL_MASS = "total mass"
    UNREAD = "unread"
    UNUSABLE = "unusable"
    VELOCITY_LIMIT = "velocity limit"


@dataclass(frozen=True)
class Finding:
    """One finding: ``severity``, the ``joint`` it concerns (None: all of them), and a message with the remedy.

    ``message`` is a sentence, or a note with the figures, which ``report`` puts into words. ``topic`` groups findings
    of the same kind, None where there is no group; ``source`` is the log or file and ``link`` the link concerned, each
    empty where there is none.
    """

    severity: Severity
    joint: str | None
    message: str | Note
    topic: Topic | None = None
    source: str = ""
    link: str = ""

    def __str__(self) -> str:
        return f"{self.message}" if self.joint is None else f"joint {self.joint!r}: {self.message}"


def require(findings: Iterable[Finding], source: str) -> None:
    """Raise InputError that lists every finding that is an error, one per line; do nothing where there is none."""
    errors = [str(finding) for finding in findings if finding.severity is Severity.ERROR]
    if errors:
        raise InputError(f"{source}: " + "\n  ".join(errors))
