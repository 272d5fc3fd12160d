"""The rows of a study in its file: added as they come, whole in the end, and found again after a crash."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import polars as pl
import pytest

from dynident.errors import InputError
from dynident.studies import Outcome
from dynident.studies import table as table_module
from dynident.studies.table import HEAD, StudyTable, beside


def row(run: int, status: Outcome = Outcome.OK) -> dict[str, Any]:
    key = {"scenario": "s", "method": "m", "level": 1e-6, "run": run, "seed": 0, "version": "1"}
    numbers = {"value": [0.1 * run, -3.0], "std": [float("inf"), float("nan")], "interval": []}
    return key | {"status": status.value, "reason": "no \u00e4 reason", "seconds": 0.25} | numbers


@pytest.fixture
def path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file to which rows are added at once."""
    monkeypatch.setattr(table_module, "SAVE_EVERY", -1.0)
    return tmp_path / "study.parquet"


def killed(path: Path, *runs: int) -> list[dict[str, Any]]:
    """Add rows and stop without an end."""
    table = StudyTable(path)
    for run in runs:
        table.add([row(run)])
    assert table._text is not None
    table._text.close()
    return table.rows


def test_rows_are_added_to_a_text_and_the_end_writes_the_table(path: Path) -> None:
    with StudyTable(path) as table:
        for run in range(3):
            table.add([row(run)])
            assert beside(path).read_text().count("\n") == run + 2
            assert not path.exists()
    assert [one.name for one in path.parent.iterdir()] == [path.name]
    assert repr(StudyTable(path).rows) == repr([row(run) for run in range(3)])


def test_an_error_is_an_end_as_well(path: Path) -> None:
    def stopped() -> None:
        with StudyTable(path) as table:
            table.add([row(0)])
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stopped()
    assert pl.read_parquet(path)["run"].to_list() == [0]


def test_nothing_is_written_more_than_once(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Before the end each row goes to the disk alone, however many there are."""
    monkeypatch.setattr(table_module, "write_table", lambda *_: pytest.fail("the table was written again"))
    killed(path, *range(50))
    sizes = {len(line) for line in beside(path).read_text().splitlines()[1:]}
    assert beside(path).stat().st_size < 60 * max(sizes)


def test_a_killed_run_loses_at_most_a_line_that_was_cut(path: Path) -> None:
    with StudyTable(path) as table:
        table.add([row(0)])
    known = killed(path, 1, 2, 3)
    text = beside(path).read_bytes()
    assert repr(StudyTable(path).rows) == repr(known) == repr([row(run) for run in range(4)])
    for cut in range(len(text) - 2, len(text) - 40, -7):
        beside(path).write_bytes(text[:cut])
        assert [one["run"] for one in StudyTable(path).rows] == [0, 1, 2]
    with StudyTable(path) as table:  # what is added next is not glued to it
        table.add([row(4)])
        assert pl.read_parquet(path)["run"].to_list() == [0, 1, 2, 4]
        assert not table._new
    assert [one["run"] for one in StudyTable(path).rows] == [0, 1, 2, 4]


def test_a_run_that_was_killed_between_table_and_text_has_no_fit_twice(path: Path) -> None:
    killed(path, 0, 1)
    text = beside(path).read_bytes()
    with StudyTable(path) as table:
        table.add([row(2)])
    beside(path).write_bytes(text)
    assert [one["run"] for one in StudyTable(path).rows] == [0, 1, 2]


@pytest.mark.parametrize("head", [b"", HEAD.encode()[:9], HEAD.encode() + b"\n"])
def test_a_text_without_rows_is_empty(path: Path, head: bytes) -> None:
    beside(path).write_bytes(head)
    assert StudyTable(path).rows == []


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("mine\n", "begins otherwise"),
        ("mine", "begins otherwise"),
        (f"{HEAD}\nmine\n", "holds no rows"),
        (f"{HEAD}\n[1]\n", "rows"),
        (f'{HEAD}\n{{"run": "first"}}\n', "rows"),
        (f"{HEAD}\n{{}}\n", "empty cells"),
    ],
)
def test_a_text_of_something_else_is_refused_and_stays(path: Path, text: str, words: str) -> None:
    beside(path).write_text(text)
    with pytest.raises(InputError, match=words):
        StudyTable(path)
    assert beside(path).read_text() == text


def test_failed_fits_are_tried_again(path: Path) -> None:
    with StudyTable(path) as table:
        table.add([row(0, Outcome.FAILED), row(1)])
    killed(path, 0)
    assert [one["run"] for one in StudyTable(path).rows] == [1, 0]
