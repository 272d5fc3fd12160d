"""How much a command says, and the log that keeps all of it."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from dynident.cli.command_log import LOG_HEAD
from tests.cli.commands import configure, refuse, run, succeed, write_log
from tests.robots import ARM

STAMP = re.compile(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.\d{3}[+-]\d\d:\d\d  ")
SMOOTH = ("--time", "time", "--column", "pos")


@pytest.mark.parametrize("before", [True, False])
def test_steps_are_printed_with_times_wherever_the_option_stands(tmp_path: Path, before: bool) -> None:
    write_log(tmp_path)
    words = ["check", configure(tmp_path)]
    done = succeed(*(["-v", *words] if before else [*words, "-v"]))
    steps = re.findall(r"^ *\d+\.\d s  (.*)", done.stderr, re.M)
    assert steps[:2] == ["building the model", "reading log 0-3 s"]
    assert len(steps) == len(set(steps))
    assert " s  " not in done.stdout.splitlines()[0]


def test_the_log_keeps_all_that_is_said_of_each_run(tmp_path: Path) -> None:
    log, out = tmp_path / "logs" / "run.log", tmp_path / "out"
    done = succeed("--log-file", log, "smooth", write_log(tmp_path), *SMOOTH, "--out", out, "-q")
    failed = run("smooth", tmp_path / "log.csv", "--time", "tmie", "--log-file", log)
    assert failed.exit_code == 1
    head, *lines = log.read_text().splitlines()
    assert head == LOG_HEAD
    assert all(STAMP.match(line) for line in lines)
    said = [line[len(STAMP.match(line).group()) :] for line in lines]
    assert said[0].startswith("dynident ")
    assert "ended with exit code 0 after" in "\n".join(said)
    assert {line for line in done.stdout.splitlines() if line} <= set(said)
    assert any(line.startswith("Error: ") and "tmie" in line for line in said)
    assert said[-1].startswith("ended with exit code 1")


def test_a_log_in_the_folder_of_the_results(tmp_path: Path) -> None:
    write_log(tmp_path)
    succeed("smooth", tmp_path / "log.csv", *SMOOTH, "--out", tmp_path / "out", "--log-file", tmp_path / "out/run.log")
    assert {path.name for path in (tmp_path / "out").iterdir()} >= {"run.log", "smoothed.csv", "report.html"}


@pytest.mark.parametrize("name", ["log.csv", "identify.yaml", "out/report.html"])
def test_no_file_but_a_log_is_added_to(tmp_path: Path, name: str) -> None:
    write_log(tmp_path)
    config = configure(tmp_path)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "report.html").write_text("<html>")
    before = (tmp_path / name).read_bytes()
    refuse("check", config, "--log-file", tmp_path / name, says="is no log of dynident")
    assert (tmp_path / name).read_bytes() == before


def test_names_in_a_log_are_escaped(tmp_path: Path) -> None:
    write_log(tmp_path, "a\x1b[31mb.csv")
    log = tmp_path / "run.log"
    run("smooth", tmp_path / "a\x1b[31mb.csv", "--time", "none", "--log-file", log)
    assert "\x1b" not in log.read_text()
    assert r"a\x1b[31mb.csv" in log.read_text()


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no limit of a file's size")
@pytest.mark.parametrize("room", [0, 300])
def test_a_log_that_cannot_grow_is_said_and_the_rest_goes_on(tmp_path: Path, room: int) -> None:
    (tmp_path / "arm.urdf").write_text(ARM)
    limited = (
        f"import resource, runpy; resource.setrlimit(resource.RLIMIT_FSIZE, ({room}, resource.RLIM_INFINITY)); "
        "runpy.run_module('dynident', run_name='__main__')"
    )
    done = subprocess.run(
        [sys.executable, "-c", limited, "check", "arm.urdf", "--log-file", "run.log"],
        cwd=tmp_path, capture_output=True, text=True, env={**os.environ, "PYTHONDONTWRITEBYTECODE": "1"},
    )  # fmt: skip
    (said,) = done.stderr.splitlines()
    assert "run.log: " in said
    assert "cannot be written: File too large" in said
    assert done.returncode == (0 if room else 1)
    assert ("No errors" in done.stdout) == bool(room)
