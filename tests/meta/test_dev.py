"""What dev.py does for a user: commands run where the user stands, and what it says to type can be typed."""

import os
import re
import runpy
import shlex
import shutil
import signal
import subprocess
import sys
import tomllib
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from dynident.cli import main
from tests.robots import ARM

ROOT = Path(__file__).parents[2]
pytestmark = pytest.mark.skipif(os.name == "nt", reason="the environment is stood in for by a shell script")


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A checkout in a folder with a space, whose environment is the one that runs the tests."""
    folder = tmp_path_factory.mktemp("new user") / "my dynident"
    python = folder / ".venv" / "bin" / "python"
    python.parent.mkdir(parents=True)
    for name in ("dev.py", "pyproject.toml", "constraints.txt", "hatch_build.py"):
        shutil.copy(ROOT / name, folder)
    python.write_text(f'#!/bin/sh\nexec {shlex.quote(sys.executable)} "$@"\n')
    python.chmod(0o755)
    module = runpy.run_path(str(folder / "dev.py"))
    for needs in ("base", *(needs for needs, _ in module["TASKS"].values() if needs), *module["EXTRAS"].values()):
        (folder / ".venv" / f"installed-{needs}").write_text(module["digest"]())
    (folder / ".venv" / "kernel").write_text(module["kernel_digest"]())
    return folder


@pytest.fixture
def user(project: Path) -> Path:
    """A folder beside the checkout, with a file named like a module that is imported."""
    folder = project.parent / "my data"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    (folder / "numpy.py").write_text("raise SystemExit('the file of the user was imported')")
    return folder


def start(folder: Path, *words: str) -> subprocess.Popen[str]:
    """Start dev.py as from a shell; its pipes are those of the command."""
    pipe = subprocess.PIPE
    command = [sys.executable, os.path.join("..", "my dynident", "dev.py"), *words]
    return subprocess.Popen(command, cwd=folder, stdout=pipe, stderr=pipe, text=True)


def test_a_command_runs_where_the_user_stands(user: Path) -> None:
    process = start(user, "run", "schema", "config", "--out", "my schema.json")
    out, error = process.communicate()
    assert process.returncode == 0, error
    assert out == f"Schema: {user / 'my schema.json'}\n"  # nothing else on standard output
    assert (user / "my schema.json").is_file()


def test_the_exit_code_and_the_streams_are_those_of_the_command(user: Path) -> None:
    process = start(user, "run", "identify", "missing.yaml")
    assert "missing.yaml" in process.communicate()[1]
    assert process.returncode == 1
    process = start(user, "run", "chekc")
    assert re.search(r"Usage: \S*python\S* '../my dynident/dev.py' run \[OPTIONS\]", process.communicate()[1])
    assert process.returncode == 2


def test_a_signal_reaches_the_command(user: Path) -> None:
    (user / "arm.urdf").write_text(ARM)
    process = start(user, "run", "check", *["arm.urdf"] * 2000)
    process.stdout.readline()
    process.send_signal(signal.SIGTERM)
    assert process.communicate()[1].startswith("Interrupted: ")
    assert process.returncode == 128 + signal.SIGTERM


def dev(project: Path, monkeypatch: pytest.MonkeyPatch, *typed: str, **changes: Any) -> dict[str, Any]:
    """The names of dev.py, called by the words of a command line, with some names exchanged."""
    monkeypatch.setattr(sys, "orig_argv", list(typed))
    monkeypatch.setattr(sys, "argv", list(typed[1:]))
    monkeypatch.setenv("DYNIDENT_COMMAND", "")  # what it sets there ends with the test
    names = runpy.run_path(str(project / "dev.py"))
    for name, value in changes.items():
        monkeypatch.setitem(names["main"].__globals__, name, value)
    return names["main"].__globals__


@pytest.mark.parametrize("place", ["my data", "my dynident"])
def test_what_comes_next_can_be_typed(
    project: Path, user: Path, place: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each line runs in a shell; the last activates the environment."""
    commands: list[tuple[Any, ...]] = []
    monkeypatch.chdir(project.parent / place)
    script = "dev.py" if place == "my dynident" else "../my dynident/dev.py"
    names = dev(project, monkeypatch, "python3", script, run=lambda *words, **_: commands.append(words[4:]))
    names["main"](["demo", "--help"])
    assert commands == [("demo", "--help")]
    assert "activate" not in capsys.readouterr().out
    commands.clear()
    names["main"](["demo"])
    assert commands == [("demo",)]
    called = shlex.join(["python3", script, "run"])
    assert os.environ["DYNIDENT_COMMAND"] == called
    lines = [line.strip() for line in capsys.readouterr().out.splitlines() if line.startswith("  ")]
    *shown, activation = lines
    assert len(shown) == 1
    for line in shown:
        assert line.startswith(f"{called} ")
        assert shlex.split(line)[3] in {*main.commands, "--help"}
    (project / ".venv" / "bin" / "activate").touch()
    subprocess.run(activation.replace("source", "."), shell=True, check=True)


