"""The rows of a study in its file: found again, tried again, and computed anew."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import polars as pl
import pytest

from dynident.apps.article import FitOutcome
from dynident.apps.article.study import KEY, study_table


def row(run: int, status: FitOutcome = FitOutcome.OK) -> dict[str, Any]:
    key = {"scenario": "s", "method": "m", "level": 1e-6, "run": run, "seed": 0, "version": "1"}
    numbers = {"value": [0.1 * run, -3.0], "std": [float("inf"), float("nan")], "interval": []}
    return key | {"status": status.value, "reason": "no ä reason", "seconds": 0.25} | numbers


def key(run: int) -> tuple[Any, ...]:
    return tuple(row(run)[name] for name in KEY)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "study.parquet"


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
    outcomes = list(FitOutcome)
    with study_table(path) as table:
        table.add([row(run, outcome) for run, outcome in enumerate(outcomes)])
    found = {outcomes[run] for run in known(path)}
    assert found == {FitOutcome.OK, FitOutcome.NOTED, FitOutcome.UNSETTLED}
    assert len(pl.read_parquet(path)) == len(outcomes)


def test_with_rerun_nothing_is_known(path: Path) -> None:
    with study_table(path) as table:
        table.add([row(0), row(1)])
    with study_table(path, rerun=True) as table:
        assert len(table) == 0
        table.add([row(1) | {"value": [7.0]}])
    assert dict(pl.read_parquet(path)["run", "value"].iter_rows()) == {0: [0.0, -3.0], 1: [7.0]}
