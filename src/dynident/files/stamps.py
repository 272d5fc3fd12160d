"""Seconds of texts and column types that are dates, times of day or durations."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from dynident.files.tables import DAY
from dynident.runtime.arrays import Array

if TYPE_CHECKING:
    import polars as pl

_STAMP = (
    r"^(?P<date>\d{4}[-/]\d{2}[-/]\d{2}|\d{2}\.\d{2}\.\d{4})[Tt ]\s*"
    r"(?P<h>[01]\d|2[0-3]):(?P<m>[0-5]\d)(:(?P<s>[0-5]\d|60)([.,](?P<f>\d+))?)?"
    r"\s*(?P<zone>Z|z|UTC|(?P<sign>[+-])(?P<zh>\d{2}):?(?P<zm>[0-5]\d)?)?$"
)
_FRACTION_UNITS = {"n": 1e-9, "nano": 1e-9, "u": 1e-6, "micro": 1e-6}  # s
_FRACTION = re.compile(rf"(?P<stem>|.*[\W_])(?P<unit>{'|'.join(_FRACTION_UNITS)})(?P<seconds>secs?)")
_TIME_OF_DAY = r"^\d{2}:\d{2}:\d{2}([.,]\d+)?$"


def is_stamp(text: str) -> bool:
    """Return whether a text is a date with a time of day, or a time of day with its seconds."""
    return re.match(_STAMP, text) is not None or re.match(_TIME_OF_DAY, text) is not None


def iso_stamp(text: str) -> str:
    """Return a stamp as ISO 8601 has it: a time of day on the first day of 1970, a date with points turned round."""
    if re.match(_TIME_OF_DAY, text):
        return f"1970-01-01T{text}"
    return re.sub(r"^(\d{2})\.(\d{2})\.(\d{4})", r"\3-\2-\1", text)


def parse_stamps(cells: pl.Series) -> Array | None:
    """Return the seconds of texts such as ``2024-05-01T12:00:00.25+02:00`` or ``12:00:00``; None unless all are alike.

    Null becomes nan. The seconds may be missing or have fractions after a point or a comma, and the T may be a
    blank. Either all texts have a zone, or none has.
    """
    import polars as pl

    texts = cells.drop_nulls()
    if texts.str.contains(_TIME_OF_DAY).all():
        cells = "1970-01-01T" + cells
        texts = cells.drop_nulls()
    if not len(texts) or not texts.str.contains(_STAMP).all():
        return None
    parts = cells.to_frame("x").select(pl.col("x").str.extract_groups(_STAMP)).unnest("x")
    # with a mixture of texts with and without a zone, no common time is known
    if 0 < parts["zone"].null_count() - cells.null_count() < len(texts):
        return None
    date = parts["date"].str.replace_all("/", "-").str.to_date("%Y-%m-%d", strict=False)
    date = date.fill_null(parts["date"].str.to_date("%d.%m.%Y", strict=False))
    # a day that does not exist, such as February 30
    if date.null_count() > cells.null_count():
        return None
    # missing parts of a time are zero
    number = {key: parts[key].cast(pl.Int64).fill_null(0) for key in ("h", "m", "s", "zh", "zm")}
    sign = pl.select(pl.when(parts["sign"] == "-").then(-1).otherwise(1)).to_series()
    zone_minutes = sign * (60 * number["zh"] + number["zm"])
    whole_seconds = 3600 * number["h"] + 60 * (number["m"] - zone_minutes) + number["s"] + DAY * date.cast(pl.Int64)
    fraction = (parts["f"].fill_null("") + "000000000").str.slice(0, 9).cast(pl.Int64)
    # as integers together they would overflow in 292 years
    return _since_midnight(whole_seconds, 1) + _to_seconds(fraction, 1_000_000_000)


def join_fractions(columns: Mapping[str, Array]) -> dict[str, Array]:
    """Return the stamps (s) that two columns hold, under the name of the first: ``stamp.secs`` and ``stamp.nsecs``."""
    stamps = {}
    for fraction_name, fraction in columns.items():
        words = _FRACTION.fullmatch(fraction_name)
        name = words["stem"] + words["seconds"] if words else ""
        if words and name in columns and _are_integers(columns[name]) and _are_integers(fraction):
            stamps[name] = columns[name] + fraction * _FRACTION_UNITS[words["unit"]]
    return stamps


def _are_integers(column: Array) -> bool:
    return np.array_equal(np.rint(column), column, equal_nan=True)


def seconds(series: pl.Series) -> Array:
    """Return the seconds of a series of dates, dates with times, times of day, or durations; nan for null."""
    import polars as pl

    counts = series.to_physical().cast(pl.Int64)
    if series.dtype == pl.Date:
        return _since_midnight(counts * DAY, 1)
    if series.dtype == pl.Time:
        return _to_seconds(counts, 1_000_000_000)
    rate = {"ms": 1_000, "us": 1_000_000, "ns": 1_000_000_000}[str(getattr(series.dtype, "time_unit", "us"))]
    return _to_seconds(counts, rate) if series.dtype == pl.Duration else _since_midnight(counts, rate)


def _since_midnight(counts: pl.Series, rate: int) -> Array:
    """Return the seconds of integers (``rate`` per second) since the midnight before the first of them."""
    values = counts.drop_nulls()
    # integers are subtracted before the division, which keeps the full resolution
    return _to_seconds(counts - (values[0] // (DAY * rate) * DAY * rate if len(values) else 0), rate)


def _to_seconds(counts: pl.Series, rate: int) -> Array:
    import polars as pl

    return np.array((counts.cast(pl.Float64) / rate).fill_null(np.nan).to_numpy())
