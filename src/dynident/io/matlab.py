"""Numeric arrays of MATLAB files of version 5 to 7.2 (format: MathWorks, "MAT-File Format", Level 5).

Only what a recording needs is read, with every size checked: the compiled reader of SciPy reads more kinds of
variables, but a damaged file can crash it, and with it the interpreter. A compressed variable is decompressed when it
is read, and never beyond the size that it claims.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.io.arrays import Found, StoredArray, held
from dynident.io.opener import afford

__all__ = ["described", "parse_mat"]

_HEADER = 128
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_INT8, _MATRIX, _COMPRESSED = 1, 14, 15  # types of data elements
_NUMERIC = range(6, 16)  # classes of arrays, from double to uint64
_STRUCT, _DEEPEST = "a struct", 20  # deeper nesting of structs is taken for damage
_CLASSES = {1: "a cell array", 2: _STRUCT, 3: "an object", 4: "text", 5: "a sparse matrix"}
_EXPORTED = {  # how the numbers of an object become arrays, in MATLAB
    "timeseries": "t = x.Time; q = squeeze(x.Data);",
    "timetable": "t = seconds(x.Properties.RowTimes - x.Properties.RowTimes(1)); q = x.Variables;",
    "table": "q = table2array(x);",
    "datetime": "t = seconds(x - x(1));",
    "duration": "t = seconds(x);",
}
_COMPLEX = 0x800
_PEEK = 4096  # bytes in which flags, dimensions and name of an array are


def parse_mat(data: bytes, source: str = "") -> dict[str, Found]:
    """Return the arrays of a file by name, and a description of what is not an array of real numbers.

    Raises ValueError, zlib.error or struct.error where the file is damaged, or of another version.
    """
    order = {b"IM": "<", b"MI": ">"}.get(data[126:_HEADER])
    if order is None:
        raise ValueError("no header of version 5; save it with -v7")
    (version,) = struct.unpack_from(f"{order}H", data, 124)
    if version >> 8 != 1:
        raise ValueError("of version 7.3, which is HDF5; save it with -v7")
    variables: dict[str, Found] = {}
    taken = len(data)
    for kind, content in _elements(memoryview(data)[_HEADER:], order):
        found: Iterable[tuple[str, Found]]
        if kind == _COMPRESSED:
            found, more = _compressed(content, order, source, taken)
            taken += more
        elif kind == _MATRIX:
            found = _variables(content, order)
        else:
            raise ValueError(f"a data element of type {kind}, where a variable is expected")
        for name, value in found:
            if name in variables:
                raise ValueError(f"the variable {name!r} is there twice")
            variables[name] = value
    variables.pop("", None)  # MATLAB's own workspace of function handles has no name
    return variables


def described(kind: str) -> str:
    """Return what an object of a class of MATLAB is, and how its numbers become arrays, which can be read."""
    how = _EXPORTED.get(kind, "take its numbers out as arrays,")
    return f"a {kind} object, which only MATLAB can read (there: {how} and save those)"


def _compressed(content: memoryview, order: str, source: str, taken: int) -> tuple[Iterable[tuple[str, Found]], int]:
    """Return the variables of a compressed element, and the memory that they hold: that of a struct, as it is opened.

    An array is decompressed when it is read.
    """
    start, complete = _inflated(content, _PEEK)
    kind, size = struct.unpack_from(f"{order}II", start)
    if kind != _MATRIX:
        raise ValueError(f"a data element of type {kind}, where a variable is expected")
    if complete:
        return _variables(next(_elements(start, order))[1], order), len(start)
    name, value = _variable(start[8:], order, whole=False)

    def whole() -> memoryview:
        inner, complete = _inflated(content, size + 16)
        if not complete:
            raise ValueError(f"the variable {name!r} is cut off, or larger than it claims")
        return next(_elements(inner, order))[1]

    if isinstance(value, StoredArray):
        return [(name, replace(value, read=lambda: _read(_variable(whole(), order)[1]), extra=size))], 0
    if value != _STRUCT:
        return [(name, value)], 0
    afford(taken + size, f"{source}: to read the struct {name!r} would take")
    return _variables(whole(), order), size


def _inflated(content: memoryview, most: int) -> tuple[memoryview, bool]:
    """Return no more than so many bytes of what a compressed element holds, and whether that is all."""
    stream = zlib.decompressobj()
    return memoryview(stream.decompress(content, most)), stream.eof


def _read(value: Found) -> NDArray[Any]:
    if isinstance(value, str):
        raise ValueError(f"{value}, where an array is expected")
    return value.read()


def _elements(data: memoryview, order: str, *, whole: bool = True) -> Iterator[tuple[int, memoryview]]:
    """Yield type and content of the data elements in a row; short ones are packed into their own tag.

    Unless ``whole``, the last one may be cut off.
    """
    at = 0
    while at < len(data):
        kind, size = struct.unpack_from(f"{order}II", data, at)
        start, after = at + 8, at + 8 + size
        if kind >> 16:
            kind, size = kind & 0xFFFF, kind >> 16
            start, after = at + 4, at + 8
        elif kind != _COMPRESSED:
            after += -size % 8
        if (whole and start + size > len(data)) or (start == at + 4 and size > 4):
            raise ValueError(f"a data element of {size} bytes is cut off")
        yield kind, data[start : start + size]
        at = after


def _variables(content: memoryview, order: str, within: str = "") -> Iterator[tuple[str, Found]]:
    """Yield name and value of a variable; of a single struct those of its fields, as ``struct.field``."""
    name, value = _variable(content, order)
    path = f"{within}{name}"
    if not (isinstance(value, str) and value == _STRUCT) or within.count(".") > _DEEPEST:
        yield path, value
        return
    parts = _elements(content, order)
    _, dimensions, _, width, names = (_next(parts)[1] for _ in range(5))
    (size,) = struct.unpack_from(f"{order}i", width)
    if size < 1 or np.frombuffer(dimensions, f"{order}i4").prod() != 1:
        yield path, value
        return
    for field in _fields(names, size):
        kind, inner = _next(parts)
        if kind != _MATRIX:
            raise ValueError(f"the field {path}.{field} is a data element of type {kind}")
        yield from _variables(inner, order, f"{path}.{field}") if inner else ()


def _fields(names: memoryview, size: int) -> list[str]:
    """Return the names of a struct's fields, each of so many bytes."""
    return [bytes(names[k : k + size]).split(b"\0")[0].decode("latin-1") for k in range(0, len(names), size)]


