"""Columns of a Parquet file, or of some of its rows.

They are numbers, dates and times, lists of one length (``q[0]``), or fields of structs (``arm.q``).
"""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from dynident.files.opener import afford
from dynident.files.stamps import parse_stamps, seconds
from dynident.files.tables import (
    DataTable,
    is_divided,
    join_tables,
    nonempty_content,
    open_nonempty,
    read_columns,
    recording_parts,
    report_damage,
)
from dynident.files.text import call_polars
from dynident.runtime.arrays import Array

if TYPE_CHECKING:
    import polars as pl

_MAX_FOOTER_DEPTH = 20
_ROW_GROUPS, _CHUNKS, _META, _PATH, _COUNT = 4, 1, 3, 3, 5  # the fields of the footer that are used
_CHUNK_SIZE, _PAGE_STARTS = 7, (9, 11)  # ... of the pages of a column: compressed size, first page of values and keys
_SIZES, _KEYS = (2, 3), 7  # ... of the head of a page: unpacked and packed size, and what is said of keys
_COUNTS = ((5, (1,)), (8, (1, 2, 3)))  # ... of values in version 1 and 2, with the numbers of values, nulls and rows
_MAX_HEAD = 2**16  # bytes that the head of a page takes, with the least and largest text in it
_MAX_STRUCT_DEPTH = 20  # structs in structs
_CELLS_PER_TEXT = 20  # columns of numbers that take as much memory as one of texts that are read as dates


def footer(file: BinaryIO) -> bytes:
    """Return the end of a file, from its footer on."""
    length = file.seek(0, 2)
    file.seek(max(length - 8, 0))
    # a file ends with the footer, its size (4 bytes), and the magic PAR1
    size = int.from_bytes(file.read(4), "little")
    file.seek(max(length - 8 - size, 0))
    return file.read()


def value_counts(data: bytes) -> Mapping[tuple[str, ...], int]:
    """Return the number of values by the path of a column, from the ``footer``.

    Raises ValueError or IndexError where it is damaged.
    """
    counts: Counter[tuple[str, ...]] = Counter()
    for meta in _column_chunks(data):
        counts[tuple(part.decode() for part in meta.get(_PATH, ()))] += max(meta.get(_COUNT, 0), 0)
    return counts


def _column_chunks(data: bytes) -> Iterator[dict[int, Any]]:
    """Yield what the ``footer`` says of each column in each group of rows."""
    size = int.from_bytes(data[-8:-4], "little")
    if data[-4:] != b"PAR1" or size + 8 > len(data):
        raise ValueError("has no footer of a Parquet file")
    for group in _CompactReader(data[-8 - size : -8]).read_struct().get(_ROW_GROUPS, ()):
        yield from (chunk.get(_META, {}) for chunk in group.get(_CHUNKS, ()))


def check_pages(file: BinaryIO) -> None:
    """Raise ValueError where the head of a page has a size or a count that its column cannot have.

    Polars would allocate as much, and end the process. What is not understood here is left to it.
    """
    damaged_pages = list[int]()
    with suppress(ValueError, IndexError, KeyError, TypeError):
        damaged_pages.extend(_damaged_pages(file))
    if damaged_pages:
        raise ValueError(f"has a page with a damaged head, at byte {damaged_pages[0]}")


def _damaged_pages(file: BinaryIO) -> Iterator[int]:
    """Yield the bytes at which pages begin whose head has an impossible size or count.

    Raises ValueError, IndexError, KeyError or TypeError where the file is not understood.
    """
    for meta in _column_chunks(footer(file)):
        start = min(at for at in map(meta.get, _PAGE_STARTS) if at)
        stop, largest = start + meta[_CHUNK_SIZE], meta[_COUNT]
        while start < stop:
            file.seek(start)
            reader = _CompactReader(file.read(_MAX_HEAD))
            head = reader.read_struct()
            unpacked, packed = (head[size] for size in _SIZES)
            counts = [head[part][count] for part, numbers in _COUNTS for count in numbers if part in head]
            keys = head[_KEYS][1] if _KEYS in head else 0
            if min(unpacked, packed) < 0 or not 0 <= keys <= unpacked or not all(0 <= x <= largest for x in counts):
                yield start
                break
            start += reader.position + packed


@lru_cache(maxsize=4096)
def _check_pages_once(path: Path, size: int, changed: int) -> None:  # noqa: ARG001 - a changed file is another one
    """Check the pages of a file, once: a long recording is read part by part."""
    with open_nonempty(path) as file:
        check_pages(file)


