"""A file that grows, is rotated, cut, or read on after a kill."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import pytest

from dynident.apps.online.stream import FollowedFile, StandardInput
from dynident.runtime import InputError


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "log.csv"
    path.write_bytes(b"head\n1\n2")
    return path


def add(path: Path, text: bytes) -> None:
    with open(path, "ab") as file:
        file.write(text)


def test_what_is_added_is_read(log: Path) -> None:
    one = FollowedFile(log)
    assert one.read() == (b"head\n1\n2", True, False)
    assert one.read() == (b"", False, False)
    add(log, b"2\n3\n")
    assert one.read() == (b"2\n3\n", False, False)
    one.close()


def test_a_rotated_file_is_read_to_its_end_and_then_the_next(log: Path) -> None:
    one = FollowedFile(log)
    one.read()
    log.rename(log.with_name("log.csv.1"))
    assert one.read() == (b"", False, False)  # between two files
    add(log.with_name("log.csv.1"), b"2\n")
    log.write_bytes(b"head\n3\n")
    assert [one.read() for _ in range(3)] == [(b"2\n", False, False), (b"head\n3\n", True, False), (b"", False, False)]
    one.close()


def test_a_file_that_was_cut_begins_again(log: Path) -> None:
    one = FollowedFile(log)
    one.read()
    os.truncate(log, 0)
    assert one.read()[0] == b""
    add(log, b"3\n")
    assert one.read() == (b"3\n", True, False)
    one.close()


def test_a_saved_position_is_read_on_from(log: Path) -> None:
    one = FollowedFile(log)
    one.read()
    position = json.loads(json.dumps(one.position(1)))  # the last line has no end
    one.close()
    add(log, b"2\n")
    other = FollowedFile(log, position)
    assert other.found
    assert other.read() == (b"22\n", False, False)
    other.close()


def test_a_file_that_was_rotated_meanwhile_is_found_by_what_it_is(log: Path) -> None:
    one = FollowedFile(log)
    one.read()
    position = one.position(0)
    one.close()
    add(log, b"2\n")
    log.rename(log.with_name("log.csv.1"))
    log.write_bytes(b"head\n3\n")
    other = FollowedFile(log, position)
    assert [other.read()[:2] for _ in range(2)] == [(b"2\n", False), (b"head\n3\n", True)]
    other.close()


def test_another_file_is_read_from_its_beginning(log: Path) -> None:
    one = FollowedFile(log)
    one.read()
    position = one.position(0)
    one.close()
    log.unlink()
    log.write_bytes(b"other head\n")
    other = FollowedFile(log, position)
    assert not other.found
    assert other.read() == (b"other head\n", True, False)
    other.close()


def test_a_standard_input_that_is_closed_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", None)
    with pytest.raises(InputError, match="standard input is closed"):
        StandardInput()


def test_what_is_no_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there is no such file"):
        FollowedFile(tmp_path / "none.csv")
    with pytest.raises(InputError, match="it is a folder"):
        FollowedFile(tmp_path)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="a named pipe"):
        FollowedFile(tmp_path / "pipe")
