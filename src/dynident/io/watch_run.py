"""A robot watched by a stream: from bytes to events, with the state saved so that a killed watch goes on.

State and events lie in one folder and are replaced together: what was said and what was read agree, whatever stops the
watch. A file is then read on from where its state ends, so that no sample is lost or counted twice. Standard input
cannot be read again: samples between the last save and the end are missing, which the watch says as a gap, and samples
that come again are left out.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from dynident.errors import ConfigError, InputError
from dynident.identification import Identification
from dynident.io.config import parse_config
from dynident.io.folder import ResultFolder
from dynident.io.followed import FollowedFile, StandardInput, Stream
from dynident.io.opener import content
from dynident.io.stream import LineReader, SampleReader
from dynident.io.watch_state import read_state, state_bytes
from dynident.online import Event, Resumed, Watcher, WatchSettings

__all__ = ["EVENTS", "STATE", "Watch", "event_data", "watch_of"]

STATE, EVENTS = "watch.npz", "changes.jsonl"
SAVE = 10.0  # s between two states at most, where nothing is said
SEED = 0  # of the threshold


@dataclass
class Watch:
    """A watcher with its stream, and the ``folder`` that keeps its state, where there is one.

    ``key`` is what state and watch must have in common: the result and the settings. ``events`` are all so far.
    """

    watcher: Watcher
    reader: SampleReader
    source: str
    key: Mapping[str, Any]
    folder: ResultFolder | None = None
    events: list[Event] = field(default_factory=list)
    lines: LineReader = field(default_factory=LineReader)

    def run(self, *, follow: bool, pause: float = 0.5, wait: Callable[[float], None] = time.sleep) -> Iterator[Event]:
        """Yield events as they come, until the stream ends; with ``follow``, wait for more at the end of a file.

        What is yielded is saved before. Raises InputError where the stream cannot be read.
        """
        stream, begun = self._begin()
        whole = True  # else a signal came in the midst of samples, which are read again
        try:
            self._save(stream, begun)
            saved = time.monotonic()
            yield from begun
            while True:
                data, fresh, ended = stream.read()
                if fresh:
                    self._next_file()
                whole = False
                events = self._taken(self.lines.push(data))
                if ended and self.lines.tail:  # the last line has no end
                    events += self._taken(self.lines.push(b"\n"))
                whole = True
                if events or time.monotonic() - saved > SAVE:
                    self._save(stream, events)
                    saved = time.monotonic()
                yield from events
                if ended or (not data and not follow):
                    return
                if not data:
                    wait(pause)
        finally:
            if whole:
                self._save(stream, [])
            stream.close()

    def _begin(self) -> tuple[Stream, list[Event]]:
        """Open the stream where a saved state ends, else at its beginning."""
        path = None if self.folder is None else self.folder.path / STATE
        if path is None or not path.is_file():
            return self._opened(None), []
        state = read_state(path)
        if state.get("key") != self.key:
            raise ConfigError(
                f"{path}: is of a watch with another result or other settings; delete it, or choose another --out."
            )
        self.watcher.restore(state["watcher"])
        self.reader.restore(state["reader"])
        self.events = list(state["events"])
        stream = self._opened(state["position"])
        if not isinstance(stream, FollowedFile) or not stream.found:
            self.watcher.resume_by_replay()
        return stream, [Resumed(self.watcher.latest, self.watcher.latest)]

    def _opened(self, position: Mapping[str, Any] | None) -> Stream:
        return StandardInput() if self.source == "-" else FollowedFile(Path(self.source), position)

    def _next_file(self) -> None:
        """Go on with another file: a line of the last one without its end is lost."""
        self.lines.tail = b""
        self.reader.new_file()

    def _taken(self, lines: list[str]) -> list[Event]:
        if not lines:
            return []
        samples = self.reader.push(lines)
        events = list(self.watcher.push(samples.t, samples.q, samples.tau))
        if samples.bad is not None:
            events.append(replace(samples.bad, time=self.watcher.latest))
        return events

    def _save(self, stream: Stream, events: list[Event]) -> None:
        self.events += events
        if self.folder is None:
            return
        state = {
            "key": self.key, "watcher": self.watcher.state, "reader": self.reader.state, "events": self.events,
            "position": stream.position(len(self.lines.tail)),
        }  # fmt: skip
        said = "".join(f"{json.dumps({'id': k} | event_data(one))}\n" for k, one in enumerate(self.events, 1))
        self.folder.replace({STATE: state_bytes(state), EVENTS: said})


def watch_of(
    found: Identification,
    result: Path,
    source: str,
    settings: WatchSettings,
    folder: ResultFolder | None = None,
    *,
    allow_code: bool = False,
) -> Watch:
    """Return the watch of a robot by its result, read from the file ``result``, and the stream ``source``, a file or
    "-". Raises InputError for a result without a configuration, ConfigError where stream or settings do not fit it."""
    given = found.provenance.configuration
    if given is None:
        raise InputError(
            "the result was made from Python, without a configuration: push its samples to a Watcher from Python, too."
        )
    config = parse_config(given.text, Path(given.path).parent, given.path, allow_code=allow_code)
    name = "standard input" if source == "-" else source
    reader = SampleReader(config, found.model.joints, name)
    digest = sha256(content(result)).hexdigest()
    key = {"result": digest, **{one.name: getattr(settings, one.name) for one in fields(settings)}}
    return Watch(Watcher(found, np.random.default_rng(SEED), settings), reader, source, key, folder)


def event_data(event: Event) -> dict[str, Any]:
    """Return an event in types of JSON, with its ``event`` name; what is not finite becomes null."""
    return {"event": type(event).__name__} | {one.name: _plain(getattr(event, one.name)) for one in fields(event)}


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_plain(one) for one in value]
    if isinstance(value, StrEnum):
        return value.value
    return None if isinstance(value, float) and not math.isfinite(value) else value