@pytest.mark.parametrize(
    ("system", "typed", "values", "expected"),
    [
        ("posix", ("python3", "dev.py"), (), "python3 dev.py"),
        ("posix", ("python3.12", "/my home/dev.py"), (), "python3.12 '/my home/dev.py'"),
        ("posix", ("/opt/3.12/bin/python3", "dev.py"), ("python3",), "python3 dev.py"),
        ("posix", ("/opt/3.12/bin/python3", "dev.py"), (), f"{shlex.quote(sys.executable)} dev.py"),
        ("nt", ("/Program Files/python.exe", "dev.py"), ("py", "python"), "py dev.py"),
        ("nt", ("/Program Files/python.exe", "/my home/dev.py"), ("python",), 'python "/my home/dev.py"'),
    ],
)
def test_it_names_itself_as_it_was_called(
    project: Path,
    monkeypatch: pytest.MonkeyPatch,
    system: str,
    typed: tuple[str, ...],
    values: tuple[str],
    expected: str,
) -> None:
    fake = SimpleNamespace(name=system)
    names = dev(project, monkeypatch, *typed, os=fake, runs_this=lambda name: name in values)
    assert names["called"]() == expected


def test_a_python_that_is_too_old_is_not_named(project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = dev(project, monkeypatch, "python3", "dev.py")
    assert not names["runs_this"]("no-such-python")
    for code in (0, 1):
        (tmp_path / "python3").write_text(f"#!/bin/sh\nexit {code}\n")
        (tmp_path / "python3").chmod(0o755)
        monkeypatch.setenv("PATH", str(tmp_path))
        assert names["runs_this"]("python3") == (code == 0)


@pytest.mark.parametrize("code", [0, 3])
def test_what_pip_says_is_shown_only_where_it_fails(
    code: int, project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    pip = tmp_path / "pip"
    pip.write_text(f"#!/bin/sh\necho WARNING: of root\necho ERROR: no network >&2\nexit {code}\n")
    pip.chmod(0o755)
    names = dev(project, monkeypatch, "python3", "dev.py", PYTHON=pip)
    if code:
        with pytest.raises(SystemExit, match="ERROR: no network\npip could not"):
            names["pip"]("numpy")
    else:
        names["pip"]("numpy")
    assert capfd.readouterr() == ("", "")


def test_the_kernel_is_compiled_when_its_sources_have_changed(
    project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sources, calls = tmp_path / "kernel-sources", tmp_path / "calls"
    sources.mkdir()
    (sources / "a.c").write_text("int a;")
    (sources / "build.py").write_text(f"open({str(calls)!r}, 'a').write('x'); raise SystemExit('no compiler')")
    names = dev(project, monkeypatch, "python3", "dev.py", KERNEL=sources, VENV=tmp_path, PYTHON=sys.executable)
    for change, expected in (("a.c", "x"), ("", "x"), ("a.c", "xx"), ("kernel.bin", "xx"), ("b.h", "xxx")):
        if change:
            (sources / change).write_text(f"{change} {expected}")
        names["compile_kernel"]()
        assert calls.read_text() == expected


@pytest.mark.parametrize("kernel", [True, False])
def test_what_computes_is_tested_without_the_kernel_too(
    kernel: bool, project: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    runs: list[tuple[str | None, tuple[str, ...]]] = []
    asked = SimpleNamespace(run=lambda *_, **__: SimpleNamespace(returncode=not kernel))
    for name, value in (("DYNIDENT_KERNEL", ""), ("PYTHONDONTWRITEBYTECODE", "1"), ("PYTHONPYCACHEPREFIX", "")):
        monkeypatch.setenv(name, value)
    record = lambda *words: runs.append((os.environ["DYNIDENT_KERNEL"], words[3:]))  # noqa: E731
    names = dev(project, monkeypatch, "python3", "dev.py", run=record, subprocess=asked)
    names["test"](["tests/splines", "-x"])
    assert runs == [("", ("tests/splines", "-x"))]
    assert "PYTHONDONTWRITEBYTECODE" not in os.environ
    assert os.environ["PYTHONPYCACHEPREFIX"] == str(project / ".venv" / "bytecode")
    runs.clear()
    names["test"]([])
    two = ("-n", "2", "--dist", "loadfile", "--no-loadscope-reorder")
    assert runs == [("", two), *([("off", (*two, *names["NUMERICAL"]))] * kernel)]
    assert ("kernel was not tested" in capsys.readouterr().out) is not kernel
    assert all((ROOT / path).exists() for path in names["NUMERICAL"])


def test_an_installation_compiles_whatever_the_variable_says(
    project: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pip = tmp_path / "pip"
    pip.write_text(f'#!/bin/sh\necho "<$DYNIDENT_KERNEL>" > {shlex.quote(str(tmp_path))}/said\n')
    pip.chmod(0o755)
    monkeypatch.setenv("DYNIDENT_KERNEL", "off")
    dev(project, monkeypatch, "python3", "dev.py", PYTHON=pip)["pip"]("numpy")
    assert (tmp_path / "said").read_text() == "<>\n"


def test_a_command_that_is_killed_ends_with_the_code_of_shells(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    names = dev(project, monkeypatch, "python3", "dev.py")
    with pytest.raises(SystemExit) as end:
        names["run"]("sh", "-c", "kill -9 $$")
    assert end.value.code == 128 + 9


ANSWERS_LATE = """
import sys, time
try:
    print("up", flush=True)
    time.sleep(60)
except KeyboardInterrupt:
    time.sleep(0.3)
    sys.exit(7)
"""


def test_ctrl_c_is_for_the_command_to_answer(project: Path) -> None:
    """Both get it, as from a terminal: the command ends its work, and then dev.py with its code."""
    code = (
        f"import runpy; runpy.run_path({str(project / 'dev.py')!r})['run']({sys.executable!r}, '-c', {ANSWERS_LATE!r})"
    )
    pipe = subprocess.PIPE
    process = subprocess.Popen(
        [sys.executable, "-c", code], stdout=pipe, stderr=pipe, text=True, start_new_session=True
    )
    assert process.stdout.readline() == "up\n"
    os.killpg(process.pid, signal.SIGINT)
    assert process.communicate()[1] == ""
    assert process.returncode == 7


def test_extras_and_groups_become_requirements(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Old pips know no groups, so that pip is given what they hold."""
    requirements = dev(project, monkeypatch, "python3", "dev.py")["requirements"]
    assert requirements([]) == ["--editable", "."]
    assert requirements(["ui", "hdf5"]) == ["--editable", ".[ui,hdf5]"]
    words = requirements(["xacro", "dev", "docs"])
    assert words[:2] == ["--editable", ".[xacro]"]
    assert any(word.startswith("pytest>=") for word in words)
    assert any(word.startswith("mkdocs>=") for word in words)


def test_what_a_command_needs_is_installed_when_it_is_called(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    calls: list[str] = []
    names = dev(project, monkeypatch, "python3", "dev.py", install=calls.append, become=lambda *_: None)
    for words in (["identify"], ["tune"], ["demo", "--servo"]):
        names["main"](["run", *words])
    assert calls == ["", "", "ui", "", "mujoco"]
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert set(names["EXTRAS"]) <= set(main.commands)
    assert set(names["EXTRAS"].values()) <= set(settings["project"]["optional-dependencies"])
