"""Commands to paste: begun as the user began, and quoted."""

from __future__ import annotations

import os
import shlex
import shutil
import sys
from pathlib import Path

import pytest

from dynident.cli.failures import COMMAND, command, launcher
from tests.cli.commands import configure, run, succeed, write_log


def test_what_was_typed_comes_first(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv(COMMAND, raising=False)
    monkeypatch.setattr(sys, "argv", ["/usr/lib/python3/pytest/__main__.py"])
    assert launcher() == "dynident"
    monkeypatch.setattr(sys, "argv", ["/somewhere/dynident/__main__.py"])
    program, *words = shlex.split(launcher())
    assert Path(shutil.which(program) or program).samefile(sys.executable)
    assert words == ["-m", "dynident"]
    monkeypatch.setattr(sys, "argv", [str(tmp_path / "my tools" / "dynident")])
    assert shlex.split(launcher()) == [str(tmp_path / "my tools" / "dynident")]
    monkeypatch.setenv(COMMAND, "python3 dev.py run")
    assert command("check", "my arm.yaml") == "python3 dev.py run check 'my arm.yaml'"
    assert command("check", Path("-q.yaml"), "-q") == f"python3 dev.py run check .{os.sep}-q.yaml -q"


def test_a_program_on_the_path_goes_by_its_name(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    program = tmp_path / "dynident"
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    monkeypatch.delenv(COMMAND, raising=False)
    monkeypatch.setattr(sys, "argv", [str(program)])
    monkeypatch.setenv("PATH", str(tmp_path))
    assert launcher() == "dynident"


def test_each_command_leads_to_the_next_which_runs_as_printed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv(COMMAND, "DYNIDENT")
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "my arm"
    folder.mkdir()
    write_log(folder)
    said = run("check", configure(folder).relative_to(tmp_path)).stdout
    for ending, times in (("--out identify-out", 1), ("torques.csv", 1), ("arm.py", 1)):
        lines = [line for line in said.splitlines() if line.endswith(ending)]
        assert len(lines) == times, said
        done = succeed("-v", *shlex.split(lines[0].partition("DYNIDENT ")[2]))
        said = done.stdout if "Files in" in done.stdout else said
    assert (tmp_path / "identify-out" / "arm.py").is_file()
