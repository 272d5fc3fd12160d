"""Texts of XML: edits change the bytes they name, included files are joined, and macros are expanded by xacro."""

import importlib.util
import sys
from pathlib import Path

import pytest

from dynident.files import xml_text as xacro
from dynident.files.opener import refuse_inputs, watch_inputs
from dynident.files.xml_text import XmlText
from dynident.models import RigidBodies
from dynident.project.config import has_changed, load_model, robot_text
from dynident.project.project import model_source
from dynident.runtime import ConfigError, ModelError
from tests.robots import ARM_MJCF

MARKUP = """<?xml version="1.0"?>
<!-- <a b="1"> -->
<a>
    <b one = '1' two="x>y"/>
    <é name="ü"><c/></é>
    <d
       long="3" >text</d >
</a>
"""


def child(text, tag):
    return next(node for node in text.root.walk() if node.tag == tag)


def test_an_edit_leaves_the_rest():
    text = XmlText(MARKUP)
    text.drop(child(text, "b"), ("one", "none"))
    assert str(text) == MARKUP.replace(" one = '1'", "")
    text = XmlText(MARKUP.replace("\n", "\r\n"))
    text.insert(child(text, "b"), "<z/>")
    assert str(text).count("\n") == str(text).count("\r\n") == MARKUP.count("\n") + 2


DEFAULTS = ARM_MJCF[ARM_MJCF.index("<default>") : ARM_MJCF.index("<asset>")]
WRIST = ARM_MJCF[ARM_MJCF.index('<body name="wrist"') : ARM_MJCF.index("</body></body></body></worldbody>")]
MAIN = ARM_MJCF.replace(DEFAULTS, '<!-- as ever --><include file="parts/defaults.xml"/>')
MAIN = MAIN.replace(WRIST, "<include file='parts/wrist.xml'></include>")


def write(folder: Path, **files: str) -> Path:
    (folder / "parts").mkdir(exist_ok=True)
    (folder / "arm.xml").write_text(MAIN, encoding="utf-8")
    for name, text in files.items():
        (folder / "parts" / f"{name}.xml").write_text(text, encoding="utf-8")
    return folder / "arm.xml"


def test_includes_are_read_as_if_written_out(tmp_path: Path) -> None:
    """In a folder of its own, with a declaration and a comment; the rest of the text stays byte by byte."""
    wrist = f'<?xml version="1.0" encoding="utf-8"?>\n<!-- é --><mujoco model="wrist">{WRIST}</mujoco>\n'
    text = robot_text(write(tmp_path, defaults=f"<mujocoinclude>{DEFAULTS}</mujocoinclude>", wrist=wrist))
    assert text.replace("<!-- as ever -->", "") == ARM_MJCF
    assert RigidBodies(text).parameters == RigidBodies(ARM_MJCF).parameters


def test_what_is_included_is_read_and_not_replaced(tmp_path: Path) -> None:
    with watch_inputs():
        robot_text(write(tmp_path, defaults=f"<mujoco>{DEFAULTS}</mujoco>", wrist=f"<mujoco>{WRIST}</mujoco>"))
        with pytest.raises(ConfigError, match=r"wrist\.xml: would be replaced"):
            refuse_inputs(tmp_path / "parts" / "wrist.xml")


GOOD = {"defaults": f"<mujoco>{DEFAULTS}</mujoco>", "wrist": f"<mujoco>{WRIST}</mujoco>"}


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ({"wrist": "<mujoco><include file='arm.xml'/></mujoco>"}, r"arm\.xml is included twice, or includes itself"),
        ({"wrist": "<mujoco><include file='parts/defaults.xml'/></mujoco>"}, r"defaults\.xml is included twice"),
        ({"wrist": "<mujoco><include file='parts/wrist.xml'/></mujoco>"}, r"wrist\.xml is included twice"),
        ({"wrist": "<mujoco><include file='none.xml'/></mujoco>"}, r"none\.xml: cannot be read: there is no such file"),
        ({"wrist": "<mujoco/>"}, r"wrist\.xml, which it includes, has no elements"),
        ({"wrist": "<mujoco><body></mujoco>"}, r"wrist\.xml is not well-formed XML"),
        ({"wrist": "<!DOCTYPE m [<!ENTITY a 'b'>]><mujoco>&a;</mujoco>"}, r"wrist\.xml, line 1: a DOCTYPE"),
        ({"wrist": "<mujoco><include/></mujoco>"}, r"wrist\.xml: <include> needs a `file`"),
    ],
)
def test_what_cannot_be_included(tmp_path: Path, files: dict[str, str], message: str) -> None:
    with pytest.raises(ModelError, match=message):
        robot_text(write(tmp_path, **(GOOD | files)))


def test_all_together_fit_into_the_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path, **{**GOOD, "wrist": f"<mujoco>{WRIST}<!--{'x' * 20_000}--></mujoco>"})
    monkeypatch.setenv("DYNIDENT_MEMORY", "0.0017")
    with pytest.raises(ModelError, match=r"arm\.xml: with what it includes it would take"):
        robot_text(path)


def test_a_result_notices_that_an_included_file_has_changed(tmp_path: Path) -> None:
    path = write(tmp_path, **GOOD)
    kept = model_source(path)
    assert RigidBodies(kept.text).parameters == RigidBodies(ARM_MJCF).parameters
    assert not has_changed(kept)
    write(tmp_path, **{**GOOD, "wrist": f"<mujoco>{WRIST.replace('0.7', '0.8')}</mujoco>"})
    assert has_changed(kept)


DOOR = """<robot name="door" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:property name="m" value="${2 * 10}"/>
<link name="wall"/><link name="leaf"><inertial><origin xyz="0.4 0 0"/><mass value="${m}"/>
<inertia ixx="3" iyy="1" izz="4" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="hinge" type="continuous"><parent link="wall"/><child link="leaf"/><axis xyz="0 1 0"/></joint></robot>"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    file = tmp_path / "door.urdf.xacro"
    file.write_text(DOOR, encoding="utf-8")
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
    path.write_text(DOOR.replace("2 * 10", "2 * ten"), encoding="utf-8")
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
    expanded = DOOR.replace("${m}", "20").replace('<xacro:property name="m" value="${2 * 10}"/>', "")
    assert load_model(str(path), text=expanded, allow_code=False).parameters[0].value == 20.0
