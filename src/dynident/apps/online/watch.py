"""A watch of a robot: from the bytes of a stream to events, with a saved state to continue from.

State and events lie in one folder. Events are written first, and after a stop what follows those that the state
counts is written anew: reported events and read samples agree, whatever stops the watch. A file is then read on from
where its state ends, so that no sample is lost or counted twice. Standard input cannot be read again: samples between
the last save and the end are missing, which the watch reports as a gap, and repeated samples are left out.
"""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass, replace
from enum import StrEnum
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.apps.online import detector, event_log, events, fixed_lag, scores
from dynident.apps.online.event_log import EventLog
from dynident.apps.online.events import Event, Resumed
from dynident.apps.online.recorded import RecordedFile, is_recorded
from dynident.apps.online.stream import FollowedFile, LineReader, SampleReader, StandardInput
from dynident.apps.online.watcher import Watcher, WatchSettings
from dynident.files.arrays import open_npz
from dynident.files.folder import ResultFolder
from dynident.files.opener import afford, content, open_input
from dynident.project.saved import config_of_result, load
from dynident.regression import GroupKind
from dynident.runtime import ConfigError, InputError, report_progress

FORMAT, VERSION = "dynident watch", 4
# what a state may hold: the dataclasses and kinds of these files
STATE_TYPES = [
    member
    for module in (detector, event_log, events, fixed_lag, scores)
    for member in vars(module).values()
    if isinstance(member, type) and (member is GroupKind or member.__module__ == module.__name__)
]
DATACLASSES: Mapping[str, type] = {member.__name__: member for member in STATE_TYPES if is_dataclass(member)}
ENUMS: Mapping[str, type[StrEnum]] = {member.__name__: member for member in STATE_TYPES if issubclass(member, StrEnum)}

Stream = StandardInput | FollowedFile | RecordedFile
STATE = "watch.npz"
SAVE_INTERVAL = 10.0  # s between two states at most, where nothing is said
SEED = 0  # of the threshold


def state_bytes(state: Mapping[str, Any]) -> bytes:
    """Encode mappings, sequences, arrays, numbers, texts, dataclasses and kinds of a watch as a file."""
    arrays = list[NDArray[Any]]()
    text = json.dumps({"format": FORMAT, "version": VERSION, "state": _encode(state, arrays)})
    buffer = BytesIO()
    named_arrays = {f"array_{k}": array for k, array in enumerate(arrays)}
    np.savez(buffer, state=np.frombuffer(text.encode(), dtype=np.uint8), **named_arrays)  # type: ignore[arg-type]
    return buffer.getvalue()


def read_state(path: Path) -> dict[str, Any]:
    """Read a file of ``state_bytes``; InputError where it is something else, damaged, or of another version."""
    try:
        with open_input(path, remember=False) as file, open_npz(file) as members:
            arrays = dict[str, NDArray[Any]]()
            for name, member in members.items():
                if isinstance(member, str):
                    raise ValueError(f"{name} holds {member}")
                afford(member.cost, f"{path}: to read {name!r} would take")
                arrays[name] = member.read()
        data = json.loads(arrays.pop("state").tobytes())
        if data["format"] != FORMAT or data["version"] != VERSION:
            raise ValueError(f"it is of version {data['version']!r}, and this dynident reads {VERSION}")
        state: dict[str, Any] = _decode(data["state"], arrays)
        return state
    except InputError:
        raise
    except Exception as error:  # whatever a damaged archive leads to
        raise InputError(
            f"{path}: is no state of `dynident watch` that can be read ({error}); delete it, and the watch begins anew."
        ) from error


def _encode(value: Any, arrays: list[NDArray[Any]]) -> Any:
    """Return the value in JSON types; arrays are appended to ``arrays`` and referred to by index."""
    if isinstance(value, np.ndarray):
        arrays.append(value)
        return {"array": len(arrays) - 1}
    if isinstance(value, StrEnum):
        return {"kind": type(value).__name__, "value": value.value}
    if is_dataclass(value) and not isinstance(value, type):
        encoded_fields = {child.name: _encode(getattr(value, child.name), arrays) for child in fields(value)}
        return {"noun": type(value).__name__, "fields": encoded_fields}
    if isinstance(value, Mapping):
        return {"map": {str(key): _encode(child, arrays) for key, child in value.items()}}
    if isinstance(value, tuple | list):
        return [_encode(child, arrays) for child in value]
    if isinstance(value, np.generic):
        return _encode(value.item(), arrays)
    # JSON has neither infinity nor NaN
    if isinstance(value, float) and not math.isfinite(value):
        return {"float": str(value)}
    return value


def _decode(value: Any, arrays: Mapping[str, NDArray[Any]]) -> Any:
    """Invert ``_encode``; sequences become tuples."""
    if isinstance(value, Sequence) and not isinstance(value, str):
        return tuple(_decode(child, arrays) for child in value)
    if not isinstance(value, dict):
        return value
    if "array" in value:
        return arrays[f"array_{value['array']}"].copy()
    if "kind" in value:
        return ENUMS[value["kind"]](value["value"])
    if "noun" in value:
        return DATACLASSES[value["noun"]](**{name: _decode(child, arrays) for name, child in value["fields"].items()})
    if "float" in value:
        return float(value["float"])
    return {name: _decode(child, arrays) for name, child in value["map"].items()}


