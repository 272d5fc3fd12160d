"""``dynident demo``: what it refuses, and its files alone; `tests/meta/test_tutorial.py` runs it whole."""

from pathlib import Path

import pytest

from dynident.apps.demo import demo_files
from dynident.cli.demo import LOGS
from tests.cli.commands import refuse, succeed


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return demo_files(tmp_path / "my arm")


@pytest.mark.parametrize(("name", "text"), [("robot.yaml", "model: mine.urdf\n"), ("arm.urdf", "<robot name='mine'/>")])
def test_a_file_of_the_user_is_not_replaced(folder: Path, name: str, text: str) -> None:
    (folder / name).write_text(text)
    refuse("demo", "--out", folder, says=f"{name}: exists already")
    assert (folder / name).read_text() == text
    assert not (folder / "result").exists()


def test_the_files_alone_can_be_had(tmp_path: Path) -> None:
    succeed("demo", "--files", "--out", tmp_path / "my arm")
    assert {*LOGS, "arm.urdf", "controller.yaml", "meshes"} == {path.name for path in (tmp_path / "my arm").iterdir()}
