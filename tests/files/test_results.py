"""Results are written whole or not at all."""

import json
import os
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from dynident.files.results import probe_folder, read_table, write_json, write_table, write_text
from dynident.runtime import InputError


def test_json_keeps_values_and_turns_non_finite_numbers_to_null(tmp_path):
    data = {"a": np.float64("nan"), "b": [np.inf, 1.5], 3: np.array([[1, 2]]), "p": Path("x"), "ok": np.bool_(True)}
    path = write_json(tmp_path / "r.json", data)
    assert json.loads(path.read_text()) == {"a": None, "b": [None, 1.5], "3": [[1, 2]], "p": "x", "ok": True}


@pytest.mark.parametrize("name", ["t.parquet", "t.csv"])
def test_a_table_comes_back(tmp_path, name):
    frame = pl.DataFrame({"run": range(300), "error": [1] * 299 + [0.1 + 0.2]}, strict=False)
    assert read_table(write_table(tmp_path / name, frame)).equals(frame)


@pytest.mark.parametrize("place", ["file/r.txt", "folder", ""])
def test_a_place_that_cannot_hold_the_file_is_an_input_error(tmp_path, place):
    (tmp_path / "file").write_text("x")
    (tmp_path / "folder").mkdir()
    with pytest.raises(InputError, match="cannot be written"):
        write_text(tmp_path / place, "x")
    assert sorted(os.listdir(tmp_path)) == ["file", "folder"]


def test_other_extensions_are_refused_with_the_choices(tmp_path):
    with pytest.raises(InputError, match=r"'\.xlsx'.*'\.parquet', '\.csv'"):
        write_table(tmp_path / "t.xlsx", pl.DataFrame({"a": [1]}))


@pytest.mark.parametrize(("name", "data"), [("t.parquet", b"PAR1 no table"), ("t.csv", b""), ("t.csv", b"a\n1,2\n")])
def test_a_damaged_table_is_an_input_error(tmp_path, name, data):
    (tmp_path / name).write_bytes(data)
    with pytest.raises(InputError, match="not a readable table"):
        read_table(tmp_path / name)


def test_a_folder_is_probed_without_a_trace(tmp_path):
    probe_folder(tmp_path / "deep" / "out")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "there").mkdir()
    probe_folder(tmp_path / "there")
    assert list((tmp_path / "there").iterdir()) == []
    (tmp_path / "taken").write_text("mine")
    with pytest.raises(InputError, match=r"taken.*nothing can be written here"):
        probe_folder(tmp_path / "taken")