@dataclass
class Watch:
    """A watcher with its stream, and the ``folder`` that keeps its state, if any.

    ``key`` is what state and watch must have in common: the result and the settings.
    """

    watcher: Watcher
    reader: SampleReader
    source: str
    key: Mapping[str, Any]
    folder: ResultFolder | None = None
    events: EventLog = field(default_factory=EventLog)
    lines: LineReader = field(default_factory=LineReader)

    def run(self, *, follow: bool, pause: float = 0.5, wait: Callable[[float], None] = time.sleep) -> Iterator[Event]:
        """Yield events as they come, until the stream ends; with ``follow``, wait for more at the end of a file.

        Events are saved before they are yielded. Raises InputError where the stream cannot be read.
        """
        stream, first_events = self._open_and_restore()
        is_consistent = True  # else a signal came in the midst of samples, which are read again
        try:
            self._save(stream)
            saved = time.monotonic()
            yield from first_events
            while True:
                data, fresh, ended = stream.read()
                if fresh:  # an unfinished line of the last file is lost
                    self.lines = LineReader()
                    self.reader.new_file()
                # between push and save, watcher and stream position disagree: a state saved here would lose samples
                is_consistent = False
                events = self._process_lines(self.lines.push(data))
                if ended and self.lines.tail:  # the last line has no end
                    events += self._process_lines(self.lines.push(b"\n"))
                events = self._note(events)
                is_consistent = True
                # saved before the events are yielded, lest they be reported twice after a kill
                if events or time.monotonic() - saved > SAVE_INTERVAL:
                    self._save(stream)
                    saved = time.monotonic()
                yield from events
                if ended or (not data and not follow):
                    return
                if not data:
                    wait(pause)
        finally:
            if is_consistent:
                self._save(stream)
            stream.close()

    def _open_and_restore(self) -> tuple[Stream, list[Event]]:
        """Open the stream where a saved state ends, else at its beginning; restore that state."""
        path = None if self.folder is None else self.folder.path / STATE
        if path is None or not path.is_file():
            return self._open_stream(None), []
        state = read_state(path)
        # the thresholds depend on result and settings: a state of others would mislead
        if state.get("key") != self.key:
            raise ConfigError(
                f"{path}: is of a watch with another result or other settings; delete it, or choose another --out."
            )
        self.watcher.restore(state["watcher"])
        self.reader.restore(state["reader"])
        self.events = state["events"]
        stream = self._open_stream(state["position"])
        # the samples may come again: the watcher then skips those that it knows
        if stream.resumes:
            self.lines.skipping = state["skipping"]
        else:
            self.watcher.resume_by_replay()
        return stream, self._note([Resumed(self.watcher.latest, self.watcher.latest)])

    def _open_stream(self, position: Mapping[str, Any] | None) -> Stream:
        if self.source == "-":
            return StandardInput()
        path = Path(self.source)
        if is_recorded(self.source):
            return RecordedFile(path, self.reader.needed, self.reader.config.time.column, position, self.reader.scalars)
        return FollowedFile(path, position)

    def _process_lines(self, lines: list[str]) -> list[Event]:
        if not lines:
            return []
        samples = self.reader.push(lines)
        events = list(self.watcher.push(samples.t, samples.q, samples.tau))
        if samples.bad is not None:
            events.append(replace(samples.bad, time=self.watcher.latest))
        return events

    def _note(self, events: list[Event]) -> list[Event]:
        """Add events to the log; return those to be said."""
        return [said for event in events if (said := self.events.add(event)) is not None]

    def _save(self, stream: Stream) -> None:
        self.events.write(self.folder)
        if self.folder is None:
            return
        state = {
            "key": self.key, "watcher": self.watcher.state, "reader": self.reader.state, "events": self.events,
            "skipping": self.lines.skipping, "position": stream.position(len(self.lines.tail)),
        }  # fmt: skip
        self.folder.replace({STATE: state_bytes(state)})


def make_watch(
    result: Path, source: str, settings: WatchSettings, folder: ResultFolder | None = None, *, allow_code: bool = False
) -> Watch:
    """Return the watch of a robot by its identification, in the file ``result``, and a stream.

    ``source`` is a file or "-". Raises InputError for a result without a configuration, ConfigError where stream
    or settings do not fit it.
    """
    report_progress("reading the result")
    identification = load(result, allow_code=allow_code)
    report_progress("computing the threshold")
    config = config_of_result(identification, "push its samples to a Watcher", allow_code=allow_code)
    name = "standard input" if source == "-" else source
    reader = SampleReader(config, identification.model.joints, name)
    digest = sha256(content(result)).hexdigest()
    key = {"result": digest, **vars(settings)}
    return Watch(Watcher(identification, np.random.default_rng(SEED), settings), reader, source, key, folder)
