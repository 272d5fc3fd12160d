"""The files of a ROS bag: regular ones, and chunks that hold no more than a bag may once they are decompressed."""

from __future__ import annotations

import sqlite3
from bz2 import BZ2Decompressor
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from importlib import import_module
from pathlib import Path
from threading import Lock
from types import SimpleNamespace
from typing import Any, BinaryIO
from urllib.parse import quote

from dynident.errors import MEMORY, InputError, memory
from dynident.io.opener import opened, text
from dynident.io.yaml_text import load_yaml

__all__ = ["chunks_within_budget", "examine_files"]

_SHARE = 32  # of the budget, what chunks hold beyond the usual ratio
_RATIO = 100  # chunks of a recording are compressed less
_MOST_FRAMES = 1000
_PART = 1 << 20
_ONE = Lock()  # bags are read in turn: what ``chunks_within_budget`` replaces is one for the whole process


def examine_files(path: Path) -> None:
    """Raise InputError or ConfigError where a file of a bag is no regular one, or would compute what it holds."""
    for file in sorted(path.iterdir()) if path.is_dir() else [path]:
        if file.is_dir():
            continue
        with opened(file) as data:
            database = data.read(16) == b"SQLite format 3\0"
        if file.name == "metadata.yaml":
            load_yaml(text(file), str(file))
        if database:
            _examine_database(file)


def _examine_database(path: Path) -> None:
    place = f"file:{quote(str(path.absolute()))}?mode=ro&immutable=1"
    with closing(sqlite3.connect(place, uri=True)) as database:
        for kind, name, sql in database.execute("SELECT type, name, sql FROM sqlite_master"):
            if kind in ("view", "trigger") or any(word in str(sql).upper() for word in (" AS ", " AS(", "VIRTUAL")):
                raise InputError(f"{path}: {name!r} is no plain table; a recording of ROS has no other.")


@contextmanager
def chunks_within_budget(path: Path) -> Iterator[None]:
    """Let the library rosbags decompress within a budget: a 32nd of a file's, and 100 times what is compressed.

    One bag at a time, as rosbags holds its decompressors in tables of its modules; they are put back. Raises InputError
    where a chunk holds more, and where a length is beyond the memory.
    """
    from rosbags.rosbag1 import reader as ros1
    from rosbags.rosbag2 import reader as ros2
    from rosbags.rosbag2 import storage_mcap as mcap

    bounded = _Bounded(path)
    tables: list[tuple[dict[str, Any], dict[str, Any]]] = [
        (ros1.decompressors, {"bz2": bounded.bz2, "lz4": bounded.lz4}),
        (mcap.DECOMPRESSORS, {"lz4": bounded.lz4, "zstd": bounded.zstd}),
        (vars(ros2), {"zstd": SimpleNamespace(decompress=bounded.zstd, open=bounded.open)}),
    ]
    with _ONE:
        before = [dict(table) for table, _ in tables]
        try:
            for table, replaced in tables:
                table |= {name: replaced[name] for name in replaced if name in table}
            yield
        except MemoryError as error:  # rosbags takes any length that a bag gives for true
            raise InputError(
                f"{path}: a part of it is longer than the memory, as where a length in it is damaged; record again, or "
                "write what you need to another bag."
            ) from error
        finally:
            for (table, replaced), old in zip(tables, before, strict=True):
                table |= {name: old[name] for name in replaced if name in old}


class _Bounded:
    """The decompressors of a bag, which share one budget."""

    def __init__(self, path: Path) -> None:
        self.path, self.left = path, memory() // _SHARE

    def bz2(self, data: bytes, *_: object) -> bytes:
        return self._decompressed(BZ2Decompressor, data)

    def lz4(self, data: bytes, *_: object) -> bytes:
        return self._decompressed(import_module("lz4.frame").LZ4FrameDecompressor, data)

    def zstd(self, data: bytes, *_: object) -> bytes:
        return self._decompressed(_zstd().ZstdDecompressor, data)

    @contextmanager
    def open(self, file: BinaryIO, mode: str) -> Iterator[SimpleNamespace]:
        """Open a compressed file, as ``zstd.open``; only ``read`` is needed."""
        self.left += _RATIO * file.seek(0, 2)
        file.seek(0)
        with _zstd().open(file, mode) as inside:

            def read(count: int = _PART) -> bytes:
                data: bytes = inside.read(min(count, _PART))
                self._spend(len(data))
                return data

            yield SimpleNamespace(read=read)

    def _decompressed(self, make: Callable[[], Any], data: bytes) -> bytes:
        self.left += _RATIO * len(data)
        parts: list[bytes] = []
        while data:
            stream = make()
            parts.append(stream.decompress(data, max(self.left, 0) + 1))
            self._spend(len(parts[-1]))
            data = stream.unused_data if stream.eof else b""
            if not stream.eof or len(parts) > _MOST_FRAMES:
                raise ValueError("a compressed chunk is cut off, or is many")
        return b"".join(parts)

    def _spend(self, count: int) -> None:
        self.left -= count
        if self.left < 0:
            raise InputError(
                f"{self.path}: decompressed, it takes {_RATIO} times its size and {memory() / _SHARE / 1e9:.3g} GB "
                f"more; raise this by --memory or {MEMORY} (in GB), if the file is what it should be."
            )


def _zstd() -> Any:
    """Return the module of zstd: of the standard library, or the one that rosbags takes before Python 3.14."""
    try:
        return import_module("compression.zstd")
    except ImportError:
        return import_module("backports.zstd")
