"""What commands share: completion, schemas, the version, options that spread the work, and commands to paste."""

import json
import os
import platform
import re
import shlex
import shutil
import socket
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import click
import pytest
from click.shell_completion import ShellComplete
from click.testing import CliRunner

import dynident
from dynident.apps.fleets.config import fleet_schema
from dynident.cli import main
from dynident.cli import options as version
from dynident.cli.failures import COMMAND, command, launcher
from dynident.cli.options import WorkerOptions, add_worker_options
from dynident.project.result_format import config_schema, result_schema
from dynident.runtime.jobs import cluster
from dynident.runtime.kernel import kernel
from tests.cli.commands import configure, run, succeed, write_log


def completed(words: list[str], incomplete: str) -> list[tuple[str, str]]:
    completions = ShellComplete(main, {}, "dynident", "_DYNIDENT_COMPLETE").get_completions(words, incomplete)
    return [(x.type, str(x.value)) for x in completions]


def test_files_and_folders_are_left_to_the_shell() -> None:
    for words in (["check"], ["check", "--json"], ["init"], ["init", "arm.urdf"]):
        assert completed(words, "ar") == [("file", "ar")]
    assert completed(["smooth", "x.csv", "--out"], "") == [("dir", "")]


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script_of_each_shell_knows_the_program_by_its_name(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], shell: str
) -> None:
    monkeypatch.setattr("sys.argv", ["/opt/tools/bin/dynident"])
    monkeypatch.setenv("_DYNIDENT_COMPLETE", f"{shell}_source")
    monkeypatch.setattr("click.shell_completion.BashComplete._check_version", lambda _: None)  # it asks bash
    with pytest.raises(SystemExit) as end:
        main([])
    assert not end.value.code
    script = capsys.readouterr().out
    assert "_dynident_completion" in script
    assert "/opt" not in script


def test_it_prints_and_writes_the_schemas(tmp_path: Path) -> None:
    done = succeed("schema")
    assert json.loads(done.output) == config_schema()
    done = succeed("schema", "result", "--out", tmp_path / "result.schema.json")
    assert "result.schema.json" in done.output
    assert json.loads((tmp_path / "result.schema.json").read_text()) == result_schema()
    done = run("schema", "fleet")
    assert json.loads(done.output) == fleet_schema()
    assert run("schema", "robot").exit_code == 2


def test_the_version_says_what_it_runs_with() -> None:
    shown = run("--version").output
    assert shown.startswith(f"dynident {dynident.__version__}")
    assert platform.python_version() in shown
    assert f"numpy {metadata.version('numpy')}" in shown
    assert f"\nkernel: {kernel()}\n" in shown


def test_only_a_clone_has_a_commit(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    package = tmp_path / "lib" / "site-packages" / "dynident"
    monkeypatch.setattr(version, "__file__", str(package / "cli" / "version.py"))
    assert version.commit() is None  # even where the environment lies in somebody else's clone
    (tmp_path / "lib" / ".git").mkdir(parents=True)
    assert version.commit() is None
    package.mkdir(parents=True)
    (package / "commit.txt").write_text("1234abc\n")
    assert version.commit() == "1234abc"
    clone = tmp_path / "clone"
    (clone / "src" / "dynident").mkdir(parents=True)
    monkeypatch.setattr(version, "__file__", str(clone / "src" / "dynident" / "cli" / "version.py"))
    git = [shutil.which("git") or pytest.skip("there is no git"), "-C", str(clone)]
    author = ("-c", "user.name=a", "-c", "user.email=a@b")
    for words in (("init",), (*author, "commit", "--allow-empty", "--message=first")):
        subprocess.run([*git, *words], check=True, capture_output=True)
    assert re.fullmatch("[0-9a-f]{7,40}", version.commit() or "")


@click.command()
@add_worker_options
@click.option("--last")
def spreading(spread: WorkerOptions, last: str | None) -> None:
    click.echo(repr(spread))


def test_workers_and_a_cluster_are_two_ways() -> None:
    done = CliRunner().invoke(spreading, ["--workers", "2", "--cluster", "tcp://a:1"])
    assert done.exit_code == 2
    assert "give one of them" in done.output


def test_a_cluster_that_does_not_answer_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "ANSWER_SECONDS", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        done = run("reproduce", "--runs", 1, "--cluster", address)
    assert done.exit_code == 1
    assert f"no Dask scheduler answers at {address}" in done.output
    assert "no run is" not in done.output  # it was not begun


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
