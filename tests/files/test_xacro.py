"""Files with macros: expanded by xacro where it is installed, else refused with what to do."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

from dynident.files import xml_text as xacro
from dynident.models import RigidBodies
from dynident.project.config import load_model, robot_text
from dynident.runtime import ModelError

TEXT = """<robot name="door" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:property name="m" value="${2 * 10}"/>
<link name="wall"/><link name="leaf"><inertial><origin xyz="0.4 0 0"/><mass value="${m}"/>
<inertia ixx="3" iyy="1" izz="4" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="hinge" type="continuous"><parent link="wall"/><child link="leaf"/><axis xyz="0 1 0"/></joint></robot>"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "door.urdf.xacro"
    file.write_text(TEXT, encoding="utf-8")
    return file


def program(folder: Path, monkeypatch: pytest.MonkeyPatch, lines: str) -> None:
    """Stand a program of these lines of Python in for xacro."""
    script = folder / "stand_in.py"
    script.write_text("import sys, time\n" + lines, encoding="utf-8")
    monkeypatch.setattr(xacro, "_program", lambda _: [sys.executable, str(script)])


@pytest.mark.skipif(importlib.util.find_spec("xacro") is None, reason="xacro is not installed: python3 dev.py robots")
def test_xacro_expands_its_files(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert RigidBodies(robot_text(path)).parameters[0].value == 20.0
    monkeypatch.setattr(xacro.shutil, "which", lambda _: None)  # by the package
    assert RigidBodies(robot_text(path)).parameters[0].value == 20.0
    path.write_text(TEXT.replace("2 * 10", "2 * ten"), encoding="utf-8")
    with pytest.raises(ModelError, match=r"door\.urdf\.xacro: xacro cannot expand it: .*'ten' is not defined"):
        robot_text(path)


def test_where_xacro_is_missing_it_is_said_how_to_go_on(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(xacro.shutil, "which", lambda _: None)
    plain = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "xacro" else plain(name))
    with pytest.raises(ModelError, match=r"needs xacro, which is not installed.*> robot\.urdf.*-m pip install xacro$"):
        robot_text(path)


def test_its_argument_is_the_file_alone(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program(tmp_path, monkeypatch, "print(sys.argv[1:], sys.stdin.read())")
    assert robot_text(path).strip() == f"{[str(path)]!r}"


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ("sys.exit('no \\x1b[31mway')", "xacro cannot expand it: no  .31mway"),
        ("sys.exit(3)", "it ends with code 3"),
        ("sys.stdout.buffer.write(b'\\xff')", "is not a UTF-8 text"),
        ("time.sleep(30)", "was stopped after 0.3 s"),
        ("while True: print('x' * 100000)", "more of it than the .* of memory that a file may take.*--memory"),
        ("x = [0] * 10**9", "more of it than the .* of memory that a file may take.*--memory"),
    ],
)
def test_a_program_that_fails(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lines: str, message: str
) -> None:
    monkeypatch.setattr(xacro, "MAX_DURATION", 0.3 if "sleep" in lines else 20.0)
    monkeypatch.setenv("DYNIDENT_MEMORY", "0.1")
    program(tmp_path, monkeypatch, lines)
    with pytest.raises(ModelError, match=message):
        robot_text(path)


def test_a_program_may_take_the_memory_that_a_file_may(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside what it needs itself."""
    program(tmp_path, monkeypatch, "x = bytearray(150_000_000)\nprint('<robot/>')")
    monkeypatch.setenv("DYNIDENT_MEMORY", "0.1")
    assert robot_text(path).strip() == "<robot/>"


def test_a_result_runs_no_macros(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program(path.parent, monkeypatch, "sys.exit('ran')")
    with pytest.raises(ModelError, match=r"a xacro file, which a result does not run; .*allow_code"):
        load_model(str(path), allow_code=False)
    with pytest.raises(ModelError, match="ran"):
        load_model(str(path))
    expanded = TEXT.replace("${m}", "20").replace('<xacro:property name="m" value="${2 * 10}"/>', "")
    assert load_model(str(path), text=expanded, allow_code=False).parameters[0].value == 20.0


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match=r"gone\.xacro: cannot be read: there is no such file"):
        robot_text(tmp_path / "gone.xacro")
