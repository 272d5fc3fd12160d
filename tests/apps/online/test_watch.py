"""A watch: what it says and writes, its state as bytes, and its going on after a stop."""

import itertools
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dynident.apps import online
from dynident.apps.online import BadLines, Changed, Event, Gap, Resumed, Watcher, WatchSettings
from dynident.apps.online.detector import Knowledge
from dynident.apps.online.event_log import EVENTS, EventLog, event_data
from dynident.apps.online.report import event_line
from dynident.apps.online.watch import Watch, make_watch, read_state, state_bytes
from dynident.files.folder import result_folder
from dynident.runtime import ConfigError, InputError
from dynident.runtime.arrays import Array
from tests.kept import check_kept
from tests.laws.test_sentences import EVENTS as EVENTS_WITH_SENTENCES
from tests.project.watched import CHANGE, SETTINGS, result, rows


def test_the_law_of_sentences_has_all_events() -> None:
    events = {value for value in vars(online).values() if isinstance(value, type) and issubclass(value, Event)} - {
        Event
    }
    assert {type(event) for event in EVENTS_WITH_SENTENCES} == events


def test_dates_are_shown_where_the_stream_has_them_and_none_before_the_first_sample() -> None:
    assert event_line(Gap(3600.0, 4.0), (), 86_400.0 * 20_000).text.startswith("2024-10-04 01:00:00: ")
    start = event_line(BadLines(float("nan"), 1, 2, "x\x1b[31m", 2), ())
    assert start.text == "at the start: line 2 could not be read and is left out: 'x\\x1b[31m'."


@pytest.mark.parametrize("harm", [0.0, 0.3, 0.9, "version 99"])
def test_a_state_that_cannot_be_read_is_said(tmp_path: Path, harm: float | str) -> None:
    path, data = tmp_path / "state.npz", state_bytes({"x": np.arange(100.0), "far": -np.inf, "one": ("x", None)})
    path.write_bytes(data)
    assert (read_state(path)["far"], read_state(path)["one"]) == (-np.inf, ("x", None))
    if isinstance(harm, float):
        path.write_bytes(data[: int(harm * len(data))])
    else:
        np.savez(path, state=np.frombuffer(b'{"format": "dynident watch", "version": 99, "state": {}}', dtype=np.uint8))
    with pytest.raises(InputError, match=f"{harm}.*delete it" if isinstance(harm, str) else "delete it, and the watch"):
        read_state(path)


HOW = WatchSettings(block=1.0, baseline=25.0, settle=6.0)


