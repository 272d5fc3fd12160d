"""Dates and times as seconds since the first midnight."""

import datetime as dt

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynident.files.stamps import is_stamp, parse_stamps, seconds

NOON = 12 * 3600.0


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("2024-05-01T12:00:00", NOON),
        ("2024-05-01 12:00", NOON),
        ("12:00:00.25", NOON + 0.25),
        ("31.05.2024 12:00:00,25", NOON + 0.25),
        ("2024/05/01 12:00:00.5", NOON + 0.5),
        ("2024-05-01T12:00:00,123456789", NOON + 0.123456789),
        ("2024-05-01T12:00:00.1234567891Z", NOON + 0.123456789),
        ("2024-05-01 12:00:00+02:00", NOON - 7200),
        ("2024-05-01T12:00:00-0530", NOON + 5.5 * 3600),
        ("2024-05-01 12:00:00 UTC", NOON),
        ("2024-02-29t23:59:59z", 86399.0),
    ],
)
def test_texts_are_read(text, expected):
    assert is_stamp(text)
    assert parse_stamps(pl.Series([text])) == pytest.approx([expected], abs=1e-10)


@pytest.mark.parametrize(
    "texts",
    [["2024-05-01"], ["12:00"], ["24:00:00"], ["12:00:00Z"], ["2024-13-01T00:00:00"],
     ["2023-02-29 10:00"], ["05/31/2024 10:00"], ["31.02.2024 10:00"],
     ["2024-05-01T25:00:00"], ["now"], ["12:00:00", "2024-05-01T12:00:00"], ["2024-05-01T12:00:00", "12"],
     ["2024-05-01T12:00:00Z", "2024-05-01T12:00:01"], [None], []],
)  # fmt: skip
def test_other_texts_are_not(texts):
    assert parse_stamps(pl.Series(texts, dtype=pl.String)) is None


@given(
    st.lists(st.datetimes(dt.datetime(1900, 1, 1), dt.datetime(2200, 1, 1)), min_size=1),
    st.sampled_from(["T", " "]),
    st.integers(-14 * 60, 14 * 60),
)
def test_texts_are_as_the_standard_library_has_them(moments, between, minutes):
    zone = dt.timezone(dt.timedelta(minutes=minutes))
    aware = [moment.replace(tzinfo=zone) for moment in moments]
    first = aware[0].astimezone(dt.UTC).replace(hour=0, minute=0, second=0, microsecond=0)
    expected = [(moment - first).total_seconds() for moment in aware]
    texts = pl.Series([moment.isoformat(between) for moment in aware])
    np.testing.assert_allclose(parse_stamps(texts), expected, rtol=1e-15, atol=1e-9)
    assert all(map(is_stamp, texts))
    typed = pl.Series(aware).cast(pl.Datetime("us", "UTC"))
    np.testing.assert_allclose(seconds(typed), expected, rtol=1e-15, atol=1e-9)


def test_missing_stamps_are_nan():
    for text in ("2024-05-01T00:00:01", "00:00:01"):
        np.testing.assert_array_equal(parse_stamps(pl.Series([None, text])), [np.nan, 1.0])
    days = pl.Series([None, dt.date(2024, 5, 1), dt.date(2024, 5, 3)])
    np.testing.assert_array_equal(seconds(days), [np.nan, 0.0, 2 * 86400.0])


@pytest.mark.parametrize("unit", ["ms", "us", "ns"])
def test_types_of_any_resolution(unit):
    moments = pl.Series([dt.datetime(2024, 5, 1, 12, 0, 0, 250_000)]).cast(pl.Datetime(unit))
    assert seconds(moments).tolist() == [NOON + 0.25]
    assert seconds(
        pl.Series([dt.timedelta(hours=1, milliseconds=2)]).cast(pl.Duration(unit))
    ).tolist() == pytest.approx([3600.002], rel=1e-15)
    assert seconds(pl.Series([dt.time(12, 0, 0, 500)])).tolist() == [NOON + 0.0005]
