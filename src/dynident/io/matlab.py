"""Numeric arrays of MATLAB files of version 5 to 7.2 (format: MathWorks, "MAT-File Format", Level 5).

Only what a recording needs is read, with every size checked: the compiled reader of SciPy reads more kinds of
variables, but a damaged file can crash it, and with it the interpreter.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["parse_mat"]

_HEADER = 128
_TYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_INT8, _MATRIX, _COMPRESSED = 1, 14, 15  # types of data elements
_NUMERIC = range(6, 16)  # classes of arrays, from double to uint64
_STRUCT, _DEEPEST = "a struct", 20  # deeper nesting of structs is taken for damage
_CLASSES = {1: "a cell array", 2: _STRUCT, 3: "an object", 4: "text", 5: "a sparse matrix"}
_COMPLEX = 0x800


def parse_mat(data: bytes) -> dict[str, NDArray[Any] | str]:
    """Return the arrays of a file by name, and a description of what is not an array of real numbers.

    Raises ValueError, zlib.error or struct.error where the file is damaged, or of another version.
    """
    order = {b"IM": "<", b"MI": ">"}.get(data[126:_HEADER])
    if order is None:
        raise ValueError("no header of version 5; save it with -v7")
    (version,) = struct.unpack_from(f"{order}H", data, 124)
    if version >> 8 != 1:
        raise ValueError("of version 7.3, which is HDF5; save it with -v7")
    variables: dict[str, NDArray[Any] | str] = {}
    for kind, content in _elements(data[_HEADER:], order):
        if kind == _COMPRESSED:
            kind, content = next(_elements(zlib.decompress(content), order), (0, b""))
        if kind != _MATRIX:
            raise ValueError(f"a data element of type {kind}, where a variable is expected")
        for name, value in _variables(content, order):
            if name in variables:
                raise ValueError(f"the variable {name!r} is there twice")
            variables[name] = value
    variables.pop("", None)  # MATLAB's own workspace of function handles has no name
    return variables


def _elements(data: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Yield type and content of the data elements in a row; short ones are packed into their own tag."""
    at = 0
    while at < len(data):
        kind, size = struct.unpack_from(f"{order}II", data, at)
        start, after = at + 8, at + 8 + size
        if kind >> 16:
            kind, size = kind & 0xFFFF, kind >> 16
            start, after = at + 4, at + 8
        elif kind != _COMPRESSED:
            after += -size % 8
        if start + size > len(data) or (start == at + 4 and size > 4):
            raise ValueError(f"a data element of {size} bytes is cut off")
        yield kind, data[start : start + size]
        at = after


def _variables(content: bytes, order: str, within: str = "") -> Iterator[tuple[str, NDArray[Any] | str]]:
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


def _fields(names: bytes, size: int) -> list[str]:
    """Return the names of a struct's fields, each of so many bytes."""
    return [names[k : k + size].split(b"\0")[0].decode("latin-1") for k in range(0, len(names), size)]


def _variable(content: bytes, order: str) -> tuple[str, NDArray[Any] | str]:
    """Return name and value of a variable: its elements are flags, dimensions, name, and the real part."""
    parts = _elements(content, order)
    flags = _next(parts)[1]
    (word,) = struct.unpack_from(f"{order}I", flags)
    kind, shape = _next(parts)
    if kind == _INT8:  # opaque objects have no dimensions, and tell their name first
        return shape.decode("latin-1"), "an object"
    name = _next(parts)[1].decode("latin-1")
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
    return name, np.frombuffer(real, order + _TYPES[kind]).reshape(dimensions, order="F")


def _next(parts: Iterator[tuple[int, bytes]]) -> tuple[int, bytes]:
    part = next(parts, None)
    if part is None:
        raise ValueError("a variable is cut off")
    return part
