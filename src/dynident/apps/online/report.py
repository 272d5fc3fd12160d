"""Sentences on the events of a robot that is watched."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from dynident.apps.online.event_log import EventLog
from dynident.apps.online.events import Event
from dynident.apps.online.watcher import Watcher, WatchSettings
from dynident.report.figures import clock
from dynident.report.words import Line
from dynident.runtime import number


def stamp_text(t: float, zero: float = float("nan")) -> str:
    """Return a stamp (s) in seconds, or as a date (UTC) where the stream has dates.

    Dates count from the midnight ``zero`` (s), or from 1970.
    """
    if np.isnan(t):
        return "the start"
    return clock(t if np.isnan(zero) else zero + t).removesuffix(" UTC") or f"{t:.1f} s"


def event_line(event: Event, joints: Sequence[str], zero: float = float("nan")) -> Line:
    """Return an event as a line, a warning where something changed or fails; ``zero`` as in ``stamp_text``."""
    when = "at the start" if np.isnan(event.time) else stamp_text(event.time, zero)
    return Line(f"{when}: {event.words(partial(stamp_text, zero=zero), joints)}.", event.severity)


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
