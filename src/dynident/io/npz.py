"""Arrays of NumPy archives (format: numpy.lib.format): their headers first, the arrays when they are needed."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any, BinaryIO
from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipFile, ZipInfo

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from dynident.io.arrays import Found, StoredArray

__all__ = ["opened_npz"]

_HEADERS: dict[tuple[int, int], Callable[..., Any]] = {
    (1, 0): npy.read_array_header_1_0,
    (2, 0): npy.read_array_header_2_0,
}


@contextmanager
def opened_npz(file: BinaryIO) -> Iterator[dict[str, Found]]:
    """Open the arrays of an archive by name, or a description of what is none.

    Raises ValueError, and zipfile.BadZipFile, where it is damaged or holds a name twice.
    """
    with ZipFile(file) as archive:
        members = archive.infolist()
        for name, count in Counter(member.filename for member in members).items():
            if count > 1:
                raise ValueError(f"the array {name.removesuffix('.npy')!r} is there twice")
        yield {member.filename.removesuffix(".npy"): _found(archive, member) for member in members}


def _found(archive: ZipFile, member: ZipInfo) -> Found:
    if member.flag_bits & 1 or member.compress_type not in (ZIP_STORED, ZIP_DEFLATED):
        return "what numpy.savez does not write"
    if not member.filename.endswith(".npy"):
        return "what is no array"
    with archive.open(member) as data:
        shape, _, dtype = _header(data)
    if dtype.hasobject:
        return "Python objects, which are not read"
    return StoredArray(shape, dtype, partial(_read, archive, member))


def _header(data: Any) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    version = npy.read_magic(data)
    if version not in _HEADERS:
        raise ValueError(f"an array of version {version}")
    shape, turned, dtype = _HEADERS[version](data)
    return tuple(map(int, shape)), turned, dtype


def _read(archive: ZipFile, member: ZipInfo) -> NDArray[Any]:
    """Return an array: as many bytes as its header says, and no more."""
    with archive.open(member) as data:
        shape, turned, dtype = _header(data)
        size = math.prod(shape) * dtype.itemsize
        values = data.read(size)
        if len(values) < size or data.read(1):
            raise ValueError(f"the array {member.filename!r} is not of the size that its header says")
    return np.frombuffer(values, dtype).reshape(shape, order="F" if turned else "C")
