"""Parquet: lists, structs, dates, and the types that hold no numbers."""

from __future__ import annotations

import datetime as dt

import numpy as np
import polars as pl
import pytest

from dynident.files.opener import set_memory
from dynident.files.tables import read_columns
from dynident.runtime import InputError

N = 4


@pytest.fixture
def file(tmp_path):
    """Columns as recorders of robot learning write them."""
    start = dt.datetime(2024, 5, 1, 12)
    frame = pl.DataFrame(
        {
            "timestamp": pl.Series(np.arange(N) * 0.05, dtype=pl.Float32),
            "observation.state": [[float(k), 2.0, None] for k in range(N)],
            "action": pl.Series([[k, -k] for k in range(N)], dtype=pl.Array(pl.Int32, 2)),
            "arm": [{"q": [0.5 * k], "hand": {"width": k / 10, "on": True}} for k in range(N)],
            "when": [start + dt.timedelta(seconds=k) for k in range(N)],
            "since": [dt.timedelta(milliseconds=5 * k) for k in range(N)],
            "iso": [f"2024-05-01T12:00:0{k}.5" for k in range(N)],
            "ragged": [[1.0] * (k + 1) for k in range(N)],
            "task": ["pick"] * N,
            "image": [b"png"] * N,
        }
    )
    frame.with_columns(zoned=pl.col("when").dt.replace_time_zone("Europe/Berlin")).write_parquet(tmp_path / "a.parquet")
    return tmp_path / "a.parquet"


def test_lists_structs_and_dates_are_columns(file):
    table = read_columns(file)
    found = {name: list(column) for name, column in table.columns.items() if name not in ("timestamp",)}
    assert found.pop("observation.state[2]") == pytest.approx([np.nan] * N, nan_ok=True)
    assert found == {
        "observation.state[0]": [0, 1, 2, 3],
        "observation.state[1]": [2, 2, 2, 2],
        "action[0]": [0, 1, 2, 3],
        "action[1]": [0, -1, -2, -3],
        "arm.q": [0, 0.5, 1, 1.5],
        "arm.hand.width": [0, 0.1, 0.2, 0.3],
        "arm.hand.on": [1, 1, 1, 1],
        "when": [43200, 43201, 43202, 43203],
        "zoned": [36000, 36001, 36002, 36003],
        "since": [0, 0.005, 0.01, 0.015],
        "iso": [43200.5, 43201.5, 43202.5, 43203.5],
    }
    assert dict(table.units) == dict.fromkeys(("when", "zoned", "since", "iso"), "s")
    assert {name: words.split(",")[0].split(";")[0] for name, words in table.faults.items()} == {
        "ragged": "holds lists of 1 or 2 or 3 elements",
        "task": "holds String",
        "image": "holds Binary",
    }


def test_only_what_is_needed_is_read(file):
    table = read_columns(file, needed={"action[1]", "since"})
    assert list(table.columns) == ["action[0]", "action[1]", "since"]
    assert "observation.state" in table.unread
    with pytest.raises(InputError, match="no column 'action\\[2\\]'; did you mean 'action"):
        table.column("action[2]")


def test_lists_count_in_the_budget(tmp_path, monkeypatch):
    path = tmp_path / "wide.parquet"  # a few kB, as all its values are equal; the first list is no measure of others
    pl.DataFrame({"q": pl.Series([[0.0]] + [[0.0] * 1000] * 999)}).write_parquet(path)
    monkeypatch.setenv("DYNIDENT_MEMORY", "0.01")
    set_memory(None)
    with pytest.raises(InputError, match="1000 rows of 1 columns would take"):
        read_columns(path)
