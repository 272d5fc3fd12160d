"""Tables of columns from files: text (CSV, ...), Parquet, NumPy archives, MATLAB and HDF5 files, and ROS bags."""

from __future__ import annotations

import glob
import os
import re
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

from dynident.files.arrays import ArrayOrText, open_npz, read_arrays
from dynident.files.matlab import is_hdf5, open_hdf5, parse_mat
from dynident.files.opener import afford, content, file_status, open_input
from dynident.files.parquet import parse_parquet, parse_rows, row_count
from dynident.files.ros import parse_bag
from dynident.files.text import parse_text, parsing_memory
from dynident.runtime import InputError, brief, call_part, choices
from dynident.runtime.families import READERS

PARQUET = ".parquet"
Array = NDArray[np.float64]
DAY = 86_400.0  # s


def is_divided(path: Path) -> bool:
    """Return whether a path names parts of a recording: a pattern, or a folder of Parquet files that is no bag."""
    if os.path.isdir(path):  # also of a name that is too long
        return not (path / "metadata.yaml").exists() and any(file.suffix.lower() == PARQUET for file in path.iterdir())
    return glob.has_magic(path.name) and not os.path.exists(path)


def recording_parts(path: Path) -> tuple[Path, ...]:
    """Return the parts of a recording in natural order of their names, or the file alone.

    Raises InputError where a pattern matches nothing, or files other than Parquet.
    """
    if not is_divided(path):
        return (path,)
    pattern = "*" if path.is_dir() else path.name
    folder = path if path.is_dir() else path.parent
    matches = sorted(Path(folder, name) for name in glob.glob(pattern, root_dir=folder))
    parts = [file for file in matches if file.suffix.lower() == PARQUET]
    if not path.is_dir() and len(parts) < len(matches):
        other_file = next(file for file in matches if file not in parts)
        raise InputError(f"{path}: matches {other_file.name}, too; the parts of one recording must be Parquet files.")
    if not parts:
        raise InputError(f"{path}: matches no file; look at the folder and the pattern.")
    return tuple(sorted(parts, key=lambda file: _natural_key(file.name)))


def _natural_key(name: str) -> list[tuple[int, str]]:
    """Return the sort key by which part10 follows part9."""
    return [(int(part), "") if part.isdigit() else (-1, part) for part in re.split(r"(\d+)", name)]


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
            raise InputError(f"{self.source}: {_message_lead(where)}column {name!r} {self.faults[name]}")
        if name in self.constants:
            raise InputError(f"{self.source}: {_message_lead(where)}{name!r} is a single number, not a column.")
        if name not in self.columns:
            raise InputError(
                f"{self.source}: {_message_lead(where)}no column {name!r}; "
                f"{choices(name, [*self.columns, *self.unread])}"
            )
        return self.columns[name]

    def constant(self, value: float | str, where: str = "") -> float:
        """Return a number unchanged, or the scalar of that name; for an unknown one InputError lists the scalars."""
        if not isinstance(value, str):
            return value
        if value not in self.constants:
            raise InputError(
                f"{self.source}: {_message_lead(where)}no scalar {value!r}; {choices(value, self.constants)}"
            )
        if not np.isfinite(self.constants[value]):
            raise InputError(f"{self.source}: {_message_lead(where)}the scalar {value!r} is {self.constants[value]}.")
        return self.constants[value]

    def place(self, row: int) -> str:
        """Return the place of a row in the file, as text."""
        k = row if self.rows is None else int(self.rows[row])
        return f"row {k + 1}" if self.lines is None else f"line {self.lines[k]}"

    def select_rows(self, keep: NDArray[np.bool_], note: str) -> DataTable:
        """Return the table with the rows selected by ``keep`` (N) in the columns of that length, and a note."""
        columns = {name: x[keep] if len(x) == len(keep) else x for name, x in self.columns.items()}
        rows = np.arange(len(keep)) if self.rows is None else self.rows
        return replace(self, columns=columns, rows=rows[keep], notes=(*self.notes, note))