def _variable(content: memoryview, order: str, *, whole: bool = True) -> tuple[str, Found]:
    """Return name and value of a variable: its elements are flags, dimensions, name, and the real part.

    Unless ``whole``, the real part may be cut off, and is not to be read.
    """
    parts = _elements(content, order, whole=whole)
    flags = _next(parts)[1]
    (word,) = struct.unpack_from(f"{order}I", flags)
    kind, shape = _next(parts)
    if kind == _INT8:  # opaque objects have no dimensions, and tell their name first, then system and class
        words = [bytes(next(parts, (0, b""))[1]).decode("latin-1") for _ in range(2)]
        return bytes(shape).decode("latin-1"), described(words[1]) if words[1].isprintable() else "an object"
    name = bytes(_next(parts)[1]).decode("latin-1")
    if word & 0xFF not in _NUMERIC:
        return name, _CLASSES.get(word & 0xFF, "an object")
    if word & _COMPLEX:
        return name, "complex numbers"
    kind, real = _next(parts)
    if kind not in _TYPES:
        raise ValueError(f"the variable {name!r} has numbers of type {kind}, which is unknown")
    dimensions = [int(n) for n in np.frombuffer(shape, f"{order}i4")]
    if min(dimensions, default=-1) < 0:
        raise ValueError(f"the variable {name!r} has the dimensions {dimensions}")
    dtype = np.dtype(order + _TYPES[kind])
    if whole:
        return name, held(np.frombuffer(real, dtype).reshape(dimensions, order="F"))
    return name, StoredArray(tuple(dimensions), dtype, lambda: np.empty(0))


def _next(parts: Iterator[tuple[int, memoryview]]) -> tuple[int, memoryview]:
    part = next(parts, None)
    if part is None:
        raise ValueError("a variable is cut off")
    return part
