"""The number of values in each column of a Parquet file, from its footer: what reading a column of lists would take.

Format: https://parquet.apache.org/docs/file-format/metadata/, in Thrift's compact protocol.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping
from typing import Any, BinaryIO

__all__ = ["footer", "value_counts"]

_DEEPEST = 20
_ROW_GROUPS, _CHUNKS, _META, _PATH, _COUNT = 4, 1, 3, 3, 5  # the fields of the footer that are used


def footer(file: BinaryIO) -> bytes:
    """Return the end of a file from its footer on."""
    length = file.seek(0, 2)
    file.seek(max(length - 8, 0))
    size = int.from_bytes(file.read(4), "little")
    file.seek(max(length - 8 - size, 0))
    return file.read()


def value_counts(data: bytes) -> Mapping[tuple[str, ...], int]:
    """Return the number of values by the path of a column, from the ``footer``.

    Raises ValueError or IndexError where it is damaged.
    """
    size = int.from_bytes(data[-8:-4], "little")
    if data[-4:] != b"PAR1" or size + 8 > len(data):
        raise ValueError("has no footer of a Parquet file")
    counts: Counter[tuple[str, ...]] = Counter()
    for group in _Compact(data[-8 - size : -8]).struct().get(_ROW_GROUPS, ()):
        for chunk in group.get(_CHUNKS, ()):
            meta = chunk.get(_META, {})
            counts[tuple(part.decode() for part in meta.get(_PATH, ()))] += max(meta.get(_COUNT, 0), 0)
    return counts


class _Compact:
    """Reads values one after the other; structs are mappings by the numbers of their fields."""

    def __init__(self, data: bytes) -> None:
        self._data, self._at, self._level = data, 0, 0
        number = self._zigzag
        self._readers: Mapping[int, Callable[[], Any]] = {
            1: self._byte, 2: self._byte, 3: self._byte, 4: number, 5: number, 6: number,
            7: lambda: self._bytes(8), 8: lambda: self._bytes(self._varint()),
            9: self._list, 10: self._list, 11: self._map, 12: self.struct,
        }  # fmt: skip

    def struct(self) -> dict[int, Any]:
        """Return the fields of a struct by their numbers."""
        self._level += 1
        if self._level > _DEEPEST:
            raise ValueError("has a footer of too many levels")
        found, last = {}, 0
        while head := self._byte():
            last = last + (head >> 4) if head >> 4 else self._zigzag()
            kind = head & 15
            found[last] = kind == 1 if kind in (1, 2) else self._readers[kind]()
        self._level -= 1
        return found

    def _list(self) -> list[Any]:
        head = self._byte()
        size = self._varint() if head >> 4 == 15 else head >> 4
        if size > len(self._data) - self._at:
            raise ValueError("has a footer that is cut off")
        return [self._readers[head & 15]() for _ in range(size)]

    def _map(self) -> None:
        if size := self._varint():
            kinds = self._byte()
            if size > len(self._data) - self._at:
                raise ValueError("has a footer that is cut off")
            for _ in range(size):
                self._readers[kinds >> 4]()
                self._readers[kinds & 15]()

    def _zigzag(self) -> int:
        number = self._varint()
        return (number >> 1) ^ -(number & 1)

    def _varint(self) -> int:
        number = shift = 0
        while True:
            byte = self._byte()
            number |= (byte & 127) << shift
            shift += 7
            if byte < 128 or shift > 63:
                return number

    def _bytes(self, size: int) -> bytes:
        self._at += size
        if self._at > len(self._data):
            raise ValueError("has a footer that is cut off")
        return self._data[self._at - size : self._at]

    def _byte(self) -> int:
        self._at += 1
        return self._data[self._at - 1]
