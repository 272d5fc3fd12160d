"""What is published: its content, the Pythons it is tried on, and what is said of those that are not there."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import yaml

from dynident._version import __version__

ROOT = Path(__file__).parents[2]
VERSIONS = ["3.11", "3.12", "3.13"]


@pytest.fixture
def release(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The module tools/release.py, which finds no Python but those that a test makes."""
    spec = importlib.util.spec_from_file_location("release", ROOT / "tools" / "release.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(module.sys, "_base_executable", "/nowhere", raising=False)
    monkeypatch.setenv("PATH", "/nowhere")
    monkeypatch.setenv("PYENV_ROOT", "/nowhere")
    return module


def stand_in(path: Path, lines: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"#!/bin/sh\n{lines}\n")
    path.chmod(0o755)
    return path


@pytest.mark.skipif(not (ROOT / ".git").exists(), reason="no checkout: what belongs to the project is not known")
@pytest.mark.skipif(importlib.util.find_spec("hatchling") is None, reason="hatchling, which builds, is missing")
def test_what_is_built_is_the_project(release: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.undo()
    listed = ["git", "ls-files", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(listed, cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines()
    known = {name for name in names if (ROOT / name).is_file()}
    sdist, wheel = release.build(tmp_path)
    assert list(release.sdist_faults(release.contents(sdist), known)) == []
    assert list(release.wheel_faults(release.contents(wheel), known, __version__)) == []
    assert list(release.metadata_faults(wheel, __version__)) == []


def test_a_wheel_with_a_gap_or_with_more_is_noticed(release: ModuleType) -> None:
    about = "dynident-1.0.dist-info"
    known = {"src/dynident/a.py", "src/dynident/apps/demo/b.parquet", "tests/c.py", "LICENSE"}
    data = {"dynident/py.typed": 0, "dynident/report/templates/page.html": 9}
    right = {
        "dynident/a.py": 1,
        "dynident/apps/demo/b.parquet": 2,
        f"{about}/METADATA": 3,
        f"{about}/licenses/LICENSE": 4,
    }
    known |= {f"src/{name}" for name in data}

    def faults(**changes: int) -> list[str]:
        return list(release.wheel_faults({**data, **right, **changes}, known, "1.0"))

    assert faults() == []
    assert faults(**{"dynident/_core.so": 5}) == []
    assert faults(**{"tests/c.py": 1}) == ["tests/c.py does not belong there"]
    assert faults(**{"dynident/a.py": 2_000_000}) == ["dynident/a.py has 2.0 MB"]
    for name in (*data, *right):
        files = {one: size for one, size in {**data, **right}.items() if one != name}
        assert f"{name} is missing" in release.wheel_faults(files, known, "1.0")


def test_a_source_distribution_is_what_git_knows(release: ModuleType) -> None:
    files = {"PKG-INFO": 1, "a.py": 1, "notes.txt": 1}
    assert list(release.sdist_faults(files, {"a.py", "b.py"})) == ["b.py is missing", "notes.txt is not known to git"]


@pytest.mark.skipif(sys.platform == "win32", reason="Pythons are stood in for by shell scripts")
@pytest.mark.parametrize("place", ["path", "pyenv", "uv"])
def test_a_python_is_found(release: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str) -> None:
    names = {"path": "bin/python3.12", "pyenv": "pyenv/versions/3.12.1/bin/python", "uv": "uv-python"}
    path = stand_in(tmp_path / names[place], "echo 3.12")
    stand_in(tmp_path / "bin" / "python3.11", "echo 3.9")  # not what its name says
    stand_in(tmp_path / "bin" / "python3.13", "exit 127")  # a shim of a version that is not chosen
    if place == "uv":
        stand_in(tmp_path / "bin" / "uv", f'[ "$4" = 3.12 ] && echo {path}')
    monkeypatch.setenv("PATH", str(tmp_path / "bin"))
    monkeypatch.setenv("PYENV_ROOT", str(tmp_path / "pyenv"))
    assert [release.python(version) for version in VERSIONS] == [None, str(path), None]


def test_a_python_that_is_missing_is_said(
    release: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(release, "output", lambda *words, **_: "")
    rows: list[dict[str, str]] = [row for version in VERSIONS for row in release.tried(version, Path("x"), "1.0")]
    assert release.table(rows).splitlines()[1:] == [f"{version}    not found" for version in VERSIONS]
    release.end([], rows, [])
    assert "not on this machine: Python 3.11, 3.12, 3.13." in capsys.readouterr().out
    with pytest.raises(SystemExit, match=r"Wrong:\nPython 3\.12: not found$"):
        release.end([], rows, ["3.12"])


def test_a_command_that_fails_fails_the_release(
    release: ModuleType, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def output(*words: Any, **_: object) -> str:
        if "install" in words:
            raise release.CommandError("no such package")
        return ""

    monkeypatch.setattr(release, "output", output)
    monkeypatch.setattr(release, "python", lambda version: "python")
    rows = list(release.tried("3.12", Path("x"), "1.0"))
    assert [row["result"] for row in rows] == ["FAILED", "FAILED"]
    assert "no such package" in capsys.readouterr().err
    with pytest.raises(SystemExit, match=r"Python 3\.12, wheel: see above"):
        release.end([], rows, [])


def test_the_versions_are_those_of_the_project(release: ModuleType) -> None:
    assert release.supported() == VERSIONS
    with pytest.raises(SystemExit, match=r"Python 3\.9: not among those"):
        release.main(["3.9"])


def test_the_workflow_tries_every_version() -> None:
    (job,) = yaml.safe_load((ROOT / ".github" / "workflows" / "wheel.yml").read_text(encoding="utf-8"))["jobs"].values()
    setup, command = (next(step for step in job["steps"] if key in step) for key in ("with", "run"))
    assert setup["with"]["python-version"].split() == VERSIONS
    assert command["run"].split()[2:] == ["release", *VERSIONS]


def test_the_release_has_one_date_and_a_summary() -> None:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    found = re.search(rf"^## \[{re.escape(__version__)}\] - (\S+)\n\n(.)", text, re.MULTILINE)
    assert found is not None
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    if found[1] != "unreleased":
        assert found[1] == str(citation["date-released"])
        assert found[2].isalpha()  # a paragraph, before the lists
