"""Numeric arrays of HDF5 files and of MATLAB files of version 7.3, by the package h5py.

Nothing outside the file is opened: links to other files, and data in them, are reported as such.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError, install_command, memory
from dynident.io.arrays import Found, StoredArray, held
from dynident.io.matlab import described

__all__ = ["is_hdf5", "opened_hdf5"]

_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_MATLAB_HEADER = 512  # bytes that MATLAB puts before the HDF5 file
_OBJECTS = {"char": "text", "string": "text", "cell": "a cell array", "function_handle": "an object"}
_STRUCTS = "an array of structs or cells (in MATLAB, take one: x = s(1).field; and save that)"
_NUMERIC = ("double", "single", "logical", *(f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)))
_RATIO = 1100  # more than this, deflate cannot compress
_MOST, _DEEPEST = 50_000, 20  # objects, and levels of groups
_FRAME, _PART = 1 << 16, 1 << 20  # bytes that filters may add to a chunk; those decompressed at a time


def is_hdf5(file: BinaryIO) -> bool:
    """Return whether a file is of HDF5, with or without MATLAB's header."""
    file.seek(0)
    data = file.read(_MATLAB_HEADER + len(_SIGNATURE))
    return data.startswith(_SIGNATURE) or data[_MATLAB_HEADER:].startswith(_SIGNATURE)


@contextmanager
def opened_hdf5(file: BinaryIO, source: str) -> Iterator[dict[str, Found]]:
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
        yield {name: _found(item, size) for name, item in _items(content, source)}


def _items(file: Any, source: str) -> Iterator[tuple[str, Any]]:
    """Yield the data sets by name, and None for a link; a group is visited once, as hard links may form rings."""
    import h5py

    groups, seen, count = [("", file, 0)], {h5py.h5o.get_info(file.id).addr}, 0
    for prefix, group, level in groups:
        for key in group:
            count += 1
            if count > _MOST:
                raise InputError(f"{source}: holds more than {_MOST} objects; copy the columns to a new file.")
            name = f"{prefix}{key}"
            if key in ("#refs#", "#subsystem#"):  # where MATLAB keeps the inside of cells and objects
                continue
            if not isinstance(group.get(key, getlink=True), h5py.HardLink):
                yield name, None
                continue
            item = group[key]
            kind = _class(item)
            if isinstance(item, h5py.Group) and (not kind or (kind == "struct" and len(item))):
                address = h5py.h5o.get_info(item.id).addr
                if address not in seen and level < _DEEPEST:
                    seen.add(address)
                    groups.append((f"{name}{'.' if kind else '/'}", item, level + 1))
            elif isinstance(item, h5py.Dataset | h5py.Group):
                yield name, item


def _found(item: Any, size: int) -> Found:
    """Return the array of a data set, or a description of it; ``size`` is that of the file in bytes."""
    if item is None:
        return "a link"
    kind = _class(item)
    if kind == "struct" or not hasattr(item, "dtype"):
        return "a struct" if kind == "struct" else described(kind)
    if kind and kind not in _NUMERIC:
        return _OBJECTS.get(kind) or described(kind)
    if "MATLAB_empty" in item.attrs:
        return held(np.empty(0))
    if item.dtype.kind not in "biuf":
        return _content(item)
    if item.external or item.is_virtual:
        return "data of another file"
    if item.size and item.nbytes > _RATIO * size:
        raise ValueError(f"{item.name} claims {item.nbytes} bytes in a file of {size}")
    shape = item.shape or ()
    chunk = math.prod(item.chunks or ()) * item.dtype.itemsize
    if kind:
        return StoredArray(shape[::-1], item.dtype, lambda: _read(item, chunk).T, chunk)
    return StoredArray(shape, item.dtype, lambda: _read(item, chunk), chunk)


def _class(item: Any) -> str:
    """Return MATLAB's class of a group or a data set; nothing where MATLAB did not write it."""
    kind = item.attrs.get("MATLAB_class", "") if hasattr(item, "attrs") else ""
    return kind.decode("latin-1") if isinstance(kind, bytes) else str(kind)


def _read(item: Any, chunk: int) -> NDArray[Any]:
    """Return the array of a data set; ValueError where a compressed chunk holds more than it should."""
    wrong: list[int] = []

    def examine(stored: Any) -> None:
        """Note a chunk that would hold more than it should once it is decompressed."""
        if stored.size > chunk + _FRAME and not wrong:
            wrong.append(stored.size)
        elif _RATIO * stored.size > max(memory(), chunk) and item.compression == "gzip":
            data = item.id.read_direct_chunk(stored.chunk_offset)[1]
            if not stored.filter_mask and _inflates_beyond(data, chunk + _FRAME):
                wrong.append(stored.size)

    if item.chunks:
        item.id.chunk_iter(examine)
    if wrong:
        raise ValueError(f"{item.name} has a chunk of {wrong[0]} bytes that holds more than the {chunk} it should")
    return np.asarray(item[()])


def _inflates_beyond(data: bytes, most: int) -> bool:
    """Whether the data, decompressed, are more than so many bytes."""
    stream, count, rest = zlib.decompressobj(), 0, data
    while rest and not stream.eof and count <= most:
        count += len(stream.decompress(rest, _PART))
        rest = stream.unconsumed_tail
    return count > most


def _content(item: Any) -> str:
    import h5py

    if h5py.check_ref_dtype(item.dtype) is not None:
        return _STRUCTS
    return "complex numbers" if item.dtype.names == ("real", "imag") else f"values of type {item.dtype}"
