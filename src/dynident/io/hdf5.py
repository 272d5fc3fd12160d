"""Numeric arrays of HDF5 files and of MATLAB files of version 7.3, by the library h5py (extra ``hdf5``).

Nothing outside the file is opened: links to other files, and data in them, are reported as such.
"""

from __future__ import annotations

from io import BytesIO
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError

__all__ = ["is_hdf5", "parse_hdf5"]

_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_MATLAB_HEADER = 512  # bytes that MATLAB puts before the HDF5 file
_OBJECTS = {b"char": "text", b"cell": "a cell array", b"function_handle": "an object"}
_RATIO = 1100  # more than this, deflate cannot compress


def is_hdf5(data: bytes) -> bool:
    """Return whether the bytes are an HDF5 file, with or without MATLAB's header."""
    return data.startswith(_SIGNATURE) or data[_MATLAB_HEADER:].startswith(_SIGNATURE)


def parse_hdf5(data: bytes, source: str) -> dict[str, NDArray[Any] | str]:
    """Return the arrays of a file by name (``group/name``), and a description of what is not a numeric array.

    Arrays written by MATLAB are transposed to MATLAB's own shape. Raises InputError where the extra is not installed,
    and almost any exception where the file is damaged.
    """
    try:
        import h5py
    except ImportError as error:
        raise InputError(
            f'{source}: to read HDF5 (MATLAB 7.3), install the extra "hdf5": pip install "dynident[hdf5]"'
        ) from error
    found: dict[str, NDArray[Any] | str] = {}

    def visit(group: Any, prefix: str) -> None:
        for key in group:
            name, link = f"{prefix}{key}", group.get(key, getlink=True)
            if key in ("#refs#", "#subsystem#"):  # where MATLAB keeps the inside of cells and objects
                continue
            if not isinstance(link, h5py.HardLink):
                found[name] = "a link"
                continue
            item = group[key]
            if isinstance(item, h5py.Dataset):
                found[name] = _values(item, len(data))
            elif isinstance(item, h5py.Group) and "MATLAB_class" in item.attrs:
                found[name] = "a struct"
            elif isinstance(item, h5py.Group) and name.count("/") < 20:  # hard links may form rings
                visit(item, f"{name}/")

    with h5py.File(BytesIO(data), "r") as file:
        visit(file, "")
    return found


def _values(item: Any, size: int) -> NDArray[Any] | str:
    """Return the array of a dataset, or a description of it; ``size`` is that of the file in bytes."""
    kind = item.attrs.get("MATLAB_class")
    if isinstance(kind, bytes) and kind in _OBJECTS:
        return _OBJECTS[kind]
    if "MATLAB_empty" in item.attrs:
        return np.empty(0)
    if item.dtype.kind not in "biuf":
        return _content(item)
    if item.external or item.is_virtual:
        return "data of another file"
    if item.size and item.nbytes > _RATIO * size:
        raise ValueError(f"{item.name} claims {item.nbytes} bytes in a file of {size}")
    values = np.asarray(item[()])
    return values.T if kind is not None else values


def _content(item: Any) -> str:
    return "complex numbers" if item.dtype.names == ("real", "imag") else f"values of type {item.dtype}"