class _CompactReader:
    """Reader of consecutive values; structs are mappings by the numbers of their fields."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at, self._level = data, 0, 0
        number = self._read_zigzag
        self._readers: Mapping[int, Callable[[], Any]] = {
            1: self._read_byte, 2: self._read_byte, 3: self._read_byte, 4: number, 5: number, 6: number,
            7: lambda: self._read_bytes(8), 8: lambda: self._read_bytes(self._read_varint()),
            9: self._read_list, 10: self._read_list, 12: self.read_struct,
        }  # fmt: skip

    @property
    def position(self) -> int:
        """The number of bytes that were read."""
        return self._at

    def read_struct(self) -> dict[int, Any]:
        """Return the fields of a struct by their numbers."""
        self._level += 1
        if self._level > _MAX_FOOTER_DEPTH:
            raise ValueError("has a footer of too many levels")
        fields, field_id = {}, 0
        while head := self._read_byte():
            # field ids are stored as differences where these are small; 0 means that a full id follows
            field_id = field_id + (head >> 4) if head >> 4 else self._read_zigzag()
            kind = head & 15
            fields[field_id] = kind == 1 if kind in (1, 2) else self._readers[kind]()
        self._level -= 1
        return fields

    def _read_list(self) -> list[Any]:
        head = self._read_byte()
        size = self._read_varint() if head >> 4 == 15 else head >> 4
        # a damaged size must not cause a long loop: each entry takes at least one byte
        if size > len(self._data) - self._at:
            raise ValueError("has a footer that is cut off")
        return [self._readers[head & 15]() for _ in range(size)]

    def _read_zigzag(self) -> int:
        number = self._read_varint()
        # signed numbers alternate: 0, -1, 1, -2, ...
        return (number >> 1) ^ -(number & 1)

    def _read_varint(self) -> int:
        number = shift = 0
        while True:
            byte = self._read_byte()
            # seven bits per byte, the lowest first; the eighth says whether more follow
            number |= (byte & 127) << shift
            shift += 7
            if byte < 128 or shift > 63:
                return number

    def _read_bytes(self, size: int) -> bytes:
        self._at += size
        if self._at > len(self._data):
            raise ValueError("has a footer that is cut off")
        return self._data[self._at - size : self._at]

    def _read_byte(self) -> int:
        self._at += 1
        return self._data[self._at - 1]


@dataclass(frozen=True)
class _Leaf:
    """A column that is not a struct: its path, type, and the expression that selects it."""

    path: tuple[str, ...]
    kind: pl.DataType
    expression: pl.Expr

    @property
    def name(self) -> str:
        """The name of the column, ``struct.field`` for a field."""
        return ".".join(self.path)

    @property
    def readable(self) -> bool:
        """Whether it holds numbers, lists of numbers, or values that may be dates and times."""
        import polars as pl

        inner = self.kind.inner if isinstance(self.kind, pl.List | pl.Array) else self.kind
        return bool(inner.is_numeric() or inner == pl.Boolean) or self.kind.is_temporal() or self.kind == pl.String

    def cells(self, rows: int, counts: Mapping[tuple[str, ...], int]) -> int:
        """Return how many numbers take as much memory as the column, given its rows and the value counts."""
        import polars as pl

        if self.kind == pl.String:
            return _CELLS_PER_TEXT * rows
        return max((count for path, count in counts.items() if path[: len(self.path)] == self.path), default=rows)

    def is_needed(self, needed: Collection[str] | None) -> bool:
        return needed is None or any(column == self.name or column.startswith(f"{self.name}[") for column in needed)


def read_parquet(path: Path, needed: Collection[str] | None = None) -> DataTable:
    """Read a Parquet file, or those of one recording, as ``recording_parts`` finds them, one after the other."""
    if not is_divided(path):
        data = nonempty_content(path)
        check_pages(BytesIO(data))
        return _read_columns(BytesIO(data), path, needed, None, len(data))
    files = recording_parts(path)
    rows = sum(map(count_rows, files))
    # the limit is checked for all parts together before any is read
    afford(3 * 8 * rows * len(needed or ()), f"{path}: {rows} rows of {len(needed or ())} columns would take")
    return join_tables([read_columns(file, None, needed) for file in files], str(path))


def read_rows(path: Path, needed: Collection[str] | None, rows: slice) -> DataTable:
    """Read some rows of a Parquet file; places are those in the file. Raises as ``read_columns``."""
    with report_damage(path), open_nonempty(path) as file:
        status = os.fstat(file.fileno())
        _check_pages_once(path, status.st_size, status.st_mtime_ns)
        return _read_columns(file, path, needed, rows, 0)


def count_rows(path: Path) -> int:
    """Return the number of rows of a Parquet file, by its footer; raises as ``read_columns``."""
    with report_damage(path), open_nonempty(path) as file:
        return row_count(file)


def row_count(file: BinaryIO) -> int:
    """Return the number of rows of an open file, by its footer."""
    import polars as pl

    file.seek(0)
    return int(call_polars(lambda: pl.scan_parquet(file).select(pl.len()).collect().item()))


def _read_columns(
    file: BinaryIO, path: Path, needed: Collection[str] | None, part: slice | None, memory_in_use: int
) -> DataTable:
    """Read all rows, or a ``part`` of them, beside ``memory_in_use`` (bytes) of this file."""
    import polars as pl

    total_rows = row_count(file)
    file.seek(0)
    types = call_polars(lambda: pl.read_parquet_schema(file))
    start, rows = (0, total_rows) if part is None else (part.start, part.stop - part.start)
    # the length of lists is known only from the footer: without it, a short column could exhaust the memory
    counts = value_counts(footer(file)) if any(kind.is_nested() for kind in types.values()) else {}
    counts = {path: entry * rows // max(total_rows, 1) for path, entry in counts.items()}
    leaves = [entry for name, kind in types.items() for entry in _leaves((name,), kind, pl.col(name))]
    faults = {
        entry.name: f"holds {entry.kind}, not numbers; convert it before." for entry in leaves if not entry.readable
    }
    selected = [entry for entry in leaves if entry.readable and entry.is_needed(needed)]
    unread = tuple(entry.name for entry in leaves if entry.readable and not entry.is_needed(needed))
    cells = sum(entry.cells(rows, counts) for entry in selected)
    # up to three copies of the numbers exist at a time
    afford(memory_in_use + 3 * 8 * cells, f"{path}: {rows} rows of {len(selected)} columns would take")
    # numbered aliases: names of leaves may be equal, as a.b of a struct and of a column
    expressions = [leaf.expression.alias(str(k)) for k, leaf in enumerate(selected)]
    file.seek(0)
    # only the needed rows and columns are decoded
    scan = pl.scan_parquet(file).slice(start, rows)
    frame = call_polars(lambda: scan.select(expressions).collect()) if selected else pl.DataFrame()
    columns: dict[str, Array] = {}
    units: dict[str, str] = {}
    for leaf, series in zip(selected, frame.get_columns(), strict=True):
        leaf_columns = _leaf_values(leaf, series)
        if isinstance(leaf_columns, str):
            faults[leaf.name] = leaf_columns
        else:
            columns |= leaf_columns
            units |= dict.fromkeys(leaf_columns if leaf.kind.is_temporal() or leaf.kind == pl.String else (), "s")
    indices = None if part is None else np.arange(start, start + rows)
    return DataTable(columns, {}, str(path), faults, rows=indices, unread=unread, units=units)


def _leaves(path: tuple[str, ...], kind: pl.DataType, expression: pl.Expr, level: int = 0) -> Iterator[_Leaf]:
    import polars as pl

    if isinstance(kind, pl.Struct) and level < _MAX_STRUCT_DEPTH:
        for field in kind.fields:
            inner = expression.struct.field(field.name)
            yield from _leaves((*path, field.name), field.dtype, inner, level + 1)  # type: ignore[arg-type,unused-ignore]
    else:
        yield _Leaf(path, kind, expression)


def _leaf_values(leaf: _Leaf, series: pl.Series) -> dict[str, Array] | str:
    """Return the columns of a leaf, or why there are none."""
    import polars as pl

    if leaf.kind == pl.String:
        times = parse_stamps(series)
        return f"holds {leaf.kind}, not numbers; convert it before." if times is None else {leaf.name: times}
    if leaf.kind.is_temporal():
        return {leaf.name: seconds(series)}
    if isinstance(leaf.kind, pl.Array):
        # lists of a fixed and of a variable length are handled alike from here
        series = series.arr.to_list()
    elif not isinstance(leaf.kind, pl.List):
        return {leaf.name: _float_column(series)}
    lengths = np.unique(series.list.len().drop_nulls().to_numpy()).tolist()
    if len(lengths) != 1 or not (width := lengths[0]):
        lengths_text = " or ".join(map(str, lengths[:3])) or "no"
        return f"holds lists of {lengths_text} elements; all must have the same number."
    names = [leaf.name] if width == 1 else [f"{leaf.name}[{k}]" for k in range(width)]
    return {name: _float_column(series.list.get(k)) for k, name in enumerate(names)}


def _float_column(series: pl.Series) -> Array:
    """Return a series as float64, nan for null; the memory is shared where nothing has to be changed."""
    import polars as pl

    numbers = series.cast(pl.Float64)
    return (numbers.fill_null(np.nan) if numbers.null_count() else numbers).to_numpy()
