"""Tables of columns from files, by the readers of ``runtime/families.py``, and recordings in several files."""

from __future__ import annotations

import glob
import os
import re
import stat
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import field, replace
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from dynident.files.opener import content, file_status, open_input
from dynident.runtime import InputError, Noun, call_part, choices
from dynident.runtime.arrays import Array
from dynident.runtime.families import READERS

PARQUET, BAG_FOLDER, DATA_SET = ".parquet", ".db3", "lerobot"  # the kinds of folders
INFO_FILE = Path("meta", "info.json")  # of a LeRobot data set
_PACKED = (".gz", ".zip", ".bz2", ".xz", ".zst", ".7z", ".tar", ".tgz")
DAY = 86_400  # s


def is_episode(path: Path) -> bool:
    """Return whether a path names an episode of a LeRobot data set: ``folder/#3``."""
    return re.fullmatch(r"#\d{1,9}", path.name) is not None


def recording_name(path: Path) -> str:
    """Return how a recording is called: the stem of its file, the folder of a pattern, or data set and number."""
    if is_episode(path):
        return f"{path.parent.name} {path.name}".strip()
    return path.parent.name if glob.has_magic(path.name) and path.parent.name else path.stem


def is_data_set(path: Path) -> bool:
    """Return whether a path is the folder of a LeRobot data set."""
    return os.path.exists(path / INFO_FILE)


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
    # part10 follows part9
    keys = {file: [(int(x), "") if x.isdigit() else (-1, x) for x in re.split(r"(\d+)", file.name)] for file in parts}
    return tuple(sorted(parts, key=keys.__getitem__))


class DataTable(Noun):
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
    Columns without a header are named "0", "1", ...; those of a 2-D array "name[0]", "name[1]", ...; those of ROS bags
    as in ``files/ros.py``. A ROS 2 bag may be given as its folder, an episode of a LeRobot data set as ``folder/#3``, a
    recording in several Parquet files as theirs, or as a pattern of their names. Nothing is ever unpickled. Raises
    InputError where the file is missing, empty, damaged or of unknown type, or needs an extra that is not installed.

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
    with report_damage(path):
        table = reader(path, needed)
    if not (table.columns or table.constants or table.faults or table.unread):
        raise InputError(f"{path}: holds no columns; record again, or name another file.")
    if table.columns and not any(map(len, table.columns.values())):
        raise InputError(f"{path}: holds columns without rows; record again, or name another file.")
    return table if width is None else _reshape(table, width)


@contextmanager
def report_damage(path: Path) -> Iterator[None]:
    """Turn the exceptions of readers of damaged files, which may be almost any, into an InputError."""
    try:
        yield
    except (InputError, MemoryError):
        raise
    except Exception as error:
        reason = (str(error).splitlines() or [""])[0]
        kind = "bag" if path.is_dir() else f"{path.suffix.lower()} file".strip()
        raise InputError(f"{path}: is not a readable {kind} ({type(error).__name__}: {reason}).") from error


def _call_external(reader: Callable[..., DataTable], path: Path, needed: Collection[str] | None) -> DataTable:  # noqa: ARG001
    """Call a reader of another package on a regular file; it is not told which columns are needed."""
    with open_input(path):
        return call_part(reader, path, DataTable)


def _find_reader(path: Path, kind: str) -> Callable[..., DataTable]:
    """Return the reader for a file; InputError where there is none, or no such file."""
    is_parts = is_divided(path)
    if is_episode(path) or is_data_set(path):
        kind = DATA_SET
    elif is_parts or stat.S_ISDIR(file_status(path, kinds=READERS.kinds()).st_mode):
        kind = PARQUET if is_parts else BAG_FOLDER
    if kind not in READERS.table and kind not in READERS.kinds():
        suffixes = [suffix for suffix in READERS.kinds() if suffix != DATA_SET]
        remedy = "unpack it first." if kind in _PACKED else choices(kind, suffixes)
        raise InputError(f"{path}: files of type {kind!r} cannot be read; {remedy}")
    reader: Callable[..., DataTable] = READERS.get(kind)
    return reader if kind in READERS.table else partial(_call_external, reader)


@contextmanager
def open_nonempty(path: Path) -> Iterator[BinaryIO]:
    """Open a file; InputError where it is empty."""
    with open_input(path) as file:
        if not file.read(1):
            raise InputError(f"{path}: the file is empty.")
        file.seek(0)
        yield file


def nonempty_content(path: Path) -> bytes:
    """Return the content of a file; InputError where it is empty."""
    data = content(path)
    if not data.strip():
        raise InputError(f"{path}: the file is empty.")
    return data


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
