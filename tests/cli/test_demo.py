"""``dynident demo``: what it refuses, that its draft needs no answer; `tests/meta/test_tutorial.py` runs it whole."""

from __future__ import annotations

from pathlib import Path

import pytest

from dynident.apps.demo import demo_files
from dynident.cli.demo import LOGS
from dynident.cli.identification import draft_from_files
from dynident.project.project import parse_project
from tests.cli.commands import refuse, succeed


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return demo_files(tmp_path / "my arm")


def test_the_draft_needs_no_answer_and_leaves_tilt_and_terms_to_the_data(folder: Path) -> None:
    draft, tables = draft_from_files(str(folder / "arm.urdf"), [str(folder / name) for name in LOGS], folder)
    assert [*draft.questions, *draft.blanks, *draft.notes, *(note for table in tables for note in table.notes)] == []
    project = parse_project(draft.text + (folder / "controller.yaml").read_text(), folder / "robot.yaml")
    logs, warnings = project.logs()
    assert (project.recipe.base_tilt, project.recipe.terms) == ("estimate", "auto")
    assert (*warnings, *project.warnings, *project.model.notes) == ()
    assert [len(log) for log in (*logs["train"].values(), *logs["validation"].values())] == [5000, 3750]
    assert all(log.controller is not None for log in logs["train"].values())


@pytest.mark.parametrize(("name", "text"), [("robot.yaml", "model: mine.urdf\n"), ("arm.urdf", "<robot name='mine'/>")])
def test_a_file_of_the_user_is_not_replaced(folder: Path, name: str, text: str) -> None:
    (folder / name).write_text(text)
    refuse("demo", "--out", folder, says=f"{name}: exists already")
    assert (folder / name).read_text() == text
    assert not (folder / "result").exists()


def test_the_files_alone_can_be_had(tmp_path: Path) -> None:
    succeed("demo", "--files", "--out", tmp_path / "my arm")
    assert {*LOGS, "arm.urdf", "controller.yaml", "meshes"} == {path.name for path in (tmp_path / "my arm").iterdir()}
