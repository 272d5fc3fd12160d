"""The footer of Parquet files: the values of each column, whatever the writer; damage is an error."""

from __future__ import annotations

from io import BytesIO

import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynident.files.parquet import value_counts


def written(frame, **options):
    file = BytesIO()
    frame.write_parquet(file, **options)
    return file.getvalue()


@given(st.lists(st.lists(st.floats(allow_nan=False), min_size=1), min_size=1), st.integers(1, 5))
def test_values_of_all_row_groups_are_counted(lists, rows):
    frame = pl.DataFrame({"q": lists, "arm": [{"q": one, "t": 0.0} for one in lists]})
    counts = value_counts(written(frame, row_group_size=rows))
    total = sum(map(len, lists))
    assert {path[:-2] if path[-1] != "t" else path: count for path, count in counts.items()} == {
        ("q",): total,
        ("arm", "q"): total,
        ("arm", "t"): len(lists),
    }


def test_damage_is_an_error():
    data = written(pl.DataFrame({"q": [[1.0, 2.0]], "name": ["a"]}))
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


def test_a_number_of_values_below_zero_counts_as_none():
    """A list of row groups, with one of columns, whose numbers of values are -5 and 7."""
    columns = b"".join(bytes([0x3C, 0x39, 0x18, 1, name, 0x26, zigzag, 0, 0]) for name, zigzag in ((113, 9), (116, 14)))
    footer = bytes([0x49, 0x1C, 0x19, 0x2C]) + columns + bytes([0, 0])
    counts = value_counts(b"PAR1" + footer + len(footer).to_bytes(4, "little") + b"PAR1")
    assert counts == {("q",): 0, ("t",): 7}
