"""Events of a watch as lines of a file, of which a save writes only what is new."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from typing import Any

from dynident.apps.online.events import BadLines, BaselineKnown, Changed, Event
from dynident.files.folder import ResultFolder

EVENTS = "changes.jsonl"


@dataclass
class EventLog:
    """Counts events, and writes them to a folder; only the latest is kept.

    ``count`` is that of all events, ``changes`` that of the changes, ``baseline`` (s) when changes were first sought.
    ``events`` are the latest in the file, which may still grow, and those after it; ``position`` is the number of bytes
    of the file before them. Bad lines that follow each other are one event.
    """

    count: int = 0
    changes: int = 0
    baseline: float = math.nan
    position: int = 0
    events: tuple[Event, ...] = ()

    def add(self, event: Event) -> Event | None:
        """Take an event; return what is to be said, None for bad lines like those that were said."""
        latest = self.events[-1] if self.events else None
        if isinstance(event, BadLines) and isinstance(latest, BadLines) and event.line > latest.last:
            joined = replace(latest, time=event.time, count=latest.count + event.count, last=event.last)
            self.events = (*self.events[:-1], joined)
            # said again at ten times as many, so that a stream of bad lines does not flood who reads
            return joined if len(str(joined.count)) > len(str(latest.count)) else None
        self.events = (*self.events, event)
        self.count += 1
        self.changes += isinstance(event, Changed)
        self.baseline = event.time if isinstance(event, BaselineKnown) else self.baseline
        return event

    def write(self, folder: ResultFolder | None) -> None:
        """Write the events that are new to the folder, and the latest before them, which may have grown."""
        first = self.count - len(self.events) + 1
        lines = [json.dumps({"id": k} | event_data(event)) + "\n" for k, event in enumerate(self.events, first)]
        if folder is not None and lines:
            # what a killed watch wrote beyond its state is replaced: its samples are read again
            folder.write_from(EVENTS, self.position, "".join(lines))
        self.position += len("".join(lines[:-1]))  # of ASCII
        self.events = self.events[-1:]


def event_data(event: Event) -> dict[str, Any]:
    """Return an event in JSON types, with its ``event`` name; values that are not finite become null."""
    return {"event": type(event).__name__} | {name: _event_value(value) for name, value in vars(event).items()}


def _event_value(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_event_value(member) for member in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
