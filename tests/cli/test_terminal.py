"""Paths and texts at the command line."""

from __future__ import annotations

from pathlib import Path

import pytest

from dynident.cli.escapes import one_line, visible
from tests.cli.commands import configure, run, write_log


def test_what_acts_is_shown_as_escapes() -> None:
    assert visible("q\x1b[31m\x9b\u202e\u2066\r\t\x7f\udc9b é ∞\u00a0") == (
        r"q\x1b[31m\x9b\u202e\u2066\r\t\x7f\udc9b é ∞" + "\u00a0"
    )
    assert visible("a\nb") == "a\nb"
    assert one_line("a\nError: b\n  c: d\n") == "a\\nError: b\n  c: d"


def test_a_folder_through_one_that_does_not_exist(tmp_path: Path) -> None:
    """What is written into x/../y is in y, and makes no x."""
    write_log(tmp_path)
    done = run("identify", configure(tmp_path), "--out", tmp_path / "x" / ".." / "y")
    assert done.exit_code == 0, done.output
    assert (tmp_path / "y" / "result.json").is_file()
    assert not (tmp_path / "x").exists()


@pytest.mark.parametrize("out", ["", "a\0b"])
def test_what_is_no_name_of_a_file(tmp_path: Path, out: str) -> None:
    done = run("identify", configure(tmp_path), "--out", out)
    assert done.exit_code == 2
    assert f"{out!r} is no name of a file or folder" in done.output
