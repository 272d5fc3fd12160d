"""A watch: one sentence for each event, its state as bytes, and its going on after a stop."""

from __future__ import annotations

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
from dynident.apps.online import (
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
from dynident.apps.online.detector import Knowledge
from dynident.apps.online.event_log import EVENTS, EventLog, event_data
from dynident.apps.online.report import event_line, watch_words
from dynident.apps.online.watch import Watch, make_watch, read_state, state_bytes
from dynident.files.folder import result_folder
from dynident.regression import GroupKind
from dynident.runtime import ConfigError, InputError, Severity
from dynident.runtime.arrays import Array
from tests.kept import check_kept
from tests.project.watched import CHANGE, SETTINGS, result, rows

FRICTION, PAYLOAD, RESIDUAL = GroupKind.FRICTION, GroupKind.PAYLOAD, GroupKind.RESIDUAL
CHANGED = Changed(
    60.0, PAYLOAD, "wrist", 30.0, (29.0, 31.0), ("m", "mx", "my"), ("kg", "kg m", "kg m"),
    (0.5, 0.001, 0.3), (0.01, 0.01, np.inf), (0.7, 0.001, 0.3), 50.0,
)  # fmt: skip
SAID: list[tuple[Event, str]] = [
    (BaselineKnown(600.0, 0.0, (1.0, 0.5), (0.4, 0.4)),
     "elbow 1.0, wrist 0.50; more than twice that of the identification at elbow."),
    (BaselineKnown(600.0, 0.0, (5.0, 0.5), (0.4, 0.4)), "at elbow; at one, more than ten times: check"),
    (Unsteady(600.0, FRICTION, "elbow", 0.0), "friction of elbow changed within the baseline since 0.0 s"),
    (NewMotion(700.0, 640.0), "moves as it did not in the baseline since 640.0 s"),
    (Alarm(45.0, PAYLOAD, "wrist", 30.0, (29.0, 31.0), 20.0),
     "a change since about 30.0 s, most likely payload at wrist"),
    (CHANGED,
     "payload at wrist changed between 29.0 s and 31.0 s: m by +0.500 +- 0.010 kg (+0.700 since the baseline)."),
    (Changed(60.0, RESIDUAL, "elbow", 30.0, (30.0, 30.0), ("e",), ("",), (float(np.log(2)),), (0.1,), (1.0,), 50.0),
     "torque that the model leaves at elbow changed at about 30.0 s: +100 %."),
    (Passed(60.0, FRICTION, "elbow", 30.0), "the change since 30.0 s (friction of elbow) has passed"),
    (Fault(9.1, FaultKind.FROZEN, Signal.POSITION, "elbow", 9.0),
     "the position of elbow does not change any more, since 9.0 s"),
    (Fault(9.1, FaultKind.MISSING, Signal.TORQUE, "elbow", 9.0), "the torque of elbow gives no number, since 9.0 s"),
    (Fault(9.1, FaultKind.STILL, Signal.POSITION, "elbow", 9.0), "the torques are not those of a rest"),
    (Fault(9.1, FaultKind.JUMP, Signal.POSITION, "elbow", 9.0, -0.5), "jumps at 9.0 s, by -0.500 rad or m"),
    (Back(20.0, Signal.POSITION, "elbow", 9.0), "the position of elbow works again, after a fault since 9.0 s"),
    (Resting(310.0, 10.0), "the robot has hardly moved since 10.0 s"),
    (Gap(20.0, 4.0), "no sample came for 4.00 s"),
    (ClockReset(0.0, 20.0), "the time was set back, from 20.0 s"),
    (BadLines(20.0, 2, 17, "x\x1b[31m", 19),
     "2 lines could not be read and are left out, the first is line 17: 'x\\x1b[31m', the last line 19"),
    (Unreadable(20.0, 100, "no joint moves."), "100 samples cannot be used: no joint moves."),
    (Resumed(20.0, 20.0), "goes on from its saved state, after the sample at 20.0 s"),
]  # fmt: skip


@pytest.mark.parametrize(("event", "said"), SAID, ids=lambda one: type(one).__name__ if isinstance(one, Event) else "")
def test_each_event_has_its_sentence(event: Event, said: str) -> None:
    line = event_line(event, ("elbow", "wrist"))
    assert said in line.text
    assert line.text.startswith(f"{event.time:.1f} s: ")
    assert line.text.endswith(".")
    assert (line.severity is Severity.WARNING) == isinstance(event, Alarm | Changed | Fault | Unsteady | Unreadable)


def test_no_event_is_without_a_sentence() -> None:
    events = {one for one in vars(online).values() if isinstance(one, type) and issubclass(one, Event)} - {Event}
    assert {type(event) for event, _ in SAID} == events


def test_dates_are_shown_where_the_stream_has_them_and_none_before_the_first_sample() -> None:
    assert event_line(Gap(3600.0, 4.0), (), 86_400.0 * 20_000).text.startswith("2024-10-04 01:00:00: ")
    assert event_line(BadLines(float("nan"), 1, 2, "x", 2), ()).text.startswith("at the start: line 2 could not be")


def test_the_rate_of_false_alarms_is_said() -> None:
    assert "at most one in 33 days by chance" in watch_words(WatchSettings())
    assert "at most 2.0 a day by chance" in watch_words(WatchSettings(false_alarms=2.0))


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
        one = make_watch(slider, str(stream), how, folder)
        return list(one.run(follow=False)), one


def written_events(out: Path) -> list[str]:
    """Return the names of the events in a folder, which are numbered one after the other."""
    rows = [json.loads(line) for line in (out / EVENTS).read_text().splitlines()]
    assert [row["id"] for row in rows] == list(range(1, len(rows) + 1))
    return [row["event"] for row in rows]


def same(one: Knowledge, other: Knowledge) -> None:
    assert (one.alarm, len(one.windows), len(one.blocks)) == (other.alarm, len(other.windows), len(other.blocks))
    assert one.reference is not None
    assert other.reference is not None
    np.testing.assert_array_equal(one.reference.value, other.reference.value)
    for a, b in zip(one.windows, other.windows, strict=True):
        np.testing.assert_array_equal(a.score, b.score)


def test_a_change_is_found_in_a_file(undisturbed: tuple[list[Event], Watch]) -> None:
    events, watch = undisturbed
    (found,) = [one for one in events if isinstance(one, Changed)]
    assert found.joint == "slider"
    assert abs(found.since - CHANGE) <= 2.0
    assert watch.folder is not None
    said = [json.loads(line) for line in (watch.folder.path / EVENTS).read_text().splitlines()]
    assert said == [{"id": k, **json.loads(json.dumps(event_data(one)))} for k, one in enumerate(events, 1)]


def test_a_watch_in_pieces_knows_what_one_in_one_go_knows(
    slider: Path, text: str, undisturbed: tuple[list[Event], Watch], tmp_path: Path
) -> None:
    (expected, one), stream = undisturbed, tmp_path / "stream.csv"
    found, cuts = list[Event](), [0, 7, 90_001, 200_003, len(text)]
    for start, stop in itertools.pairwise(cuts):
        with open(stream, "a") as file:
            file.write(text[start:stop])
        events, other = watched(slider, stream, tmp_path / "other")
        found += [event for event in events if not isinstance(event, Resumed)]
    assert [repr(event) for event in found] == [repr(event) for event in expected]
    same(one.watcher.knowledge, other.watcher.knowledge)


def test_a_killed_watch_goes_on(
    slider: Path, text: str, undisturbed: tuple[list[Event], Watch], tmp_path: Path
) -> None:
    """Killed while it reads a file that grows, it knows in the end what an undisturbed one knows."""
    (expected, one), stream, out = undisturbed, tmp_path / "stream.csv", tmp_path / "out"
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
    same(one.watcher.knowledge, other.watcher.knowledge)


def test_a_signal_in_the_midst_of_samples_loses_none(
    slider: Path, text: str, undisturbed: tuple[list[Event], Watch], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (expected, one), stream = undisturbed, tmp_path / "stream.csv"
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
    same(one.watcher.knowledge, other.watcher.knowledge)


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


def test_a_save_writes_what_is_new_and_keeps_one_event(tmp_path: Path) -> None:
    log, path = EventLog(), tmp_path / "out" / EVENTS
    with result_folder(tmp_path / "out") as folder:
        for k in range(20):
            log.add(Gap(float(k), 4.0))
            log.write(folder)
        first = path.read_text().splitlines(keepends=True)[0]
        with open(path, "r+") as file:
            file.write("x" * len(first.strip()))  # not written again
        log.add(Gap(20.0, 4.0))
        log.write(folder)
    assert path.read_text().startswith("xxx")
    assert len(path.read_text().splitlines()) == 21
    assert len(str(log)) < 200


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


def test_all_that_a_watch_says_stays(undisturbed: tuple[list[Event], Watch]) -> None:
    check_kept("watched", "\n".join(str(event_line(event, ("slider",))) for event in undisturbed[0]))
