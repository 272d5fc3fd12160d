"""Dates and times as seconds: texts as of ISO 8601, and the types of Parquet.

Dates and times count from midnight (UTC, or local time where they have no zone) of the first one: float64 then has a
resolution of 1e-11 s, against 2e-7 s when counted from 1970.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import polars as pl

__all__ = ["is_stamp", "parse_stamps", "seconds"]

Array = NDArray[np.float64]
_DAY = 86_400
_STAMP = (
    r"^(?P<date>\d{4}[-/]\d{2}[-/]\d{2})[Tt ]\s*"
    r"(?P<h>[01]\d|2[0-3]):(?P<m>[0-5]\d)(:(?P<s>[0-5]\d|60)([.,](?P<f>\d+))?)?"
    r"\s*(?P<zone>Z|z|UTC|(?P<sign>[+-])(?P<zh>\d{2}):?(?P<zm>[0-5]\d)?)?$"
)


def is_stamp(text: str) -> bool:
    """Return whether a text is a date with a time of day."""
    return re.match(_STAMP, text) is not None


def parse_stamps(cells: pl.Series) -> Array | None:
    """Return the seconds of texts such as ``2024-05-01T12:00:00.25+02:00``, nan for null; None where one is another.

    The seconds may be missing, have fractions after a point or a comma, and the T may be a blank. All texts have a
    zone, or none has.
    """
    import polars as pl

    given = cells.drop_nulls()
    if not len(given) or not given.str.contains(_STAMP).all():
        return None
    parts = cells.to_frame("x").select(pl.col("x").str.extract_groups(_STAMP)).unnest("x")
    if 0 < parts["zone"].null_count() - cells.null_count() < len(given):
        return None
    date = parts["date"].str.replace_all("/", "-").str.to_date("%Y-%m-%d", strict=False)
    if date.null_count() > cells.null_count():
        return None
    number = {key: parts[key].cast(pl.Int64).fill_null(0) for key in ("h", "m", "s", "zh", "zm")}
    west = pl.select(pl.when(parts["sign"] == "-").then(-1).otherwise(1)).to_series()
    ahead = west * (60 * number["zh"] + number["zm"])
    whole = 3600 * number["h"] + 60 * (number["m"] - ahead) + number["s"] + _DAY * date.cast(pl.Int64)
    fraction = (parts["f"].fill_null("") + "000000000").str.slice(0, 9).cast(pl.Int64)
    return _since_midnight(whole, 1) + _divided(fraction, 1_000_000_000)  # together they would overflow in 292 years


def seconds(series: pl.Series) -> Array:
    """Return the seconds of a series of dates, dates with times, times of day, or durations; nan for null."""
    import polars as pl

    counts = series.to_physical().cast(pl.Int64)
    if series.dtype == pl.Date:
        return _since_midnight(counts * _DAY, 1)
    if series.dtype == pl.Time:
        return _divided(counts, 1_000_000_000)
    rate = {"ms": 1_000, "us": 1_000_000, "ns": 1_000_000_000}[str(getattr(series.dtype, "time_unit", "us"))]
    return _divided(counts, rate) if series.dtype == pl.Duration else _since_midnight(counts, rate)


def _since_midnight(counts: pl.Series, rate: int) -> Array:
    """Return the seconds of whole numbers (``rate`` per second) since the midnight before the first of them."""
    given = counts.drop_nulls()
    return _divided(counts - (given[0] // (_DAY * rate) * _DAY * rate if len(given) else 0), rate)


def _divided(counts: pl.Series, rate: int) -> Array:
    import polars as pl

    return np.array((counts.cast(pl.Float64) / rate).fill_null(np.nan).to_numpy())
