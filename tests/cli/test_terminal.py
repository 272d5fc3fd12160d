"""Paths and texts at the command line."""

import io
import re
import time
from pathlib import Path

import pytest
from click.testing import CliRunner

from dynident.cli import main
from dynident.cli.command_log import escape_controls, one_line
from dynident.cli.terminal import status
from dynident.runtime import Step, report_progress
from tests.cli.commands import configure, refuse, succeed
from tests.robots import ARM


def test_what_acts_is_shown_as_escapes() -> None:
    assert escape_controls("q\x1b[31m\x9b\u202e\u2066\r\t\x7f\udc9b é ∞\u00a0") == (
        r"q\x1b[31m\x9b\u202e\u2066\r\t\x7f\udc9b é ∞" + "\u00a0"
    )
    assert escape_controls("a\nb") == "a\nb"
    assert one_line("a\nError: b\n  c: d\n") == "a\\nError: b\n  c: d"


def test_a_folder_through_one_that_does_not_exist(tmp_path: Path) -> None:
    """What is written into x/../y is in y, and makes no x."""
    succeed("schema", "--out", tmp_path / "x" / ".." / "y" / "schema.json")
    assert (tmp_path / "y" / "schema.json").is_file()
    assert not (tmp_path / "x").exists()


@pytest.mark.parametrize("out", ["", "a\0b"])
def test_what_is_no_name_of_a_file(tmp_path: Path, out: str) -> None:
    refuse("identify", configure(tmp_path), "--out", out, says=f"{out!r} is no name of a file or folder", code=2)


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_what_is_read_first_is_said_before_packages_are_imported(monkeypatch: pytest.MonkeyPatch) -> None:
    """Until the next output takes its place, here an error; neither in a pipe nor with --quiet."""
    monkeypatch.setenv("COLUMNS", "30")
    for terminal, quiet in ((Terminal(), []), (Terminal(), ["--quiet"]), (io.StringIO(), [])):
        monkeypatch.setattr("sys.stderr", terminal)
        with pytest.raises(SystemExit):
            main([*quiet, "predict", "a\x1bresult.json", "monday.csv"])
        announcement, name = terminal.getvalue().rpartition("Error: ")[0], "a\\x1bresult.json"
        is_said = terminal.isatty() and not quiet
        assert announcement == (f"reading {name}\r{' ' * 29}\r" if is_said else "")
        assert name in terminal.getvalue()


def shown(screen: Terminal, words: str) -> None:
    """Wait until words are shown."""
    for _ in range(1000):
        if words in screen.getvalue():
            return
        time.sleep(0.02)
    raise AssertionError(screen.getvalue())


@pytest.mark.parametrize("columns", ["50", "80"])
def test_a_step_with_the_time_left_where_it_is_known(monkeypatch: pytest.MonkeyPatch, columns: str) -> None:
    screen, words = Terminal(), "choosing the smoother of a robot with a long name"
    monkeypatch.setattr("sys.stderr", screen)
    for name, value in (("TERM", "xterm"), ("COLUMNS", columns)):
        monkeypatch.setenv(name, value)
    with status():
        for done, text in enumerate(("0 of 4", "1 of 4", "left")):
            report_progress(Step(words, done, 4))
            shown(screen, text)
        report_progress("estimating")
        shown(screen, "estimating")
    lines = [re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", line) for line in re.split(r"[\r\n]", screen.getvalue())]
    assert any(re.search("choosing.*  2 of 4  about .* left", line) for line in lines)
    assert any(line.rstrip().endswith("estimating  0 s") for line in lines)
    assert max(map(len, lines)) <= int(columns)


@pytest.mark.parametrize("encoding", ["ascii", "cp1252", "utf-8"])
def test_tables_are_printed_in_any_encoding(tmp_path: Path, encoding: str) -> None:
    """That of a file to which Windows redirects what is printed has no lines to draw."""
    robot = tmp_path / "arm.urdf"
    robot.write_text(ARM.replace('"shoulder"', '"łokieć"'), encoding="utf-8")
    done = CliRunner(charset=encoding).invoke(main, ["check", str(robot), "-v"])
    assert done.exit_code == 0, done.output
    name, line = ("łokieć", "───") if encoding == "utf-8" else (r"\u0142okie\u0107", "---")
    assert name in done.stdout
    assert line in done.stdout
