"""What findings are about, and findings on reading a log as text."""

from __future__ import annotations

from collections.abc import Iterable
from enum import StrEnum

from dynident.checks.reading import reading_words
from dynident.errors import Finding, InputError, Note, Severity

__all__ = ["Finding", "Topic", "reading_line", "require"]


class Topic(StrEnum):
    """What a finding is about: a stable name for programs."""

    ABOUT_ORIGIN = "about origin"
    AXIS = "axis"
    BASE_TILT = "base tilt"
    CLIPPED = "clipped"
    CLOCK = "clock"
    COMPENSATED = "gravity compensated"
    CONDITION = "condition"
    COPIED = "copied"
    DEAD = "dead"
    DEGREES = "degrees"
    EFFORT_LIMIT = "effort limit"
    FAR = "far"
    FLOATING = "floating"
    FOREIGN = "foreign"
    FROZEN = "frozen position"
    FROZEN_TORQUE = "frozen torque"
    FRICTION = "friction"
    GAIN = "gain"
    GAP = "gap"
    GRAVITY = "gravity"
    IMPOSSIBLE = "impossible"
    INTERPOLATED = "interpolated"
    JITTER = "jitter"
    JUMP = "jump"
    LEFT_OUT = "left out"
    LENGTH = "length"
    LIMBS = "limbs"
    LIMITS = "limits"
    LOOP = "loop"
    LOST = "lost"
    MANY_OUTLIERS = "many outliers"
    MASSLESS = "massless"
    MILLIMETRES = "millimetres"
    MISSING_TERM = "missing term"
    MOTION = "motion"
    NOT_EXCITED = "not excited"
    ODD_LOG = "odd log"
    PAYLOAD = "payload"
    POINT = "point"
    POSITION_LIMIT = "position limit"
    POSITION_SPIKES = "position spikes"
    QUANTISED = "quantised"
    RADIANS = "radians"
    REPEAT = "repeat"
    REST = "rest"
    REVERSALS = "reversals"
    SAMPLES = "samples"
    SCALE = "scale"
    SHAPES = "shapes"
    SIGN = "sign"
    SLOW = "slow"
    SPREAD = "spread"
    STALE = "stale"
    STAMPS = "stamps"
    STILL = "still"
    SWAPPED = "swapped"
    TIME_OFFSET = "time offset"
    TIME_UNIT = "time unit"
    TORQUE_SPIKES = "torque spikes"
    TOTAL_MASS = "total mass"
    UNEXPLAINED = "unexplained"
    UNREAD = "unread"
    UNUSABLE = "unusable"
    VELOCITY_LIMIT = "velocity limit"
    WRAPPED = "wrapped"
    ZERO = "zero"


def reading_line(finding: Finding) -> str:
    """Return as text what was found in reading a log, with the joint; TypeError for what only ``report`` words."""
    said = reading_words(finding.message) if isinstance(finding.message, Note) else finding.message
    return said if finding.joint is None else f"joint {finding.joint!r}: {said}"


def require(findings: Iterable[Finding], source: str) -> None:
    """Raise InputError that lists every finding that is an error, one per line; do nothing where there is none."""
    errors = [reading_line(finding) for finding in findings if finding.severity is Severity.ERROR]
    if errors:
        raise InputError(f"{source}: " + "\n  ".join(errors))
