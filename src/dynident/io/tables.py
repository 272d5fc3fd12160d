"""Tables of columns from files: text (CSV, ...), Parquet, NumPy archives, MATLAB and HDF5 files, and ROS bags."""

from __future__ import annotations

import stat
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError, brief, called, choices
from dynident.io.arrays import Found, columns_of
from dynident.io.families import READERS
from dynident.io.hdf5 import is_hdf5, opened_hdf5
from dynident.io.matlab import parse_mat
from dynident.io.npz import opened_npz
from dynident.io.opener import afford, content, find, opened
from dynident.io.parquet import parse_parquet, parse_rows, rows_of
from dynident.io.recording_parts import is_divided, recording_parts
from dynident.io.ros import parse_bag
from dynident.io.text import parse_text, weight

__all__ = [
    "DataTable",
    "count_rows",
    "joined",
    "read_bag",
    "read_columns",
    "read_hdf5",
    "read_mat",
    "read_npz",
    "read_parquet",
    "read_parts",
    "read_rows",
    "read_text",
]

Array = NDArray[np.float64]
DAY = 86_400.0  # s


@dataclass(frozen=True, eq=False)
class DataTable:
    """Columns and scalars of a file, as float64 and without units.

    ``faults`` says why a column of the file cannot be used, ``lines`` are the line numbers of its rows (text files
    only), ``rows`` the indices kept where some were dropped, ``notes`` the corrections made in reading, ``unread`` the
    columns that were not asked for, ``units`` the unit of columns whose type has one: s for dates and times,
    ``guesses`` those of the notes that a user should confirm, ``texts`` what columns with one text in all rows say.
    Columns may differ in length: a file may hold more than one log.
    """

    columns: Mapping[str, Array]
    constants: Mapping[str, float]
    source: str
    faults: Mapping[str, str] = field(default_factory=dict)
    lines: Sequence[int] | None = None
    notes: tuple[str, ...] = ()
    rows: NDArray[np.intp] | None = None
    unread: tuple[str, ...] = ()
    units: Mapping[str, str] = field(default_factory=dict)
    guesses: tuple[str, ...] = ()
    texts: Mapping[str, str] = field(default_factory=dict)

    __repr__ = brief

    def __post_init__(self) -> None:
        for column in self.columns.values():
            column.flags.writeable = False
        for name in ("columns", "constants", "faults", "units", "texts"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    def column(self, name: str, where: str = "") -> Array:
        """Return a column; for an unknown one InputError, with the setting ``where`` in front, lists the columns."""
        if name in self.faults:
            raise InputError(f"{self.source}: {_led(where)}column {name!r} {self.faults[name]}")
        if name in self.constants:
            raise InputError(f"{self.source}: {_led(where)}{name!r} is a single number, not a column.")
        if name not in self.columns:
            raise InputError(
                f"{self.source}: {_led(where)}no column {name!r}; {choices(name, [*self.columns, *self.unread])}"
            )
        return self.columns[name]

    def constant(self, value: float | str, where: str = "") -> float:
        """Return a number unchanged, or the scalar of that name; for an unknown one InputError lists the scalars."""
        if not isinstance(value, str):
            return value
        if value not in self.constants:
            raise InputError(f"{self.source}: {_led(where)}no scalar {value!r}; {choices(value, self.constants)}")
        if not np.isfinite(self.constants[value]):
            raise InputError(f"{self.source}: {_led(where)}the scalar {value!r} is {self.constants[value]}.")
        return self.constants[value]

    def place(self, row: int) -> str:
        """Return the place of a row in the file, as text."""
        k = row if self.rows is None else int(self.rows[row])
        return f"row {k + 1}" if self.lines is None else f"line {self.lines[k]}"

    def kept(self, keep: NDArray[np.bool_], note: str) -> DataTable:
        """Return the table with the rows selected by ``keep`` (N) in the columns of that length, and a note on it."""
        columns = {name: x[keep] if len(x) == len(keep) else x for name, x in self.columns.items()}
        rows = np.arange(len(keep)) if self.rows is None else self.rows
        return replace(self, columns=columns, rows=rows[keep], notes=(*self.notes, note))


def _led(where: str) -> str:
    return f"{where}: " if where else ""


def read_columns(path: str | Path, width: int | None = None, needed: Collection[str] | None = None) -> DataTable:
    """Read the columns of a file; ``width`` is the number of columns of a text file with one number per line.

    Where ``needed`` names columns, readers need not read others. A file takes no more memory than 4 GB, or what the
    environment variable DYNIDENT_MEMORY says.
    Columns without a header are named "0", "1", ...; those of a 2-D array "name[0]", "name[1]", ...; those of ROS
    bags as in ``parse_bag``. A ROS 2 bag may be given as its folder; a recording in several Parquet files as theirs, or
    as a pattern of their names. Nothing is ever unpickled. Raises InputError
    where the file is missing, empty, damaged or of unknown type, or needs an extra that is not installed.

    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     path = Path(folder) / "log.csv"
    ...     _ = path.write_text("time,q1\\n0.0,0.5\\n0.1,0.6\\n")
    ...     table = read_columns(path)
    >>> table.column("q1").tolist()
    [0.5, 0.6]
    """
    path = Path(path)
    reader = _reader(path, path.suffix.lower())
    with _readable(path):
        table = reader(path, needed)
    if not (table.columns or table.constants or table.faults or table.unread):
        raise InputError(f"{path}: holds no columns; record again, or name another file.")
    if table.columns and not any(map(len, table.columns.values())):
        raise InputError(f"{path}: holds columns without rows; record again, or name another file.")
    return table if width is None else _reshaped(table, width)


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Make an InputError of what readers of damaged files raise, which may be almost any exception."""
    try:
        yield
    except (InputError, MemoryError):
        raise
    except Exception as error:
        reason = (str(error).splitlines() or [""])[0]
        what = "bag" if path.is_dir() else f"{path.suffix.lower()} file"
        raise InputError(f"{path}: is not a readable {what} ({type(error).__name__}: {reason}).") from error


def _foreign(reader: Callable[..., DataTable], path: Path, needed: Collection[str] | None) -> DataTable:  # noqa: ARG001
    """Call the reader of another package, on a regular file; it is not told which columns are needed."""
    with opened(path):
        return called(reader, path, DataTable)


def read_bag(path: Path, needed: Collection[str] | None = None) -> DataTable:  # noqa: ARG001
    """Read the joint states of a ROS bag, a file or a folder."""
    if path.is_dir() and not (path / "metadata.yaml").is_file():
        names = sorted(one.name for one in path.iterdir() if one.suffix.lower() in READERS.kinds())
        raise InputError(
            f"{path}: is a folder without metadata.yaml, so it is not a ROS 2 bag; "
            + (f"name a file in it. {choices('', names)}" if names else "nor does it hold a file that can be read.")
        )
    columns, faults, notes = parse_bag(path)
    return DataTable(columns, {}, str(path), faults, notes=notes)


def _reader(path: Path, kind: str) -> Callable[..., DataTable]:
    """Return the reader of the family for a file; InputError where there is none, or no such file."""
    if is_divided(path):
        return read_parts
    if stat.S_ISDIR(find(path, kinds=READERS.kinds()).st_mode):
        return read_bag
    if kind not in READERS.table and kind not in READERS.kinds():
        raise InputError(f"{path}: files of type {kind!r} cannot be read; {choices(kind, READERS.kinds())}")
    found: Callable[..., DataTable] = READERS.get(kind)
    return found if kind in READERS.table else partial(_foreign, found)


@contextmanager
def _file_of(path: Path) -> Iterator[BinaryIO]:
    """Open a file; InputError where it is empty."""
    with opened(path) as file:
        if not file.read(1):
            raise InputError(f"{path}: the file is empty.")
        file.seek(0)
        yield file


def _content_of(path: Path) -> tuple[bytes, str]:
    """Return what a file holds, and its name for messages; InputError where it is empty."""
    data = content(path)
    if not data.strip():
        raise InputError(f"{path}: the file is empty.")
    return data, str(path)


def _reshaped(table: DataTable, width: int) -> DataTable:
    """Return the table of a file with one number a line, ``width`` of which make a row."""
    if len(table.columns) != 1 or table.faults:
        count = len(table.columns) + len(table.faults)
        raise InputError(
            f"{table.source}: has {count} columns; `width` is for files with one number per line: leave it out."
        )
    (column,) = table.columns.values()
    if len(column) % width:
        raise InputError(
            f"{table.source}: its {len(column)} numbers do not fill rows of {width}; "
            f"{len(column) % width} are left over. Is `width` right, and the file complete?"
        )
    rows = column.reshape(-1, width)
    columns = {str(k): rows[:, k].copy() for k in range(width)}
    return replace(table, columns=columns, lines=None if table.lines is None else table.lines[::width])


def read_text(path: Path, needed: Collection[str] | None = None) -> DataTable:  # noqa: ARG001
    """Read a table of text."""
    data, source = _content_of(path)
    afford(weight(data), f"{path}: its {len(data) / 1e6:.3g} MB of text would take")
    columns, faults, lines, stamps, texts = parse_text(data, source)
    return DataTable(columns, {}, source, faults, lines, units=dict.fromkeys(stamps, "s"), texts=texts)


def read_parquet(path: Path, needed: Collection[str] | None = None) -> DataTable:
    """Read a Parquet file."""
    data, source = _content_of(path)
    columns, faults, units, unread = parse_parquet(data, source, needed)
    return DataTable(columns, {}, source, faults, unread=unread, units=units)


def read_rows(path: Path, needed: Collection[str] | None, rows: slice) -> DataTable:
    """Read some rows of a Parquet file, whose places are those in the file; raises as ``read_columns``."""
    with _readable(path), _file_of(path) as file:
        columns, faults, units, unread = parse_rows(file, str(path), needed, rows)
    return DataTable(columns, {}, str(path), faults, rows=np.arange(rows.start, rows.stop), unread=unread, units=units)


def count_rows(path: Path) -> int:
    """Return the number of rows of a Parquet file, by its footer; raises as ``read_columns``."""
    with _readable(path), _file_of(path) as file:
        return rows_of(file)


def read_parts(path: Path, needed: Collection[str] | None = None) -> DataTable:
    """Read the Parquet files of one recording, as ``recording_parts`` finds them, one after the other."""
    files = recording_parts(path)
    rows = sum(map(count_rows, files))
    afford(3 * 8 * rows * len(needed or ()), f"{path}: {rows} rows of {len(needed or ())} columns would take")
    return joined([read_columns(one, None, needed) for one in files], str(path))


def joined(tables: Sequence[DataTable], source: str) -> DataTable:
    """Return one table of the rows of several; InputError where a column of one is missing in another."""
    first = tables[0]
    names = dict.fromkeys(name for table in tables for name in table.columns)
    columns = {}
    for name in names:
        parts = [table.column(name) for table in tables]
        columns[name] = np.concatenate(_continued(parts) if first.units.get(name) == "s" else parts)
    faults = {name: words for table in tables for name, words in table.faults.items()}
    return DataTable(columns, {}, source, faults, unread=first.unread, units=first.units)


def _continued(parts: Sequence[Array]) -> list[Array]:
    """Return stamps of consecutive parts, each counted from its own midnight, as counted from that of the first."""
    found: list[Array] = []
    for one in parts:
        late = (found[-1][-1] - one[0]) / DAY if found and len(one) else 0.0
        found.append(one + DAY * np.ceil(late) if late > 0 else one)
    return found


def read_npz(path: Path, needed: Collection[str] | None = None) -> DataTable:
    """Read a NumPy archive."""
    with _file_of(path) as file, opened_npz(file) as arrays:
        return _table(arrays, needed, path)


def read_mat(path: Path, needed: Collection[str] | None = None) -> DataTable:
    """Read a MATLAB file."""
    with _file_of(path) as file:
        if is_hdf5(file):
            with opened_hdf5(file, str(path)) as arrays:
                return _table(arrays, needed, path)
    data, source = _content_of(path)
    return _table(parse_mat(data, source), needed, path, len(data))


def read_hdf5(path: Path, needed: Collection[str] | None = None) -> DataTable:
    """Read an HDF5 file."""
    with _file_of(path) as file, opened_hdf5(file, str(path)) as arrays:
        return _table(arrays, needed, path)


def _table(arrays: Mapping[str, Found], needed: Collection[str] | None, path: Path, taken: int = 0) -> DataTable:
    found = columns_of(arrays, needed, str(path), taken)
    said = tuple(found.guesses)
    return DataTable(
        found.columns, found.constants, str(path), found.faults, notes=said, unread=tuple(found.unread), guesses=said
    )
