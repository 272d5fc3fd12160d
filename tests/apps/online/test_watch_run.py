"""A watch that is stopped goes on, without loss, and without counting anything twice."""

from __future__ import annotations

import itertools
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from dynident.apps.online import Changed, Event, Resumed, Watcher, WatchSettings
from dynident.apps.online.detector import Knowledge
from dynident.apps.online.watch import EVENTS, Watch, event_data, make_watch
from dynident.files.folder import result_folder
from dynident.runtime import ConfigError
from tests.project.watched import CHANGE, SETTINGS, result, rows

Array = NDArray[np.float64]
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


def same(one: Knowledge, other: Knowledge) -> None:
    assert (one.phase, len(one.windows), len(one.blocks)) == (other.phase, len(other.windows), len(other.blocks))
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
    command = [
        sys.executable,
        "-m",
        "dynident",
        "watch",
        str(slider),
        str(stream),
        "--out",
        str(out),
        *map(str, SETTINGS),
    ]
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
    said = [one["event"] for one in map(json.loads, (out / EVENTS).read_text().splitlines())]
    assert [name for name in said if name != "Resumed"] == [type(event).__name__ for event in expected]
    same(one.watcher.knowledge, other.watcher.knowledge)


def test_a_signal_in_the_midst_of_samples_loses_none(
    slider: Path,
    text: str,
    undisturbed: tuple[list[Event], Watch],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
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
    assert [type(event) for event in other.events if not isinstance(event, Resumed)] == [
        type(event) for event in expected
    ]
    same(one.watcher.knowledge, other.watcher.knowledge)


def test_another_result_or_setting_is_refused(slider: Path, tmp_path: Path) -> None:
    stream = tmp_path / "stream.csv"
    stream.write_text("".join(f"{row}\n" for row in rows(5.0)))
    watched(slider, stream, tmp_path / "out")
    with pytest.raises(ConfigError, match="another result or other settings"):
        watched(slider, stream, tmp_path / "out", WatchSettings(block=1.0, baseline=26.0))
