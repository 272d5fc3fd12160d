"""Events of a robot that is watched; each says itself."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from enum import StrEnum
from typing import ClassVar

import numpy as np

from dynident.regression import GroupKind
from dynident.report.words import signed_text
from dynident.runtime import Severity, Statement, WordedEnum, join_names, number

MIN_SURE_RATIO, MAX_LISTED = 2.0, 4  # standard errors from which on a part of a change is named, and how many are
# times the residual of the fit that are pointed out, and that ask for a reason
MIN_NOTABLE_RATIO, MIN_SUSPICIOUS_RATIO = 2.0, 10.0
StampWords = Callable[[float], str]  # puts a time (s) into words


class Event(Statement):
    """An event; ``time`` (s) is the stamp of the last sample that it is based on.

    ``sentence`` says it by its fields, with stamps in words, and kind and joint as a ``group``.
    """

    severity: ClassVar[Severity] = Severity.INFO
    sentence: ClassVar[str] = ""
    time: float

    def words(self, stamp: StampWords, joints: Sequence[str], /) -> str:  # noqa: ARG002
        """Return the event as a sentence about a robot with these ``joints``, without a full stop."""
        values = dict(vars(self))
        values |= {name: stamp(values[name]) for name in ("since", "last") if name in values}
        if "kind" in values:
            values["group"] = values["kind"].words.format(values["joint"])
        return self.sentence.format(**values)


class BaselineKnown(Event):
    """The baseline, ``since`` a time (s), is complete: changes are tested from now on.

    ``residual`` (n) is the torque (N m, N) that the model leaves in it, root mean square, ``identified`` (n)
    that of the data of the fit.
    """

    since: float
    residual: tuple[float, ...]
    identified: tuple[float, ...]

    def words(self, stamp: StampWords, joints: Sequence[str], /) -> str:
        """Return what the model leaves at each joint, and where that is much more than in the identification."""
        pairs = list(zip(joints, self.residual, self.identified, strict=True))
        residuals = join_names((f"{joint} {number(now, 2)}" for joint, now, _ in pairs), 8)
        worse = [joint for joint, now, then in pairs if now > MIN_NOTABLE_RATIO * then]
        warning = f"; more than twice that of the identification at {join_names(worse, 8)}" if worse else ""
        if any(now > MIN_SUSPICIOUS_RATIO * then for _, now, then in pairs):
            warning += "; at one, more than ten times: check that robot, units and gains are those of the result"
        return (
            f"the baseline since {stamp(self.since)} is complete, changes are detected from now on; "
            f"the model leaves (rms, N m or N) {residuals}{warning}"
        )


class Unsteady(Event):
    """A group has changed within the baseline, whose first half, ``since`` a time (s), is dropped: the baseline
    goes on.
    """

    severity = Severity.WARNING
    sentence = "{group} changed within the baseline since {since}; its first half is left out, and it goes on"
    kind: GroupKind
    joint: str
    since: float


class NewMotion(Event):
    """The robot moves ``since`` a time (s) as it has not in the baseline: this is learned, and no change is
    tested.
    """

    sentence = (
        "the robot moves as it did not in the baseline since {since}: this motion is learned, and a change now would "
        "not be seen"
    )
    since: float


class Alarm(Event):
    """Something has changed, most likely this group, ``since`` about a time (s), ``between`` two (95 %).

    ``evidence`` is minus the logarithm of the probability of the data without a change, for one test.
    """

    severity = Severity.WARNING
    sentence = "a change since about {since}, most likely {group}; its size is being measured"
    kind: GroupKind
    joint: str
    since: float
    between: tuple[float, float]
    evidence: float


class Changed(Event):
    """A group has changed ``since`` a time (s) by ``size`` (k) +- ``std`` (k) in the directions ``names`` (k).

    ``std`` is infinite where the motion does not show a direction. ``total`` (k) is the change since the
    baseline. Sizes are in ``units`` (k); those of a residual are logarithms of the root mean square.
    """

    severity = Severity.WARNING
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

    def words(self, stamp: StampWords, *_: object) -> str:
        """Return which group changed, when, and by how much."""
        low, high = map(stamp, self.between)
        when = f"at about {stamp(self.since)}" if low == high else f"between {low} and {high}"
        group = self.kind.words.format(self.joint)
        return f"{group} changed {when}: {join_names(self._size_words(), MAX_LISTED)}"

    def _size_words(self) -> Iterator[str]:
        """Yield the significant parts of the change, the clearest first; at least one."""
        if self.kind is GroupKind.RESIDUAL:
            yield f"{100 * (float(np.exp(self.size[0])) - 1):+.0f} %"
            return
        size, std = np.array(self.size), np.array(self.std)
        ratio = np.divide(np.abs(size), std, out=np.zeros_like(size), where=np.isfinite(std) & (std > 0))
        order = [int(k) for k in np.argsort(-ratio, kind="stable")]
        for k in [k for k in order if ratio[k] >= MIN_SURE_RATIO] or order[:1]:
            total = "" if np.isclose(self.total[k], size[k]) else f" ({signed_text(self.total[k])} since the baseline)"
            yield f"{self.names[k]} by {signed_text(size[k])} +- {number(float(std[k]), 2)} {self.units[k]}{total}"


class Passed(Event):
    """The cause of an alarm, ``since`` a time (s), is not there any more: a disturbance, or a false alarm."""

    sentence = "the change since {since} ({group}) has passed"
    kind: GroupKind
    joint: str
    since: float


class Resting(Event):
    """The robot has hardly moved ``since`` a time (s): there is nothing to watch until it does."""

    sentence = "the robot has hardly moved since {since}: there is nothing to watch until it does"
    since: float


class Signal(StrEnum):
    """Quantity of a joint that a sensor measures."""

    POSITION = "position"
    TORQUE = "torque"


class FaultKind(WordedEnum):
    """Kind of a sensor's fault.

    No number; a value that froze while the joint moved; a value that does not change while others do; a jump
    that no joint can make; such jumps again and again.
    """

    MISSING = "missing", "gives no number"
    FROZEN = "frozen", "does not change any more"
    STILL = "still", "does not change while others do"
    JUMP = "jump", "jumps"
    JUMPING = "jumping", "jumps again and again"


class Fault(Event):
    """A sensor fails ``since`` a time (s); ``size`` is that of a jump (rad, m)."""

    severity = Severity.WARNING
    kind: FaultKind
    signal: Signal
    joint: str
    since: float
    size: float = 0.0

    def words(self, stamp: StampWords, *_: object) -> str:
        """Return what a sensor does that it should not, and what is not watched because of it."""
        fault, since = f"the {self.signal.value} of {self.joint} {self.kind.words}", stamp(self.since)
        if self.kind is FaultKind.JUMP:
            return f"{fault} at {since}, by {signed_text(self.size)} rad or m, which no joint can do"
        if self.kind is FaultKind.JUMPING:
            return f"{fault}, since {since}: its sensor fails; nothing is watched until a minute without a jump"
        if self.kind is FaultKind.STILL:
            why = "the torques are not those of a rest, its sensor is dead; nothing is watched until it moves"
            return f"{fault}, since {since}: {why}"
        stops = "nothing is" if self.signal is Signal.POSITION else "this joint's torque is not"
        return f"{fault}, since {since}: its sensor is dead; {stops} watched until it works again"


class Back(Event):
    """A sensor that failed ``since`` a time (s) works again."""

    sentence = "the {signal} of {joint} works again, after a fault since {since}"
    signal: Signal
    joint: str
    since: float


class Gap(Event):
    """No sample came for ``length`` (s) up to the time."""

    length: float

    def words(self, *_: object) -> str:
        """Return the length of the gap."""
        return f"no sample came for {number(self.length, 3)} s"


class ClockReset(Event):
    """The stamps began anew, after ``last`` (s)."""

    sentence = "the time was set back, from {last}"
    last: float


class BadLines(Event):
    """``count`` lines could not be read, from number ``line``, with the ``text``, to number ``last``."""

    count: int
    line: int
    text: str
    last: int

    def words(self, *_: object) -> str:
        """Return which lines, with the text of the first."""
        if self.count == 1:
            return f"line {self.line} could not be read and is left out: {self.text!r}"
        return (
            f"{self.count} lines could not be read and are left out, the first is line {self.line}: {self.text!r}, "
            f"the last line {self.last}"
        )


class Unreadable(Event):
    """``samples`` from a time on could not be smoothed, for a ``reason``."""

    severity = Severity.WARNING
    samples: int
    reason: str

    def words(self, *_: object) -> str:
        """Return how many samples, and the reason."""
        return f"{self.samples} samples cannot be used: {self.reason.rstrip('.')}"


class Resumed(Event):
    """The watch goes on from a saved state, of which the last sample was at ``last`` (s)."""

    sentence = "the watch goes on from its saved state, after the sample at {last}"
    last: float

    def words(self, stamp: StampWords, joints: Sequence[str], /) -> str:
        """Return from where the watch goes on."""
        if np.isnan(self.last):
            return "the watch goes on from its saved state, which has no sample yet"
        return super().words(stamp, joints)
