"""Numeric arrays of MATLAB files of version 5 to 7.2 (format: MathWorks, "MAT-File Format", Level 5).

Only what a recording needs is read, with every size checked: the compiled reader of SciPy reads more kinds of
variables, but a damaged file can crash it, and with it the interpreter. A compressed variable is decompressed when it
is read, and never beyond the size that it claims.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from dynident.files.arrays import ArrayOrText, StoredArray, read_arrays, wrap_array
from dynident.files.opener import afford
from dynident.files.tables import DataTable, nonempty_content, open_nonempty
from dynident.runtime import InputError, install_command, memory_budget

_HEADER_SIZE = 128
_NUMBER_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_INT8, _MATRIX, _COMPRESSED = 1, 14, 15  # types of data elements
_NUMERIC_CODES = range(6, 16)  # classes of arrays, from double to uint64
_STRUCT, _MAX_STRUCT_DEPTH = "a struct", 20  # deeper nesting of structs is taken for damage
_CLASSES = {1: "a cell array", 2: _STRUCT, 3: "an object", 4: "text", 5: "a sparse matrix"}
_CONVERSIONS = {  # how the numbers of an object become arrays, in MATLAB
    "timeseries": "t = x.Time; q = squeeze(x.Data);",
    "timetable": "t = seconds(x.Properties.RowTimes - x.Properties.RowTimes(1)); q = x.Variables;",
    "table": "q = table2array(x);",
    "datetime": "t = seconds(x - x(1));",
    "duration": "t = seconds(x);",
}
_COMPLEX_FLAG = 0x800
_HEAD_BYTES = 4096  # bytes in which flags, dimensions and name of an array are
_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_MATLAB_HEADER = 512  # bytes that MATLAB puts before the HDF5 file
_OBJECTS = {"char": "text", "string": "text", "cell": "a cell array", "function_handle": "an object"}
_STRUCT_ARRAY = "an array of structs or cells (in MATLAB, take one: x = s(1).field; and save that)"
_NUMERIC_CLASSES = (
    "double",
    "single",
    "logical",
    *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)),
)
_MAX_DEFLATE_RATIO = 1100  # more than this, deflate cannot compress
_MAX_OBJECTS, _MAX_GROUP_DEPTH = 50_000, 20  # objects, and levels of groups
# bytes that filters may add to a chunk; those decompressed at a time
_MAX_FILTER_OVERHEAD, _INFLATE_SIZE = 1 << 16, 1 << 20


def read_mat(path: Path, needed: Collection[str] | None = None) -> DataTable:
    """Read a MATLAB file."""
    with open_nonempty(path) as file:
        head = file.read(_MATLAB_HEADER + len(_SIGNATURE))
        if _SIGNATURE in (head[: len(_SIGNATURE)], head[_MATLAB_HEADER:]):  # HDF5, without a header of MATLAB or with
            with open_hdf5(file, str(path)) as arrays:
                return read_arrays(arrays, needed, path)
    data = nonempty_content(path)
    return read_arrays(parse_mat(data, str(path)), needed, path, len(data))


def read_hdf5(path: Path, needed: Collection[str] | None = None) -> DataTable:
    """Read an HDF5 file."""
    with open_nonempty(path) as file, open_hdf5(file, str(path)) as arrays:
        return read_arrays(arrays, needed, path)


def parse_mat(data: bytes, source: str = "") -> dict[str, ArrayOrText]:
    """Return the arrays of a file by name, and a description of what is not an array of real numbers.

    Raises ValueError, zlib.error or struct.error where the file is damaged, or of another version.
    """
    # the letters MI are written as one 16-bit number: their order tells that of the bytes
    order = {b"IM": "<", b"MI": ">"}.get(data[126:_HEADER_SIZE])
    if order is None:
        raise ValueError("no header of version 5; save it with -v7")
    (version,) = struct.unpack_from(f"{order}H", data, 124)
    if version >> 8 != 1:
        raise ValueError("of version 7.3, which is HDF5; save it with -v7")
    variables: dict[str, ArrayOrText] = {}
    memory_in_use = len(data)
    for kind, content in _data_elements(memoryview(data)[_HEADER_SIZE:], order):
        entries: Iterable[tuple[str, ArrayOrText]]
        if kind == _COMPRESSED:
            entries, extra_memory = _read_compressed(content, order, source, memory_in_use)
            memory_in_use += extra_memory
        elif kind == _MATRIX:
            entries = _read_variables(content, order)
        else:
            raise ValueError(f"a data element of type {kind}, where a variable is expected")
        for name, value in entries:
            if name in variables:
                raise ValueError(f"the variable {name!r} is there twice")
            variables[name] = value
    variables.pop("", None)  # MATLAB's own workspace of function handles has no name
    return variables


def describe_object(kind: str) -> str:
    """Describe an object of a MATLAB class, and how its numbers become arrays that can be read."""
    conversion = _CONVERSIONS.get(kind, "take its numbers out as arrays,")
    return f"a {kind} object, which only MATLAB can read (there: {conversion} and save those)"


def _read_compressed(
    content: memoryview, order: str, source: str, memory_in_use: int
) -> tuple[Iterable[tuple[str, ArrayOrText]], int]:
    """Return the variables of a compressed element, and the memory that they hold.

    An array is decompressed when it is read; a struct at once, as its fields are needed.
    """
    # the first bytes tell type, shape and name; most variables of a recording are never decompressed further
    start, complete = _inflate(content, _HEAD_BYTES)
    kind, size = struct.unpack_from(f"{order}II", start)
    if kind != _MATRIX:
        raise ValueError(f"a data element of type {kind}, where a variable is expected")
    if complete:
        return _read_variables(next(_data_elements(start, order))[1], order), len(start)
    name, value = _read_variable(start[8:], order, complete=False)

    def decompress() -> memoryview:
        # a few bytes more than claimed: the tag and the padding
        inner, complete = _inflate(content, size + 16)
        if not complete:
            raise ValueError(f"the variable {name!r} is cut off, or larger than it claims")
        return next(_data_elements(inner, order))[1]

    if isinstance(value, StoredArray):
        return [(name, replace(value, read=lambda: _read_array(_read_variable(decompress(), order)[1]), extra=size))], 0
    if value != _STRUCT:
        return [(name, value)], 0
    afford(memory_in_use + size, f"{source}: to read the struct {name!r} would take")
    return _read_variables(decompress(), order), size


def _inflate(content: memoryview, limit: int) -> tuple[memoryview, bool]:
    """Return at most ``limit`` bytes of the content of a compressed element, and whether that is all."""
    stream = zlib.decompressobj()
    return memoryview(stream.decompress(content, limit)), stream.eof


def _read_array(value: ArrayOrText) -> NDArray[Any]:
    if isinstance(value, str):
        raise ValueError(f"{value}, where an array is expected")
    return value.read()


def _data_elements(data: memoryview, order: str, *, complete: bool = True) -> Iterator[tuple[int, memoryview]]:
    """Yield type and content of consecutive data elements; short ones are packed into their own tag.

    Unless ``complete``, the last one may be cut off.
    """
    at = 0
    while at < len(data):
        kind, size = struct.unpack_from(f"{order}II", data, at)
        start, after = at + 8, at + 8 + size
        # short element: the upper half of the tag is the size, and the content follows in the same 8 bytes
        if kind >> 16:
            kind, size = kind & 0xFFFF, kind >> 16
            start, after = at + 4, at + 8
        elif kind != _COMPRESSED:
            # contents are padded to multiples of 8 bytes, except compressed ones
            after += -size % 8
        if (complete and start + size > len(data)) or (start == at + 4 and size > 4):
            raise ValueError(f"a data element of {size} bytes is cut off")
        yield kind, data[start : start + size]
        at = after


def _read_variables(content: memoryview, order: str, prefix: str = "") -> Iterator[tuple[str, ArrayOrText]]:
    """Yield name and value of a variable; for a single struct those of its fields, as ``struct.field``."""
    name, value = _read_variable(content, order)
    path = f"{prefix}{name}"
    if not (isinstance(value, str) and value == _STRUCT) or prefix.count(".") > _MAX_STRUCT_DEPTH:
        yield path, value
        return
    parts = _data_elements(content, order)
    _, dimensions, _, width, names = (_next_element(parts)[1] for _ in range(5))
    (size,) = struct.unpack_from(f"{order}i", width)
    # only a single struct has fields with one value each
    if size < 1 or np.frombuffer(dimensions, f"{order}i4").prod() != 1:
        yield path, value
        return
    for k in range(0, len(names), size):  # each padded to the size
        field = bytes(names[k : k + size]).split(b"\0")[0].decode("latin-1")
        kind, inner = _next_element(parts)
        if kind != _MATRIX:
            raise ValueError(f"the field {path}.{field} is a data element of type {kind}")
        yield from _read_variables(inner, order, f"{path}.{field}") if inner else ()


def _read_variable(content: memoryview, order: str, *, complete: bool = True) -> tuple[str, ArrayOrText]:
    """Return name and value of a variable: its elements are flags, dimensions, name, and the real part.

    Unless ``complete``, the real part may be cut off, and must not be read.
    """
    parts = _data_elements(content, order, complete=complete)
    flags = _next_element(parts)[1]
    (flag_bits,) = struct.unpack_from(f"{order}I", flags)
    kind, shape = _next_element(parts)
    if kind == _INT8:  # opaque objects have no dimensions, and tell their name first, then system and class
        words = [bytes(next(parts, (0, b""))[1]).decode("latin-1") for _ in range(2)]
        return bytes(shape).decode("latin-1"), describe_object(words[1]) if words[1].isprintable() else "an object"
    name = bytes(_next_element(parts)[1]).decode("latin-1")
    if flag_bits & 0xFF not in _NUMERIC_CODES:
        return name, _CLASSES.get(flag_bits & 0xFF, "an object")
    if flag_bits & _COMPLEX_FLAG:
        return name, "complex numbers"
    kind, real = _next_element(parts)
    if kind not in _NUMBER_TYPES:
        raise ValueError(f"the variable {name!r} has numbers of type {kind}, which is unknown")
    dimensions = [int(n) for n in np.frombuffer(shape, f"{order}i4")]
    if min(dimensions, default=-1) < 0:
        raise ValueError(f"the variable {name!r} has the dimensions {dimensions}")
    dtype = np.dtype(order + _NUMBER_TYPES[kind])
    if complete:
        return name, wrap_array(np.frombuffer(real, dtype).reshape(dimensions, order="F"))
    return name, StoredArray(tuple(dimensions), dtype, lambda: np.empty(0))


def _next_element(parts: Iterator[tuple[int, memoryview]]) -> tuple[int, memoryview]:
    part = next(parts, None)
    if part is None:
        raise ValueError("a variable is cut off")
    return part


@contextmanager
def open_hdf5(file: BinaryIO, source: str) -> Iterator[dict[str, ArrayOrText]]:
    """Open the arrays of a file by name (``group/name``), or a description of what is not a numeric array.

    Fields of MATLAB's structs are named ``struct.field``, as those of older files. Arrays written by MATLAB are
    transposed to MATLAB's own shape. A group with several names is read under one. Raises
    InputError where h5py is not installed, and almost any exception where the file is damaged.
    """
    try:
        import h5py
    except ImportError as error:
        raise InputError(
            f"{source}: HDF5 (MATLAB 7.3) is read by h5py; install it by: {install_command('h5py')}"
        ) from error
    size = file.seek(0, 2)
    with h5py.File(file, "r") as content:
        yield {name: _item_content(item, size) for name, item in _walk_items(content, source)}


def _walk_items(file: Any, source: str) -> Iterator[tuple[str, Any]]:
    """Yield the data sets by name, and None for a link.

    Each group is visited once, as hard links may form cycles.
    """
    import h5py

    # a list that grows while it is walked: breadth first, without recursion
    groups, visited, count = [("", file, 0)], {h5py.h5o.get_info(file.id).addr}, 0
    for prefix, group, level in groups:
        for key in group:
            count += 1
            if count > _MAX_OBJECTS:
                raise InputError(f"{source}: holds more than {_MAX_OBJECTS} objects; copy the columns to a new file.")
            name = f"{prefix}{key}"
            if key in ("#refs#", "#subsystem#"):  # where MATLAB keeps the inside of cells and objects
                continue
            # soft and external links are not followed: they may lead to other files
            if not isinstance(group.get(key, getlink=True), h5py.HardLink):
                yield name, None
                continue
            item = group[key]
            kind = _matlab_class(item)
            if isinstance(item, h5py.Group) and (not kind or (kind == "struct" and len(item))):
                address = h5py.h5o.get_info(item.id).addr
                # the address identifies a group, whatever its name
                if address not in visited and level < _MAX_GROUP_DEPTH:
                    visited.add(address)
                    groups.append((f"{name}{'.' if kind else '/'}", item, level + 1))
            elif isinstance(item, h5py.Dataset | h5py.Group):
                yield name, item


def _item_content(item: Any, size: int) -> ArrayOrText:
    """Return the array of a data set, or a description of it; ``size`` is the size of the file in bytes."""
    if item is None:
        return "a link"
    kind = _matlab_class(item)
    if kind == "struct" or not hasattr(item, "dtype"):
        return "a struct" if kind == "struct" else describe_object(kind)
    if kind and kind not in _NUMERIC_CLASSES:
        return _OBJECTS.get(kind) or describe_object(kind)
    if "MATLAB_empty" in item.attrs:
        return wrap_array(np.empty(0))
    if item.dtype.kind not in "biuf":
        return _describe_type(item)
    if item.external or item.is_virtual:
        return "data of another file"
    # a header can claim more than the file can hold, even with the best compression
    if item.size and item.nbytes > _MAX_DEFLATE_RATIO * size:
        raise ValueError(f"{item.name} claims {item.nbytes} bytes in a file of {size}")
    shape = item.shape or ()
    chunk = math.prod(item.chunks or ()) * item.dtype.itemsize
    # MATLAB stores columns first
    if kind:
        return StoredArray(shape[::-1], item.dtype, lambda: _read_dataset(item, chunk).T, chunk)
    return StoredArray(shape, item.dtype, lambda: _read_dataset(item, chunk), chunk)


def _matlab_class(item: Any) -> str:
    """Return the MATLAB class of a group or a data set; empty where MATLAB did not write it."""
    kind = item.attrs.get("MATLAB_class", "") if hasattr(item, "attrs") else ""
    return kind.decode("latin-1") if isinstance(kind, bytes) else str(kind)


def _read_dataset(item: Any, chunk: int) -> NDArray[Any]:
    """Read a data set; ValueError where a compressed chunk holds more than it should."""
    oversized: list[int] = []

    def examine(stored: Any) -> None:
        """Note a chunk that would hold more than it should after decompression."""
        # the stored size first; gzip is inflated, up to the limit, only where it could exceed the memory
        if stored.size > chunk + _MAX_FILTER_OVERHEAD and not oversized:
            oversized.append(stored.size)
        elif _MAX_DEFLATE_RATIO * stored.size > max(memory_budget(), chunk) and item.compression == "gzip":
            data = item.id.read_direct_chunk(stored.chunk_offset)[1]
            if not stored.filter_mask and _inflates_beyond(data, chunk + _MAX_FILTER_OVERHEAD):
                oversized.append(stored.size)

    if item.chunks:
        item.id.chunk_iter(examine)
    if oversized:
        raise ValueError(f"{item.name} has a chunk of {oversized[0]} bytes that holds more than the {chunk} it should")
    return np.asarray(item[()])


def _inflates_beyond(data: bytes, limit: int) -> bool:
    """Return whether the decompressed data are longer than ``limit`` bytes."""
    # in pieces, without keeping the output
    stream, count, remaining = zlib.decompressobj(), 0, data
    while remaining and not stream.eof and count <= limit:
        count += len(stream.decompress(remaining, _INFLATE_SIZE))
        remaining = stream.unconsumed_tail
    return count > limit


def _describe_type(item: Any) -> str:
    import h5py

    if h5py.check_ref_dtype(item.dtype) is not None:
        return _STRUCT_ARRAY
    return "complex numbers" if item.dtype.names == ("real", "imag") else f"values of type {item.dtype}"
