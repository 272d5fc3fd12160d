"""The rows of a study in its file: found again after a crash, and those that an older version left in a text."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from dynident.errors import InputError
from dynident.studies import Outcome
from dynident.studies.table import HEAD, KEY, beside, study_table


def row(run: int, status: Outcome = Outcome.OK) -> dict[str, Any]:
    key = {"scenario": "s", "method": "m", "level": 1e-6, "run": run, "seed": 0, "version": "1"}
    numbers = {"value": [0.1 * run, -3.0], "std": [float("inf"), float("nan")], "interval": []}
    return key | {"status": status.value, "reason": "no ä reason", "seconds": 0.25} | numbers


def key(run: int) -> tuple[Any, ...]:
    return tuple(row(run)[name] for name in KEY)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "study.parquet"


def text(*rows: dict[str, Any]) -> bytes:
    return "".join(f"{line}\n" for line in (HEAD, *map(json.dumps, rows))).encode()


def known(path: Path) -> list[int]:
    with study_table(path) as table:
        return sorted(run for run in range(10) if key(run) in table)


def test_a_table_comes_back(path: Path) -> None:
    with study_table(path) as table:
        table.add([row(run) for run in range(3)])
    assert repr(pl.read_parquet(path).to_dicts()) == repr([row(run) for run in range(3)])
    assert [one.name for one in path.parent.iterdir()] == [path.name]
    assert known(path) == [0, 1, 2]


def test_what_gave_nothing_is_tried_again(path: Path) -> None:
    outcomes = list(Outcome)
    with study_table(path) as table:
        table.add([row(run, outcome) for run, outcome in enumerate(outcomes)])
    found = {outcomes[run] for run in known(path)}
    assert found == {Outcome.OK, Outcome.NOTED, Outcome.UNSETTLED}
    assert len(pl.read_parquet(path)) == len(outcomes)


def test_with_rerun_nothing_is_known(path: Path) -> None:
    beside(path).write_bytes(text(row(0), row(1)))
    with study_table(path, rerun=True) as table:
        assert len(table) == 0
        table.add([row(1) | {"value": [7.0]}])
    assert dict(pl.read_parquet(path)["run", "value"].iter_rows()) == {0: [0.0, -3.0], 1: [7.0]}


def test_the_text_of_an_older_version_is_taken_over(path: Path) -> None:
    """All but a last line that was cut."""
    with study_table(path) as table:
        table.add([row(0), row(1)])
    whole = text(row(1), row(2), row(3))
    for cut, last in ((1, 2), (9, 2), (0, 3)):
        beside(path).write_bytes(whole[: len(whole) - cut])
        assert known(path) == list(range(last + 1))
        assert not beside(path).exists()
    assert sorted(pl.read_parquet(path)["run"]) == [0, 1, 2, 3]
    assert repr(pl.read_parquet(path).sort("run").to_dicts()) == repr([row(run) for run in range(4)])


@pytest.mark.parametrize("head", [b"", HEAD.encode()[:9], HEAD.encode() + b"\n"])
def test_a_text_without_rows_is_empty(path: Path, head: bytes) -> None:
    beside(path).write_bytes(head)
    assert known(path) == []


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
        known(path)
    assert beside(path).read_text() == text
    assert not path.exists()
