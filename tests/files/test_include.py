"""Included files: one model of several texts, joined as MuJoCo joins them."""

from __future__ import annotations

from pathlib import Path

import pytest

from dynident.files.opener import refuse_inputs, watch_inputs
from dynident.files.xml_text import with_includes
from dynident.models import RigidBodies
from dynident.project.config import has_changed, robot_text
from dynident.project.project import model_source
from dynident.runtime import ConfigError, ModelError
from tests.robots import ARM_MJCF

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


def test_an_included_file_may_include_others_beside_itself(tmp_path: Path) -> None:
    path = write(
        tmp_path, defaults='<mujoco><include file="inner.xml"/></mujoco>', inner=f"<mujoco>{DEFAULTS}</mujoco>",
        wrist=f"<mujoco>{WRIST}</mujoco>",
    )  # fmt: skip
    assert robot_text(path).replace("<!-- as ever -->", "") == ARM_MJCF


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


def test_a_text_without_includes_is_not_looked_at(tmp_path: Path) -> None:
    assert with_includes("no <XML", tmp_path / "x.urdf") == "no <XML"


def test_a_result_notices_that_an_included_file_has_changed(tmp_path: Path) -> None:
    path = write(tmp_path, **GOOD)
    kept = model_source(path)
    assert RigidBodies(kept.text).parameters == RigidBodies(ARM_MJCF).parameters
    assert not has_changed(kept)
    write(tmp_path, **{**GOOD, "wrist": f"<mujoco>{WRIST.replace('0.7', '0.8')}</mujoco>"})
    assert has_changed(kept)
