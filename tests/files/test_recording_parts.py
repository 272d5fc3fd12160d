"""Parts of one recording by a folder or a pattern."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from dynident.files.parquet import count_rows, read_rows
from dynident.files.tables import is_divided, read_columns, recording_parts
from dynident.project.settings import LogSpec
from dynident.runtime import InputError


def written(folder: Path, sizes: tuple[int, ...] = (5, 7, 3)) -> Path:
    """Parts 8, 9 and 10 of a recording, and a note beside them."""
    folder.mkdir()
    start = 0
    for k, size in enumerate(sizes, start=8):
        t = np.arange(start, start + size) * 0.1
        pl.DataFrame({"t": t, "q": 2 * t}).write_parquet(folder / f"part{k}.parquet")
        start += size
    (folder / "notes.txt").write_text("Monday")
    return folder


def test_parts_are_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    folder = written(tmp_path / "day")
    expected = [folder / f"part{k}.parquet" for k in (8, 9, 10)]
    assert list(recording_parts(folder)) == expected
    assert list(recording_parts(folder / "part*.parquet")) == expected
    assert list(recording_parts(folder / "part?.parquet")) == expected[:2]
    assert recording_parts(expected[0]) == (expected[0],)
    assert not is_divided(expected[0])
    assert not is_divided(tmp_path)


@pytest.mark.parametrize("name", ["", "*.parquet"])
def test_a_recording_in_parts_is_read_as_one_table(tmp_path: Path, name: str) -> None:
    table = read_columns(written(tmp_path / "day") / name)
    np.testing.assert_allclose(table.column("t"), np.arange(15) * 0.1)
    assert table.column("q").shape == (15,)


def test_all_parts_together_must_fit_the_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = written(tmp_path / "day", (400, 400, 400))
    monkeypatch.setenv("DYNIDENT_MEMORY", "5e-5")
    with pytest.raises(InputError, match=r"day: 1200 rows of 2 columns would take 0.0576 MB of memory"):
        read_columns(folder, needed={"t", "q"})


def test_rows_of_a_part_keep_their_place_in_the_file(tmp_path: Path) -> None:
    path = written(tmp_path / "day", (50,)) / "part8.parquet"
    assert count_rows(path) == 50
    table = read_rows(path, {"q"}, slice(20, 30))
    np.testing.assert_allclose(table.column("q"), np.arange(20, 30) * 0.2)
    assert table.place(0) == "row 21"
    assert table.unread == ("t",)


def test_dates_go_on_from_part_to_part_over_midnight(tmp_path: Path) -> None:
    times = pl.datetime_range(pl.datetime(2024, 5, 1, 23, 59, 58), pl.datetime(2024, 5, 2, 0, 0, 3), "1s", eager=True)
    for k, part in enumerate((times[:2], times[2:])):
        pl.DataFrame({"t": part, "q": np.arange(len(part))}).write_parquet(tmp_path / f"{k}.parquet")
    found = read_columns(tmp_path).column("t")
    np.testing.assert_allclose(np.diff(found), 1.0)


def test_what_is_no_recording_in_parts_is_said(tmp_path: Path) -> None:
    folder = written(tmp_path / "day")
    with pytest.raises(InputError, match="matches no file; look at the folder and the pattern"):
        read_columns(folder / "hour*.parquet")
    with pytest.raises(InputError, match=r"matches notes\.txt, too; the parts of one recording must be Parquet"):
        read_columns(folder / "*")
    pl.DataFrame({"t": [9.0]}).write_parquet(folder / "part11.parquet")
    with pytest.raises(InputError, match=r"part11\.parquet: no column 'q'"):
        read_columns(folder)
    (folder / "part12.parquet").write_bytes(b"nothing")
    with pytest.raises(InputError, match=r"part12\.parquet: is not a readable \.parquet file"):
        count_rows(folder / "part12.parquet")


@pytest.mark.parametrize(
    ("file", "label"), [("day/*.parquet", "day"), ("day", "day"), ("day/monday.parquet", "monday")]
)
def test_a_recording_is_named_after_its_file_or_folder(file: str, label: str) -> None:
    spec = LogSpec.model_validate({"file": file}, context={"folder": "logs"})
    assert spec.label == label
    assert LogSpec.model_validate({"file": file, "name": "first"}).label == "first"
