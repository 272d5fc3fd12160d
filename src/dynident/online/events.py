"""What there is to say of a robot that is watched, as data: changes, faults of sensors, and how the watch stands."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from dynident.regression import GroupKind

__all__ = [
    "Alarm", "Back", "BadLines", "BaselineKnown", "Changed", "ClockReset", "Event", "Fault", "FaultKind", "Gap",
    "NewMotion", "Passed", "Resting", "Resumed", "Signal", "Unreadable", "Unsteady",
]  # fmt: skip


@dataclass(frozen=True)
class Event:
    """Something to say; ``time`` (s) is the stamp of the last sample that it rests on."""

    time: float


@dataclass(frozen=True)
class BaselineKnown(Event):
    """The baseline, ``since`` a time (s), is complete: changes are sought from now on.

    ``residual`` (n) is the torque (N m, N) that the model leaves in it, root mean square, ``identified`` (n) what it
    left of the data of the fit.
    """

    since: float
    residual: tuple[float, ...]
    identified: tuple[float, ...]


@dataclass(frozen=True)
class Unsteady(Event):
    """A group has changed within the baseline, whose first half, ``since`` a time (s), is left out: it goes on."""

    kind: GroupKind
    joint: str
    since: float


@dataclass(frozen=True)
class NewMotion(Event):
    """``since`` a time (s) the robot moves as it has not in the baseline: this is learned, changes are not sought."""

    since: float


@dataclass(frozen=True)
class Alarm(Event):
    """Something has changed, most likely this group, ``since`` about a time (s), ``between`` two (95 %).

    ``evidence`` is minus the logarithm of the probability of the data without a change, for one test.
    """

    kind: GroupKind
    joint: str
    since: float
    between: tuple[float, float]
    evidence: float


@dataclass(frozen=True)
class Changed(Event):
    """A group has changed ``since`` a time (s) by ``size`` (k) +- ``std`` (k) in the directions ``names`` (k).

    ``std`` is infinite where the motion does not show a direction. ``total`` (k) is the change since the baseline.
    Sizes are in ``units`` (k); of a residual logarithms of the root mean square.
    """

    kind: GroupKind
    joint: str
    since: float
    between: tuple[float, float]
    names: tuple[str, ...]
    units: tuple[str, ...]
    size: tuple[float, ...]
    std: tuple[float, ...]
    total: tuple[float, ...]
    evidence: float


@dataclass(frozen=True)
class Passed(Event):
    """What an alarm was for, ``since`` a time (s), is not there any more: a disturbance, or a false alarm."""

    kind: GroupKind
    joint: str
    since: float


@dataclass(frozen=True)
class Resting(Event):
    """The robot has hardly moved ``since`` a time (s): there is nothing to watch until it does."""

    since: float


class Signal(StrEnum):
    """What of a joint a sensor measures."""

    POSITION = "position"
    TORQUE = "torque"


class FaultKind(StrEnum):
    """How a sensor fails: no number, a value that froze while the joint moved, a value that does not change while
    others do, a jump that no joint can make."""

    MISSING = "missing"
    FROZEN = "frozen"
    STILL = "still"
    JUMP = "jump"


@dataclass(frozen=True)
class Fault(Event):
    """A sensor fails ``since`` a time (s); ``size`` is that of a jump (rad, m)."""

    kind: FaultKind
    signal: Signal
    joint: str
    since: float
    size: float = 0.0


@dataclass(frozen=True)
class Back(Event):
    """A sensor that failed ``since`` a time (s) works again."""

    signal: Signal
    joint: str
    since: float


@dataclass(frozen=True)
class Gap(Event):
    """No sample came for ``length`` s up to the time."""

    length: float


@dataclass(frozen=True)
class ClockReset(Event):
    """The stamps began anew, after ``last`` (s)."""

    last: float


@dataclass(frozen=True)
class BadLines(Event):
    """``count`` lines could not be read, the first of them number ``line``, with the ``text``."""

    count: int
    line: int
    text: str


@dataclass(frozen=True)
class Unreadable(Event):
    """``samples`` from a time on could not be smoothed, for a ``reason``."""

    samples: int
    reason: str


@dataclass(frozen=True)
class Resumed(Event):
    """The watch goes on from a saved state, of which the last sample was at ``last`` (s)."""

    last: float
