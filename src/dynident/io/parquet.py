"""Columns of a Parquet file: numbers, dates and times, lists of one length (``q[0]``), and structs (``arm.q``)."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from dynident.io.opener import afford
from dynident.io.stamps import parse_stamps, seconds
from dynident.io.text import unpanicked

if TYPE_CHECKING:
    import polars as pl

__all__ = ["parse_parquet"]

Array = NDArray[np.float64]
_DEEPEST = 20  # structs in structs
_TEXT = 20  # columns of numbers that take as much memory as one of texts that are read as dates


@dataclass(frozen=True)
class _Leaf:
    """A column that is no struct: its name, type, and what selects it."""

    name: str
    kind: pl.DataType
    expression: pl.Expr

    def wanted(self, needed: Collection[str] | None) -> bool:
        return needed is None or any(one == self.name or one.startswith(f"{self.name}[") for one in needed)


def parse_parquet(
    data: bytes, source: str, needed: Collection[str] | None
) -> tuple[dict[str, Array], dict[str, str], dict[str, str], tuple[str, ...]]:
    """Return the columns, the faults of others, the units of dates and times, and the columns that were not needed."""
    import polars as pl

    types = unpanicked(lambda: pl.read_parquet_schema(BytesIO(data)))
    scan = pl.scan_parquet(BytesIO(data))
    rows = int(unpanicked(lambda: scan.select(pl.len()).collect().item()))
    columns: dict[str, Array] = {}
    faults: dict[str, str] = {}
    units: dict[str, str] = {}
    unread: list[str] = []
    chosen: list[tuple[_Leaf, int]] = []
    for leaf in (one for name, kind in types.items() for one in _leaves(name, kind, pl.col(name))):
        if not _readable(leaf.kind):
            faults[leaf.name] = f"holds {leaf.kind}, not numbers; convert it before."
        elif not leaf.wanted(needed):
            unread.append(leaf.name)
        else:
            chosen.append((leaf, _width(scan, leaf)))
    count = sum(_TEXT if leaf.kind == pl.String else width for leaf, width in chosen)
    afford(len(data) + 3 * 8 * rows * count, f"{source}: {rows} rows of {count} columns would take")
    for leaf, width in chosen:
        series = unpanicked(lambda leaf=leaf: scan.select(leaf.expression.alias("x")).collect()["x"])  # type: ignore[misc]
        found = _columns(leaf, series, width)
        if isinstance(found, str):
            faults[leaf.name] = found
        else:
            columns |= found
            units |= dict.fromkeys(found if leaf.kind.is_temporal() or leaf.kind == pl.String else (), "s")
    return columns, faults, units, tuple(unread)


def _leaves(name: str, kind: pl.DataType, expression: pl.Expr, level: int = 0) -> Iterator[_Leaf]:
    import polars as pl

    if isinstance(kind, pl.Struct) and level < _DEEPEST:
        for field in kind.fields:
            inner = expression.struct.field(field.name)
            yield from _leaves(f"{name}.{field.name}", field.dtype, inner, level + 1)  # type: ignore[arg-type,unused-ignore]
    else:
        yield _Leaf(name, kind, expression)


def _readable(kind: pl.DataType) -> bool:
    import polars as pl

    inner = kind.inner if isinstance(kind, pl.List | pl.Array) else kind
    return bool(inner.is_numeric() or inner == pl.Boolean) or kind.is_temporal() or kind == pl.String


def _width(scan: pl.LazyFrame, leaf: _Leaf) -> int:
    """Return how many columns a leaf makes: for lists, as many as the first one has elements."""
    import polars as pl

    if isinstance(leaf.kind, pl.Array):
        return int(leaf.kind.size)
    if not isinstance(leaf.kind, pl.List):
        return 1
    first = unpanicked(lambda: scan.select(leaf.expression.list.len()).head(1).collect().to_series())
    return int(first[0] or 0) if len(first) else 0


def _columns(leaf: _Leaf, series: pl.Series, width: int) -> dict[str, Array] | str:
    """Return the columns of a leaf, or why there are none."""
    import polars as pl

    if leaf.kind == pl.String:
        times = parse_stamps(series)
        return f"holds {leaf.kind}, not numbers; convert it before." if times is None else {leaf.name: times}
    if leaf.kind.is_temporal():
        return {leaf.name: seconds(series)}
    if isinstance(leaf.kind, pl.Array):
        series = series.arr.to_list()
    elif not isinstance(leaf.kind, pl.List):
        return {leaf.name: _numbers(series)}
    lengths = np.unique(series.list.len().drop_nulls().to_numpy()).tolist()
    if lengths != [width] or not width:
        few = " or ".join(map(str, lengths[:3])) or "no"
        return f"holds lists of {few} elements; all must have the same number."
    names = [leaf.name] if width == 1 else [f"{leaf.name}[{k}]" for k in range(width)]
    return {name: _numbers(series.list.get(k)) for k, name in enumerate(names)}


def _numbers(series: pl.Series) -> Array:
    """Return a series as float64, nan for null; it shares its memory with the array where nothing is to be changed."""
    import polars as pl

    numbers = series.cast(pl.Float64)
    return (numbers.fill_null(np.nan) if numbers.null_count() else numbers).to_numpy()