def _message_lead(where: str) -> str:
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
    reader = _find_reader(path, path.suffix.lower())
    with _report_damage(path):
        table = reader(path, needed)
    if not (table.columns or table.constants or table.faults or table.unread):
        raise InputError(f"{path}: holds no columns; record again, or name another file.")
    if table.columns and not any(map(len, table.columns.values())):
        raise InputError(f"{path}: holds columns without rows; record again, or name another file.")
    return table if width is None else _reshape(table, width)


@contextmanager
def _report_damage(path: Path) -> Iterator[None]:
    """Turn the exceptions of readers of damaged files, which may be almost any, into an InputError."""
    try:
        yield
    except (InputError, MemoryError):
        raise
    except Exception as error:
        reason = (str(error).splitlines() or [""])[0]
        kind = "bag" if path.is_dir() else f"{path.suffix.lower()} file"
        raise InputError(f"{path}: is not a readable {kind} ({type(error).__name__}: {reason}).") from error


def _call_external(reader: Callable[..., DataTable], path: Path, needed: Collection[str] | None) -> DataTable:  # noqa: ARG001
    """Call a reader of another package on a regular file; it is not told which columns are needed."""
    with open_input(path):
        return call_part(reader, path, DataTable)


def read_bag(path: Path, needed: Collection[str] | None = None) -> DataTable:  # noqa: ARG001
    """Read the joint states of a ROS bag, a file or a folder."""
    if path.is_dir() and not (path / "metadata.yaml").is_file():
        names = sorted(file.name for file in path.iterdir() if file.suffix.lower() in READERS.kinds())
        raise InputError(
            f"{path}: is a folder without metadata.yaml, so it is not a ROS 2 bag; "
            + (f"name a file in it. {choices('', names)}" if names else "nor does it hold a file that can be read.")
        )
    columns, faults, notes = parse_bag(path)
    return DataTable(columns, {}, str(path), faults, notes=notes)


def _find_reader(path: Path, kind: str) -> Callable[..., DataTable]:
    """Return the reader for a file; InputError where there is none, or no such file."""
    if is_divided(path):
        return read_parts
    if stat.S_ISDIR(file_status(path, kinds=READERS.kinds()).st_mode):
        return read_bag
    if kind not in READERS.table and kind not in READERS.kinds():
        raise InputError(f"{path}: files of type {kind!r} cannot be read; {choices(kind, READERS.kinds())}")
    reader: Callable[..., DataTable] = READERS.get(kind)
    return reader if kind in READERS.table else partial(_call_external, reader)


@contextmanager
def _open_nonempty(path: Path) -> Iterator[BinaryIO]:
    """Open a file; InputError where it is empty."""
    with open_input(path) as file:
        if not file.read(1):
            raise InputError(f"{path}: the file is empty.")
        file.seek(0)
        yield file


def _read_nonempty(path: Path) -> tuple[bytes, str]:
    """Return the content of a file, and its name for messages; InputError where it is empty."""
    data = content(path)
    if not data.strip():
        raise InputError(f"{path}: the file is empty.")
    return data, str(path)


def _reshape(table: DataTable, width: int) -> DataTable:
    """Return the table of a file with one number per line, ``width`` of which make a row."""
    if len(table.columns) != 1 or table.faults:
        count = len(table.columns) + len(table.faults)
        raise InputError(
            f"{table.source}: has {count} columns; `width` is for files with one number per line: leave it out."
        )
    (column,) = table.columns.values()
    # a remainder means a wrong width or a file that is cut off
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
    data, source = _read_nonempty(path)
    afford(parsing_memory(data), f"{path}: its {len(data) / 1e6:.3g} MB of text would take")
    columns, faults, lines, stamps, texts = parse_text(data, source)
    return DataTable(columns, {}, source, faults, lines, units=dict.fromkeys(stamps, "s"), texts=texts)


