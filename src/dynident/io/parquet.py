"""Columns of a Parquet file, or of some of its rows: numbers, dates and times, lists of one length (``q[0]``), and
structs (``arm.q``)."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from io import BytesIO
from typing import TYPE_CHECKING, BinaryIO

import numpy as np
from numpy.typing import NDArray

from dynident.io.opener import afford
from dynident.io.parquet_footer import footer, value_counts
from dynident.io.stamps import parse_stamps, seconds
from dynident.io.text import unpanicked

if TYPE_CHECKING:
    import polars as pl

__all__ = ["parse_parquet", "parse_rows", "rows_of"]

Array = NDArray[np.float64]
_DEEPEST = 20  # structs in structs
_TEXT = 20  # columns of numbers that take as much memory as one of texts that are read as dates


@dataclass(frozen=True)
class _Leaf:
    """A column that is no struct: its name, path, type, and what selects it."""

    path: tuple[str, ...]
    kind: pl.DataType
    expression: pl.Expr

    @property
    def name(self) -> str:
        """The name of the column, ``struct.field`` for a field."""
        return ".".join(self.path)

    @property
    def readable(self) -> bool:
        """Whether it holds numbers, lists of numbers, or what may be dates and times."""
        import polars as pl

        inner = self.kind.inner if isinstance(self.kind, pl.List | pl.Array) else self.kind
        return bool(inner.is_numeric() or inner == pl.Boolean) or self.kind.is_temporal() or self.kind == pl.String

    def cells(self, rows: int, counts: Mapping[tuple[str, ...], int]) -> int:
        """Return how many numbers take as much memory as the column, given its rows and the values in the file."""
        import polars as pl

        if self.kind == pl.String:
            return _TEXT * rows
        return max((count for path, count in counts.items() if path[: len(self.path)] == self.path), default=rows)

    def wanted(self, needed: Collection[str] | None) -> bool:
        return needed is None or any(one == self.name or one.startswith(f"{self.name}[") for one in needed)


Parsed = tuple[dict[str, Array], dict[str, str], dict[str, str], tuple[str, ...]]


def parse_parquet(data: bytes, source: str, needed: Collection[str] | None) -> Parsed:
    """Return the columns, the faults of others, the units of dates and times, and the columns that were not needed."""
    return _parsed(BytesIO(data), source, needed, 0, None, len(data))


def parse_rows(file: BinaryIO, source: str, needed: Collection[str] | None, rows: slice) -> Parsed:
    """Return the same of some rows of an open file, of which no others are kept in memory."""
    return _parsed(file, source, needed, rows.start, rows.stop - rows.start, 0)


def rows_of(file: BinaryIO) -> int:
    """Return the number of rows of an open file, by its footer."""
    import polars as pl

    file.seek(0)
    return int(unpanicked(lambda: pl.scan_parquet(file).select(pl.len()).collect().item()))


def _parsed(
    file: BinaryIO, source: str, needed: Collection[str] | None, start: int, count: int | None, taken: int
) -> Parsed:
    import polars as pl

    whole = rows_of(file)
    file.seek(0)
    types = unpanicked(lambda: pl.read_parquet_schema(file))
    rows = whole if count is None else count
    counts = value_counts(footer(file)) if any(map(_nested, types.values())) else {}
    counts = {path: one * rows // max(whole, 1) for path, one in counts.items()}
    leaves = [one for name, kind in types.items() for one in _leaves((name,), kind, pl.col(name))]
    faults = {one.name: f"holds {one.kind}, not numbers; convert it before." for one in leaves if not one.readable}
    chosen = [one for one in leaves if one.readable and one.wanted(needed)]
    unread = tuple(one.name for one in leaves if one.readable and not one.wanted(needed))
    cells = sum(one.cells(rows, counts) for one in chosen)
    afford(taken + 3 * 8 * cells, f"{source}: {rows} rows of {len(chosen)} columns would take")
    named = [leaf.expression.alias(str(k)) for k, leaf in enumerate(chosen)]
    file.seek(0)
    scan = pl.scan_parquet(file).slice(start, count)
    frame = unpanicked(lambda: scan.select(named).collect()) if chosen else pl.DataFrame()
    columns: dict[str, Array] = {}
    units: dict[str, str] = {}
    for leaf, series in zip(chosen, frame.get_columns(), strict=True):
        found = _columns(leaf, series)
        if isinstance(found, str):
            faults[leaf.name] = found
        else:
            columns |= found
            units |= dict.fromkeys(found if leaf.kind.is_temporal() or leaf.kind == pl.String else (), "s")
    return columns, faults, units, unread


def _leaves(path: tuple[str, ...], kind: pl.DataType, expression: pl.Expr, level: int = 0) -> Iterator[_Leaf]:
    import polars as pl

    if isinstance(kind, pl.Struct) and level < _DEEPEST:
        for field in kind.fields:
            inner = expression.struct.field(field.name)
            yield from _leaves((*path, field.name), field.dtype, inner, level + 1)  # type: ignore[arg-type,unused-ignore]
    else:
        yield _Leaf(path, kind, expression)


def _nested(kind: pl.DataType) -> bool:
    import polars as pl

    return isinstance(kind, pl.List | pl.Array | pl.Struct)


def _columns(leaf: _Leaf, series: pl.Series) -> dict[str, Array] | str:
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
    if len(lengths) != 1 or not (width := lengths[0]):
        few = " or ".join(map(str, lengths[:3])) or "no"
        return f"holds lists of {few} elements; all must have the same number."
    names = [leaf.name] if width == 1 else [f"{leaf.name}[{k}]" for k in range(width)]
    return {name: _numbers(series.list.get(k)) for k, name in enumerate(names)}


def _numbers(series: pl.Series) -> Array:
    """Return a series as float64, nan for null; it shares its memory with the array where nothing is to be changed."""
    import polars as pl

    numbers = series.cast(pl.Float64)
    return (numbers.fill_null(np.nan) if numbers.null_count() else numbers).to_numpy()
