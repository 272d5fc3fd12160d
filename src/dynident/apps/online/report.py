"""Sentences on the events of a robot that is watched."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime

import numpy as np

from dynident.apps.online.detector import (
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
)
from dynident.apps.online.event_log import EventLog
from dynident.apps.online.watcher import Watcher, WatchSettings
from dynident.regression import GroupKind
from dynident.report.figures import CLOCK_RANGE
from dynident.report.words import Line, kind_words, signed_text
from dynident.runtime import Severity, join_names, number

FAULTS = {
    FaultKind.MISSING: "gives no number",
    FaultKind.FROZEN: "does not change any more",
    FaultKind.STILL: "does not change while others do",
    FaultKind.JUMP: "jumps",
}
MIN_SURE_RATIO, MAX_LISTED = 2.0, 4  # standard errors from which on a part of a change is named, and how many are
# times the residual of the fit that are pointed out, and that ask for a reason
MIN_NOTABLE_RATIO, MIN_SUSPICIOUS_RATIO = 2.0, 10.0

# sentences of events by their fields, with stamps and groups in words; the others have functions below
TEXTS: Mapping[type[Event], str] = {
    Unsteady: "{group} changed within the baseline since {since}; its first half is left out, and it goes on",
    NewMotion: (
        "the robot moves as it did not in the baseline since {since}: this motion is learned, and a change now would "
        "not be seen"
    ),
    Alarm: "a change since about {since}, most likely {group}; its size is being measured",
    Passed: "the change since {since} ({group}) has passed",
    Back: "the {signal} of {joint} works again, after a fault since {since}",
    Resting: "the robot has hardly moved since {since}: there is nothing to watch until it does",
    ClockReset: "the time was set back, from {last}",
    Resumed: "the watch goes on from its saved state, after the sample at {last}",
}


def stamp_text(t: float, zero: float = float("nan")) -> str:
    """Return a stamp (s) in seconds, or as a date (UTC) where the stream has dates.

    Dates count from the midnight ``zero`` (s), or from 1970.
    """
    if np.isnan(t):
        return "the start"
    since_1970 = t if np.isnan(zero) else zero + t
    if not CLOCK_RANGE[0] < since_1970 < CLOCK_RANGE[1]:
        return f"{t:.1f} s"
    return datetime.fromtimestamp(since_1970, UTC).strftime("%Y-%m-%d %H:%M:%S")


def event_line(event: Event, joints: Sequence[str], zero: float = float("nan")) -> Line:
    """Return an event as a line, a warning where something changed or fails; ``zero`` as in ``stamp_text``."""
    serious = isinstance(event, Alarm | Changed | Fault | Unsteady | Unreadable)
    when = "at the start" if np.isnan(event.time) else stamp_text(event.time, zero)
    text = f"{when}: {_event_text(event, joints, zero)}."
    return Line(text, Severity.WARNING if serious else Severity.INFO)


def watch_words(settings: WatchSettings) -> str:
    """Return how a robot is watched, as a sentence."""
    often = 1 / settings.false_alarms
    rate = f"one in {number(often, 2)} days" if often > 1 else f"{number(settings.false_alarms, 2)} a day"
    return (
        f"Watching: a baseline of {settings.baseline:g} s of motion without a change first, then changes with at most "
        f"{rate} by chance, in blocks of {settings.block:g} s."
    )


def end_words(watcher: Watcher, events: EventLog, zero: float = float("nan")) -> str:
    """Return how far the watch has come at the end of a stream, as a sentence."""
    if np.isnan(watcher.latest):
        return "The stream has ended without a sample."
    end, (block_count, needed) = f"The stream has ended at {stamp_text(watcher.latest, zero)}", watcher.baseline_blocks
    if block_count < needed:
        return (
            f"{end}, within the baseline: it has {block_count} of {needed} blocks of motion, too few to find changes. "
            "With --baseline S it is shorter."
        )
    changes = {0: "no change was found", 1: "1 change was found"}.get(
        events.changes, f"{events.changes} changes were found"
    )
    since = watcher.latest if np.isnan(events.baseline) else events.baseline
    return f"{end}: {changes} since {stamp_text(since, zero)}, when the baseline was complete."


def _event_text(event: Event, joints: Sequence[str], zero: float) -> str:
    if isinstance(event, Gap):
        return f"no sample came for {number(event.length, 3)} s"
    if isinstance(event, Unreadable):
        return f"{event.samples} samples cannot be used: {event.reason.rstrip('.')}"
    if isinstance(event, BadLines):
        if event.count == 1:
            return f"line {event.line} could not be read and is left out: {event.text!r}"
        return (
            f"{event.count} lines could not be read and are left out, the first is line {event.line}: {event.text!r}, "
            f"the last line {event.last}"
        )
    if isinstance(event, BaselineKnown):
        return _baseline_text(event, joints, zero)
    if isinstance(event, Changed):
        return _change_text(event, zero)
    if isinstance(event, Fault):
        return _fault_text(event, zero)
    if isinstance(event, Resumed) and np.isnan(event.last):
        return "the watch goes on from its saved state, which has no sample yet"
    values = dict(vars(event))
    values |= {name: stamp_text(values[name], zero) for name in ("since", "last") if name in values}
    if "kind" in values:
        values["group"] = kind_words(values["kind"], values["joint"])
    return TEXTS[type(event)].format(**values)


def _baseline_text(event: BaselineKnown, joints: Sequence[str], zero: float) -> str:
    pairs = list(zip(joints, event.residual, event.identified, strict=True))
    residuals = join_names((f"{joint} {number(now, 2)}" for joint, now, _ in pairs), 8)
    worse = [joint for joint, now, then in pairs if now > MIN_NOTABLE_RATIO * then]
    warning = f"; more than twice that of the identification at {join_names(worse, 8)}" if worse else ""
    if any(now > MIN_SUSPICIOUS_RATIO * then for _, now, then in pairs):
        warning += "; at one, more than ten times: check that robot, units and gains are those of the result"
    return (
        f"the baseline since {stamp_text(event.since, zero)} is complete, changes are detected from now on; "
        f"the model leaves (rms, N m or N) {residuals}{warning}"
    )


def _change_text(event: Changed, zero: float) -> str:
    low, high = (stamp_text(t, zero) for t in event.between)
    when = f"at about {stamp_text(event.since, zero)}" if low == high else f"between {low} and {high}"
    return f"{kind_words(event.kind, event.joint)} changed {when}: {join_names(_size_words(event), MAX_LISTED)}"


def _size_words(event: Changed) -> Iterator[str]:
    """Yield the significant parts of a change, the clearest first; at least one."""
    if event.kind is GroupKind.RESIDUAL:
        yield f"{100 * (float(np.exp(event.size[0])) - 1):+.0f} %"
        return
    size, std = np.array(event.size), np.array(event.std)
    ratio = np.divide(np.abs(size), std, out=np.zeros_like(size), where=np.isfinite(std) & (std > 0))
    order = [int(k) for k in np.argsort(-ratio, kind="stable")]
    for k in [k for k in order if ratio[k] >= MIN_SURE_RATIO] or order[:1]:
        total = "" if np.isclose(event.total[k], size[k]) else f" ({signed_text(event.total[k])} since the baseline)"
        yield f"{event.names[k]} by {signed_text(size[k])} +- {number(float(std[k]), 2)} {event.units[k]}{total}"


def _fault_text(event: Fault, zero: float) -> str:
    fault = f"the {event.signal.value} of {event.joint} {FAULTS[event.kind]}"
    since = stamp_text(event.since, zero)
    if event.kind is FaultKind.JUMP:
        return f"{fault} at {since}, by {signed_text(event.size)} rad or m, which no joint can do"
    if event.kind is FaultKind.STILL:
        why = "the torques are not those of a rest, its sensor is dead; nothing is watched until it moves"
        return f"{fault}, since {since}: {why}"
    stops = "nothing is" if event.signal is Signal.POSITION else "this joint's torque is not"
    return f"{fault}, since {since}: its sensor is dead; {stops} watched until it works again"