def read_parquet(path: Path, needed: Collection[str] | None = None) -> DataTable:
    """Read a Parquet file."""
    data, source = _read_nonempty(path)
    columns, faults, units, unread = parse_parquet(data, source, needed)
    return DataTable(columns, {}, source, faults, unread=unread, units=units)


def read_rows(path: Path, needed: Collection[str] | None, rows: slice) -> DataTable:
    """Read some rows of a Parquet file; places are those in the file. Raises as ``read_columns``."""
    with _report_damage(path), _open_nonempty(path) as file:
        columns, faults, units, unread = parse_rows(file, str(path), needed, rows)
    return DataTable(columns, {}, str(path), faults, rows=np.arange(rows.start, rows.stop), unread=unread, units=units)


def count_rows(path: Path) -> int:
    """Return the number of rows of a Parquet file, by its footer; raises as ``read_columns``."""
    with _report_damage(path), _open_nonempty(path) as file:
        return row_count(file)


def read_parts(path: Path, needed: Collection[str] | None = None) -> DataTable:
    """Read the Parquet files of one recording, as ``recording_parts`` finds them, one after the other."""
    files = recording_parts(path)
    rows = sum(map(count_rows, files))
    # the limit is checked for all parts together before any is read
    afford(3 * 8 * rows * len(needed or ()), f"{path}: {rows} rows of {len(needed or ())} columns would take")
    return join_tables([read_columns(file, None, needed) for file in files], str(path))


def join_tables(tables: Sequence[DataTable], source: str) -> DataTable:
    """Join the rows of several tables; InputError where a column of one is missing in another."""
    first_table = tables[0]
    names = dict.fromkeys(name for table in tables for name in table.columns)
    columns = {}
    for name in names:
        parts = [table.column(name) for table in tables]
        columns[name] = np.concatenate(_continue_stamps(parts) if first_table.units.get(name) == "s" else parts)
    faults = {name: words for table in tables for name, words in table.faults.items()}
    return DataTable(columns, {}, source, faults, unread=first_table.unread, units=first_table.units)


def _continue_stamps(parts: Sequence[Array]) -> list[Array]:
    """Return the stamps of consecutive parts, counted from the midnight of the first part, not each from its own."""
    continued: list[Array] = []
    for stamps in parts:
        # a part that seems to begin before the end of the last one begins on a later day
        days = (continued[-1][-1] - stamps[0]) / DAY if continued and len(stamps) else 0.0
        continued.append(stamps + DAY * np.ceil(days) if days > 0 else stamps)
    return continued


def read_npz(path: Path, needed: Collection[str] | None = None) -> DataTable:
    """Read a NumPy archive."""
    with _open_nonempty(path) as file, open_npz(file) as arrays:
        return _arrays_table(arrays, needed, path)


def read_mat(path: Path, needed: Collection[str] | None = None) -> DataTable:
    """Read a MATLAB file."""
    with _open_nonempty(path) as file:
        if is_hdf5(file):
            with open_hdf5(file, str(path)) as arrays:
                return _arrays_table(arrays, needed, path)
    data, source = _read_nonempty(path)
    return _arrays_table(parse_mat(data, source), needed, path, len(data))


def read_hdf5(path: Path, needed: Collection[str] | None = None) -> DataTable:
    """Read an HDF5 file."""
    with _open_nonempty(path) as file, open_hdf5(file, str(path)) as arrays:
        return _arrays_table(arrays, needed, path)


def _arrays_table(
    arrays: Mapping[str, ArrayOrText], needed: Collection[str] | None, path: Path, memory_in_use: int = 0
) -> DataTable:
    array_columns = read_arrays(arrays, needed, str(path), memory_in_use)
    notes = tuple(array_columns.guesses)
    return DataTable(
        array_columns.columns,
        array_columns.constants,
        str(path),
        array_columns.faults,
        notes=notes,
        unread=tuple(array_columns.unread),
        guesses=notes,
    )
