"""Parquet: lists, structs and dates; its footer, whatever the writer; parts of one recording by folder or pattern."""

import datetime as dt
from io import BytesIO
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from dynident.files.opener import set_memory
from dynident.files.parquet import count_rows, value_counts
from dynident.files.tables import is_divided, read_columns, recording_parts
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
    result = {name: list(column) for name, column in table.columns.items() if name not in ("timestamp",)}
    assert result.pop("observation.state[2]") == pytest.approx([np.nan] * N, nan_ok=True)
    assert result == {
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


def parquet_bytes(frame, **options):
    file = BytesIO()
    frame.write_parquet(file, **options)
    return file.getvalue()


def test_damage_is_an_error():
    data = parquet_bytes(pl.DataFrame({"q": [[1.0, 2.0]], "name": ["a"]}))
    size = int.from_bytes(data[-8:-4], "little")
    for k in range(size):
        footer = data[-8 - size : -8]
        wrong = data[: -8 - size] + footer[:k] + b"\xff" + footer[k + 1 :] + data[-8:]
        try:
            value_counts(wrong)
        except (ValueError, IndexError, KeyError, TypeError, AttributeError):
            continue
    with pytest.raises(ValueError, match="footer"):
        value_counts(b"PAR1 nothing PAR1")
    with pytest.raises((ValueError, IndexError, KeyError)):
        value_counts(data[: -8 - size] + b"\x1c" * size + data[-8:])


@pytest.mark.parametrize("place", [7, 10, 14], ids=["unpacked size", "packed size", "values"])
def test_a_page_with_an_impossible_size_or_count_is_refused(tmp_path, place):
    """Polars would allocate as much, and end the process."""
    path = tmp_path / "a.parquet"
    pl.DataFrame({"t": np.arange(50.0)}).write_parquet(path)
    data = path.read_bytes()
    assert data[4:7] == b"\x15\x00\x15"  # the head of the page: its kind, then its sizes and the number of values
    assert len(read_columns(path).column("t")) == 50
    path.write_bytes(data[:place] + bytes([data[place] | 1]) + data[place + 1 :])  # odd numbers stand for negative ones
    with pytest.raises(InputError, match="page with a damaged head, at byte 4"):
        read_columns(path)


def test_a_number_of_values_below_zero_counts_as_none():
    """A list of row groups, with one of columns, whose numbers of values are -5 and 7."""
    columns = b"".join(bytes([0x3C, 0x39, 0x18, 1, name, 0x26, zigzag, 0, 0]) for name, zigzag in ((113, 9), (116, 14)))
    footer = bytes([0x49, 0x1C, 0x19, 0x2C]) + columns + bytes([0, 0])
    counts = value_counts(b"PAR1" + footer + len(footer).to_bytes(4, "little") + b"PAR1")
    assert counts == {("q",): 0, ("t",): 7}


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


def test_all_parts_together_must_fit_the_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = written(tmp_path / "day", (400, 400, 400))
    monkeypatch.setenv("DYNIDENT_MEMORY", "5e-5")
    with pytest.raises(InputError, match=r"day: 1200 rows of 2 columns would take 0.0576 MB of memory"):
        read_columns(folder, needed={"t", "q"})


def test_dates_go_on_from_part_to_part_over_midnight(tmp_path: Path) -> None:
    times = pl.datetime_range(pl.datetime(2024, 5, 1, 23, 59, 58), pl.datetime(2024, 5, 2, 0, 0, 3), "1s", eager=True)
    for k, part in enumerate((times[:2], times[2:])):
        pl.DataFrame({"t": part, "q": np.arange(len(part))}).write_parquet(tmp_path / f"{k}.parquet")
    result = read_columns(tmp_path).column("t")
    np.testing.assert_allclose(np.diff(result), 1.0)


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