@pytest.fixture(scope="module")
def slider(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return result(tmp_path_factory.mktemp("slider"))


@pytest.fixture(scope="module")
def text() -> str:
    return "".join(f"{row}\n" for row in rows())


@pytest.fixture(scope="module")
def undisturbed(slider: Path, text: str, tmp_path_factory: pytest.TempPathFactory) -> tuple[list[Event], Watch]:
    """Return what a watch says of the whole stream in one go, and the watch."""
    folder = tmp_path_factory.mktemp("undisturbed")
    (folder / "stream.csv").write_text(text)
    return watched(slider, folder / "stream.csv", folder / "out")


def watched(slider: Path, stream: Path, out: Path, how: WatchSettings = HOW) -> tuple[list[Event], Watch]:
    with result_folder(out) as folder:
        watch = make_watch(slider, str(stream), how, folder)
        return list(watch.run(follow=False)), watch


def written_events(out: Path) -> list[str]:
    """Return the names of the events in a folder, which are numbered one after the other."""
    rows = [json.loads(line) for line in (out / EVENTS).read_text().splitlines()]
    assert [row["id"] for row in rows] == list(range(1, len(rows) + 1))
    return [row["event"] for row in rows]


def same(knowledge: Knowledge, other: Knowledge) -> None:
    assert (knowledge.alarm, len(knowledge.windows), len(knowledge.blocks)) == (
        other.alarm,
        len(other.windows),
        len(other.blocks),
    )
    np.testing.assert_array_equal(knowledge.reference.value, other.reference.value)
    for a, b in zip(knowledge.windows, other.windows, strict=True):
        np.testing.assert_array_equal(a.score, b.score)


def test_a_change_in_a_file_is_found_written_and_said_as_before(undisturbed: tuple[list[Event], Watch]) -> None:
    events, watch = undisturbed
    assert abs(next(event for event in events if isinstance(event, Changed)).since - CHANGE) <= 2.0
    said = [json.loads(line) for line in (watch.folder.path / EVENTS).read_text().splitlines()]
    assert said == [{"id": k, **json.loads(json.dumps(event_data(x)))} for k, x in enumerate(events, 1)]
    check_kept("watched", "\n".join(str(event_line(event, ("slider",))) for event in events))


def test_a_watch_in_pieces_knows_what_one_in_one_go_knows(
    slider: Path, text: str, undisturbed: tuple[list[Event], Watch], tmp_path: Path
) -> None:
    (expected, case), stream = undisturbed, tmp_path / "stream.csv"
    actual, cuts = list[Event](), [0, 7, 90_001, 200_003, len(text)]
    for start, stop in itertools.pairwise(cuts):
        with open(stream, "a") as file:
            file.write(text[start:stop])
        events, other = watched(slider, stream, tmp_path / "other")
        actual += [event for event in events if not isinstance(event, Resumed)]
    assert [repr(event) for event in actual] == [repr(event) for event in expected]
    same(case.watcher.knowledge, other.watcher.knowledge)


def test_a_killed_watch_goes_on(
    slider: Path, text: str, undisturbed: tuple[list[Event], Watch], tmp_path: Path
) -> None:
    """Killed while it reads a file that grows, it knows in the end what an undisturbed one knows."""
    (expected, case), stream, out = undisturbed, tmp_path / "stream.csv", tmp_path / "out"
    stream.write_text("")
    command = [sys.executable, "-m", "dynident", "watch", *map(str, (slider, stream, "--out", out, *SETTINGS))]
    child = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    stream.write_text(text[: len(text) // 2])
    end = time.monotonic() + 60
    while time.monotonic() < end and (not (out / EVENTS).is_file() or not (out / EVENTS).read_text()):
        time.sleep(0.02)
    os.kill(child.pid, signal.SIGKILL)  # it has said that the baseline is complete
    child.wait()
    stream.write_text(text)
    events, other = watched(slider, stream, out)
    assert isinstance(events[0], Resumed)
    assert [name for name in written_events(out) if name != "Resumed"] == [type(event).__name__ for event in expected]
    same(case.watcher.knowledge, other.watcher.knowledge)


def test_a_signal_in_the_midst_of_samples_loses_none(
    slider: Path, text: str, undisturbed: tuple[list[Event], Watch], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (expected, case), stream = undisturbed, tmp_path / "stream.csv"
    stream.write_text(text[:150_000])
    watched(slider, stream, tmp_path / "out")
    stream.write_text(text)
    push = Watcher.push

    def stopped(self: Watcher, t: Array, q: Array, tau: Array) -> tuple[Event, ...]:
        push(self, t[:100], q[:100], tau[:100])
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(Watcher, "push", stopped)
        with pytest.raises(KeyboardInterrupt):
            watched(slider, stream, tmp_path / "out")
    _, other = watched(slider, stream, tmp_path / "out")
    assert [name for name in written_events(tmp_path / "out") if name != "Resumed"] == [
        type(event).__name__ for event in expected
    ]
    same(case.watcher.knowledge, other.watcher.knowledge)


def test_another_result_or_setting_is_refused(slider: Path, tmp_path: Path) -> None:
    stream = tmp_path / "stream.csv"
    stream.write_text("".join(f"{row}\n" for row in rows(5.0)))
    watched(slider, stream, tmp_path / "out")
    with pytest.raises(ConfigError, match="another result or other settings"):
        watched(slider, stream, tmp_path / "out", WatchSettings(block=1.0, baseline=26.0))


def test_bad_lines_that_follow_each_other_are_one_event(tmp_path: Path) -> None:
    log, said = EventLog(), list[Event | None]()
    with result_folder(tmp_path / "out") as folder:
        for k in range(1, 251):
            said.append(log.add(BadLines(float(k), 1, 2 * k, "x", 2 * k)))
            log.write(folder)
        log.add(Gap(300.0, 4.0))
        log.add(BadLines(301.0, 1, 3, "of the next file", 3))
        log.write(folder)
    assert [event.count for event in said if isinstance(event, BadLines)] == [1, 10, 100]
    rows = [json.loads(line) for line in (tmp_path / "out" / EVENTS).read_text().splitlines()]
    assert rows[0] == {"id": 1, "event": "BadLines", "time": 250.0, "count": 250, "line": 2, "text": "x", "last": 500}
    assert [row["event"] for row in rows] == ["BadLines", "Gap", "BadLines"]


@pytest.mark.parametrize("harm", ["lines of a killed watch", "shortened", "deleted"])
def test_a_log_goes_on_where_its_state_ends(tmp_path: Path, harm: str) -> None:
    log = EventLog()
    path = tmp_path / "out" / EVENTS
    with result_folder(tmp_path / "out") as folder:
        for k in range(5):
            log.add(Gap(float(k), 4.0))
        log.write(folder)
        resumed = replace(log)
        if harm == "deleted":
            path.unlink()
        elif harm == "shortened":
            os.truncate(path, 0)
        else:
            log.add(Gap(9.0, 4.0))
            log.write(folder)
        resumed.add(Resumed(4.0, 4.0))
        resumed.write(folder)
    rows = [json.loads(line) for line in path.read_text().splitlines()]
    assert [row["id"] for row in rows][-2:] == [5, 6]
    assert [row["event"] for row in rows] == ["Gap"] * (len(rows) - 1) + ["Resumed"]
