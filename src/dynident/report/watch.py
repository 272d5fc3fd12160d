"""What is said of a robot that is watched: one sentence for each event."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from datetime import UTC, datetime
from functools import singledispatch

import numpy as np

from dynident.errors import Severity, listed
from dynident.online import (
    Alarm,
    Back,
    BadLines,
    BaselineKnown,
    Changed,
    ClockReset,
    Event,
    Fault,
    FaultKind,
    Gap,
    NewMotion,
    Passed,
    Resting,
    Resumed,
    Signal,
    Unreadable,
    Unsteady,
    Watcher,
    WatchSettings,
)
from dynident.regression import GroupKind
from dynident.report.group_words import kind_words, signed
from dynident.report.page import number
from dynident.report.wording import Line

__all__ = ["Stamps", "end_words", "event_line", "watch_words"]

FAULTS = {
    FaultKind.MISSING: "gives no number",
    FaultKind.FROZEN: "does not change any more",
    FaultKind.STILL: "does not change while others do",
    FaultKind.JUMP: "jumps",
}
SURE, FEW = 2.0, 4  # standard errors from which on a part of a change is named, and how many are
MORE, MUCH = 2.0, 10.0  # times the residual of the fit that are pointed out, and that ask for a reason
DAY = 86_400.0


class Stamps:
    """How stamps are shown: in seconds, or where the stream has dates as such, from the midnight ``zero`` (s)."""

    def __init__(self, zero: float = float("nan")) -> None:
        self.zero = zero

    def __call__(self, t: float) -> str:
        """Word a stamp (s)."""
        if np.isnan(t):
            return "at the start"
        if np.isnan(self.zero):
            return f"{t:.1f} s"
        return datetime.fromtimestamp(self.zero + t, UTC).strftime("%Y-%m-%d %H:%M:%S")


def event_line(event: Event, joints: Sequence[str], stamps: Stamps) -> Line:
    """Return an event as a line, a warning where something changed or fails."""
    serious = isinstance(event, Alarm | Changed | Fault | Unsteady | Unreadable)
    text = f"{stamps(event.time)}: {_said(event, joints, stamps)}."
    return Line(text, Severity.WARNING if serious else Severity.INFO)


def watch_words(settings: WatchSettings) -> str:
    """Say how a robot is watched."""
    often = 1 / settings.false_alarms
    rate = f"one in {number(often, 2)} days" if often > 1 else f"{number(settings.false_alarms, 2)} a day"
    return (
        f"Watching: a baseline of {settings.baseline:g} s of motion without a change first, then changes with at most "
        f"{rate} by chance; each is sought for in blocks of {settings.block:g} s."
    )


def end_words(watcher: Watcher, events: Sequence[Event], stamps: Stamps) -> str:
    """Say at the end of a stream how far the watch has come."""
    if np.isnan(watcher.latest):
        return "The stream has ended without a sample."
    end, (there, need) = f"The stream has ended at {stamps(watcher.latest)}", watcher.baseline_blocks
    if there < need:
        return (
            f"{end}, within the baseline: it has {there} of {need} blocks of motion, and no change was sought. "
            "With --baseline S it is shorter."
        )
    since = max((one.time for one in events if isinstance(one, BaselineKnown)), default=watcher.latest)
    found = sum(isinstance(one, Changed) for one in events)
    changes = {0: "no change was found", 1: "1 change was found"}.get(found, f"{found} changes were found")
    return f"{end}: {changes} since {stamps(since)}, when the baseline was complete."


@singledispatch
def _said(event: Event, joints: Sequence[str], stamps: Stamps) -> str:  # noqa: ARG001
    raise TypeError(f"there is no text for {type(event).__name__}")


@_said.register
def _(event: BaselineKnown, joints: Sequence[str], stamps: Stamps) -> str:
    pairs = list(zip(joints, event.residual, event.identified, strict=True))
    left = listed((f"{joint} {number(now, 2)}" for joint, now, _ in pairs), 8)
    worse = [joint for joint, now, then in pairs if now > MORE * then]
    more = f"; more than twice that of the identification at {listed(worse, 8)}" if worse else ""
    if any(now > MUCH * then for _, now, then in pairs):
        more += "; at one, more than ten times: check that robot, units and gains are those of the result"
    return (
        f"the baseline since {stamps(event.since)} is complete, changes are sought from now on; "
        f"the model leaves (rms, N m or N) {left}{more}"
    )


@_said.register
def _(event: Unsteady, joints: Sequence[str], stamps: Stamps) -> str:  # noqa: ARG001
    return (
        f"{kind_words(event.kind, event.joint)} changed within the baseline since {stamps(event.since)}; its first "
        "half is left out, and it goes on"
    )


@_said.register
def _(event: NewMotion, joints: Sequence[str], stamps: Stamps) -> str:  # noqa: ARG001
    return (
        f"the robot moves as it did not in the baseline since {stamps(event.since)}: this motion is learned, and a "
        "change now would not be seen"
    )


@_said.register
def _(event: Alarm, joints: Sequence[str], stamps: Stamps) -> str:  # noqa: ARG001
    return (
        f"a change since about {stamps(event.since)}, most likely {kind_words(event.kind, event.joint)}; "
        "its size is being measured"
    )


@_said.register
def _(event: Changed, joints: Sequence[str], stamps: Stamps) -> str:  # noqa: ARG001
    low, high = event.between
    when = f"at about {stamps(event.since)}"
    if stamps(low) != stamps(high):
        when = f"between {stamps(low)} and {stamps(high)}"
    return f"{kind_words(event.kind, event.joint)} changed {when}: {listed(_sizes(event), FEW)}"


def _sizes(event: Changed) -> Iterator[str]:
    """Yield the parts of a change that are sure, the clearest first; at least one."""
    if event.kind is GroupKind.RESIDUAL:
        yield f"{100 * (float(np.exp(event.size[0])) - 1):+.0f} %"
        return
    size, std = np.array(event.size), np.array(event.std)
    ratio = np.divide(np.abs(size), std, out=np.zeros_like(size), where=np.isfinite(std) & (std > 0))
    order = [int(k) for k in np.argsort(-ratio, kind="stable")]
    for k in [k for k in order if ratio[k] >= SURE] or order[:1]:
        whole = "" if np.isclose(event.total[k], size[k]) else f" ({signed(event.total[k])} since the baseline)"
        yield f"{event.names[k]} by {signed(size[k])} +- {number(float(std[k]), 2)} {event.units[k]}{whole}"


@_said.register
def _(event: Passed, joints: Sequence[str], stamps: Stamps) -> str:  # noqa: ARG001
    return f"the change since {stamps(event.since)} ({kind_words(event.kind, event.joint)}) has passed"


@_said.register
def _(event: Fault, joints: Sequence[str], stamps: Stamps) -> str:  # noqa: ARG001
    one = f"the {event.signal.value} of {event.joint} {FAULTS[event.kind]}"
    if event.kind is FaultKind.JUMP:
        return f"{one} at {stamps(event.since)}, by {signed(event.size)} rad or m, which no joint can do"
    if event.kind is FaultKind.STILL:
        why = "the torques are not those of a rest, its sensor is dead; nothing is watched until it moves"
        return f"{one}, since {stamps(event.since)}: {why}"
    stops = "nothing is" if event.signal is Signal.POSITION else "this joint's torque is not"
    return f"{one}, since {stamps(event.since)}: its sensor is dead; {stops} watched until it works again"


@_said.register
def _(event: Back, joints: Sequence[str], stamps: Stamps) -> str:  # noqa: ARG001
    name = "position" if event.signal is Signal.POSITION else "torque"
    return f"the {name} of {event.joint} works again, after a fault since {stamps(event.since)}"


@_said.register
def _(event: Resting, joints: Sequence[str], stamps: Stamps) -> str:  # noqa: ARG001
    return f"the robot has hardly moved since {stamps(event.since)}: there is nothing to watch until it does"


@_said.register
def _(event: Gap, joints: Sequence[str], stamps: Stamps) -> str:  # noqa: ARG001
    return f"no sample came for {number(event.length, 3)} s"


@_said.register
def _(event: ClockReset, joints: Sequence[str], stamps: Stamps) -> str:  # noqa: ARG001
    return f"the time was set back, from {stamps(event.last)}"


@_said.register
def _(event: BadLines, joints: Sequence[str], stamps: Stamps) -> str:  # noqa: ARG001
    if event.count == 1:
        return f"line {event.line} could not be read and is left out: {event.text!r}"
    return f"{event.count} lines could not be read and are left out, the first is line {event.line}: {event.text!r}"


@_said.register
def _(event: Unreadable, joints: Sequence[str], stamps: Stamps) -> str:  # noqa: ARG001
    return f"{event.samples} samples cannot be used: {event.reason.rstrip('.')}"


@_said.register
def _(event: Resumed, joints: Sequence[str], stamps: Stamps) -> str:  # noqa: ARG001
    return f"the watch goes on from its saved state, after the sample at {stamps(event.last)}"
