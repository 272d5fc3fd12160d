"""Convert the named arrays of a file to columns, reading only those that are needed, within the memory budget."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO, Any, BinaryIO
from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipFile, ZipInfo

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from dynident.files.opener import afford
from dynident.files.tables import DataTable, open_nonempty
from dynident.runtime import memory_budget
from dynident.runtime.arrays import Array

_MAX_LISTED_COLUMNS = 1000  # columns of one array that are listed one by one where they are not read
_MIN_TIME_ASPECT = 20  # times the other side of an array: a side that long is the time, where no column says so
_HEADERS: dict[tuple[int, int], Callable[..., Any]] = {
    (1, 0): npy.read_array_header_1_0,
    (2, 0): npy.read_array_header_2_0,
}


@dataclass(frozen=True, eq=False)
class StoredArray:
    """An array that is still in its file.

    ``read`` reads it, and ``extra`` is the memory (bytes) that this takes besides the array itself.
    """

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    read: Callable[[], NDArray[Any]]
    extra: int = 0  # bytes

    @property
    def size(self) -> int:
        """The number of elements."""
        return math.prod(self.shape)

    @property
    def cost(self) -> int:
        """The memory (bytes) that reading takes: the array as it is stored, and as float64."""
        return self.size * (self.dtype.itemsize + 8) + self.extra


OpenArray = Callable[[], AbstractContextManager[IO[bytes]]]
ArrayOrText = StoredArray | str  # a text describes what is no array of numbers


def wrap_array(array: NDArray[Any]) -> StoredArray:
    """Wrap an array that is in memory already."""
    return StoredArray(array.shape, array.dtype, lambda: array)


def read_arrays(
    items: Mapping[str, ArrayOrText], needed: Collection[str] | None, path: Path, memory_in_use: int = 0
) -> DataTable:
    """Read the arrays; where ``needed`` is given, only those with such columns.

    Time runs down the rows. It is taken to run along them where the length of other columns says so, or else
    where that side is far longer; this guess is reported. ``memory_in_use`` is in bytes. Raises InputError for an
    array that is needed by name and beyond the budget; where all arrays are read, such an array is a fault of its
    columns.
    """
    # 1-D arrays tell the number of samples, by which the time axis of 2-D arrays is recognised
    lengths = {
        entry.size
        for entry in items.values()
        if not isinstance(entry, str) and max(entry.shape, default=0) == entry.size > 1
    }
    columns: dict[str, Array] = {}
    constants: dict[str, float] = {}
    faults: dict[str, str] = {}
    unread: list[str] = []
    guesses: list[str] = []
    for name, entry in items.items():
        if isinstance(entry, str) or entry.dtype.kind not in "biuf" or entry.size == 0:
            content = entry if isinstance(entry, str) else f"{entry.dtype} values of shape {entry.shape}"
            faults[name] = f"holds {content}, not an array of numbers."
        # the checks are ordered by cost: an array is read only after its type, shape, need and size have passed
        elif not (table := _table_shape(entry.shape, lengths)):
            faults[name] = f"has the shape {entry.shape}; time must run down the rows of a 2-D array: transpose it."
        elif not (needed is None or entry.size == 1 or any(x == name or x.startswith(f"{name}[") for x in needed)):
            unread += _column_names(name, min(table[1], _MAX_LISTED_COLUMNS))
        elif needed is None and memory_in_use + entry.cost > memory_budget():
            words = f"would take {entry.cost / 1e9:.3g} GB of memory, more than a file may; raise this by --memory."
            faults |= dict.fromkeys([*_column_names(name, min(table[1], _MAX_LISTED_COLUMNS)), name], words)
        else:
            # what was read so far counts, too: all arrays are in memory together
            afford(memory_in_use := memory_in_use + entry.cost, f"{path}: to read {name!r}, {entry.shape}, would take")
            values = entry.read()
            # the time runs along the rows: the transposed table is a guess that the user should confirm
            if table == _sides(entry.shape)[::-1] and table[0] != table[1]:
                why = f"as other columns have {table[0]} values" if table[0] in lengths else "its longer side"
                guesses.append(
                    f"{name!r} has the shape {entry.shape}: it is read as {table[0]} rows of {table[1]} columns, {why}."
                )
            if entry.size == 1:
                constants[name] = float(values.item())
            else:
                columns |= zip(_column_names(name, table[1]), _split_columns(values, *table), strict=True)
    notes = tuple(guesses)
    return DataTable(columns, constants, str(path), faults, notes=notes, unread=tuple(unread), guesses=notes)


def _table_shape(shape: tuple[int, ...], lengths: Collection[int]) -> tuple[int, int] | None:
    """Return the rows and columns of an array, None where the time axis is not clear.

    Time runs down the rows of an array, or along them, as the ``lengths`` of other columns tell; where they do
    not, a side that is far longer is the time. Sides of length one are left out.
    """
    if max(shape, default=1) == (size := math.prod(shape)):
        return size, 1
    if len(sides := _sides(shape)) != 2:
        return None
    rows, columns = sides
    # lengths of other columns decide; the aspect ratio only where they say nothing or fit both sides
    down, along = rows in lengths, columns in lengths
    undecided = (along and down) or not lengths
    if (along and not down) or (undecided and columns >= _MIN_TIME_ASPECT * rows):
        return columns, rows
    return (rows, columns) if rows >= columns else None


def _sides(shape: tuple[int, ...]) -> tuple[int, ...]:
    return tuple(n for n in shape if n != 1)


def _column_names(name: str, columns: int) -> list[str]:
    return [name] if columns == 1 else [f"{name}[{k}]" for k in range(columns)]


def _split_columns(array: NDArray[Any], rows: int, columns: int) -> list[Array]:
    if columns == 1:
        return [_to_float64(array.reshape(-1))]
    array = array.reshape(_sides(array.shape))
    array = array if array.shape == (rows, columns) else array.T
    return [_to_float64(array[:, k]) for k in range(columns)]


def _to_float64(array: NDArray[Any]) -> Array:
    with np.errstate(over="ignore", invalid="ignore"):  # extended precision may exceed float64: then inf
        return np.array(array, dtype=np.float64)


def read_numpy(path: Path, needed: Collection[str] | None = None) -> DataTable:
    """Read an array of NumPy, whose columns have the name of the file, or an archive of arrays."""
    if path.suffix.lower() == ".npy":
        return read_arrays({path.stem: _stored_array(partial(open_nonempty, path))}, needed, path)
    with open_nonempty(path) as file, open_npz(file) as arrays:
        return read_arrays(arrays, needed, path)


@contextmanager
def open_npz(file: BinaryIO) -> Iterator[dict[str, ArrayOrText]]:
    """Open the arrays of an archive by name; a member that is no array is described by a text.

    Raises ValueError, and zipfile.BadZipFile, where it is damaged or holds a name twice.
    """
    with ZipFile(file) as archive:
        members = archive.infolist()
        for name, count in Counter(member.filename for member in members).items():
            if count > 1:
                raise ValueError(f"the array {name.removesuffix('.npy')!r} is there twice")
        yield {member.filename.removesuffix(".npy"): _stored_member(archive, member) for member in members}


def _stored_member(archive: ZipFile, member: ZipInfo) -> ArrayOrText:
    if member.flag_bits & 1 or member.compress_type not in (ZIP_STORED, ZIP_DEFLATED):
        return "what numpy.savez does not write"
    if not member.filename.endswith(".npy"):
        return "what is no array"
    return _stored_array(partial(archive.open, member))


def _stored_array(open_array: OpenArray) -> ArrayOrText:
    """Return the array of a stream that ``open_array`` opens, of which only the header is read now."""
    with open_array() as data:
        if (version := npy.read_magic(data)) not in _HEADERS:
            raise ValueError(f"an array of version {version}")
        shape, _, dtype = _HEADERS[version](data)
    if dtype.hasobject:
        return "Python objects, which are not read"
    return StoredArray(tuple(map(int, shape)), dtype, partial(_read_array, open_array))


def _read_array(open_array: OpenArray) -> NDArray[Any]:
    """Read an array: exactly as many bytes as its header says."""
    with open_array() as data:
        values = npy.read_array(data, allow_pickle=False)
        if data.read(1):
            raise ValueError("an array is not of the size that its header says")
    return values
