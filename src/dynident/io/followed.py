"""A file that grows, read to where it ends now: also after it was rotated, cut, or the reader was killed."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from contextlib import ExitStack
from hashlib import sha256
from pathlib import Path
from typing import Any, BinaryIO, Protocol

from dynident.errors import InputError
from dynident.io.opener import find, opened

__all__ = ["FollowedFile", "Read", "StandardInput", "Stream"]

CHUNK = 1 << 20  # bytes
MARK = 256  # bytes before a position that say whether it is the same file

Read = tuple[bytes, bool, bool]


class Stream(Protocol):
    """Where bytes come from."""

    def read(self) -> Read:
        """Return what is new, whether a new file begins with it, and whether the end is there for good."""

    def position(self, unread: int) -> dict[str, Any]:
        """Return, in plain types, where to go on reading when the last ``unread`` bytes are to come again."""

    def close(self) -> None:
        """Close what is open."""


class StandardInput:
    """Standard input, which cannot be read again; it ends when who writes to it does. Raises InputError without one."""

    def __init__(self) -> None:
        if sys.stdin is None:  # closed by who started this
            raise InputError("standard input is closed; give the path of a file, or write to it: ... | dynident watch")
        self._file = sys.stdin.buffer

    def read(self) -> Read:
        """Return what is there, and wait where there is nothing."""
        data = self._file.read1(CHUNK) if hasattr(self._file, "read1") else self._file.read(CHUNK)
        return data, False, not data

    def position(self, unread: int) -> dict[str, Any]:  # noqa: ARG002
        """Return nothing: what was read is gone."""
        return {}

    def close(self) -> None:
        """Leave it open: it is not ours."""


class FollowedFile:
    """A regular file at ``path``, from its beginning or from a saved ``position``.

    A file that takes its name (rotation) is read after the rest of it, from the beginning; so is one that is shorter
    than what was read of it. Raises InputError where it cannot be read.
    """

    def __init__(self, path: Path, position: Mapping[str, Any] | None = None) -> None:
        self.path, self.offset, self._fresh = path, 0, True
        self.found = not position  # whether it goes on where it was
        self._stack = ExitStack()
        self._file = self._begin(position or {})

    def read(self) -> Read:
        """Return what was written since, at most a megabyte."""
        data = self._file.read(CHUNK)
        if not data and self._replaced():
            self._open(self.path)
            self._fresh = True
            data = self._file.read(CHUNK)
        self.offset += len(data)
        fresh, self._fresh = (self._fresh, False) if data else (False, self._fresh)
        return data, fresh, False

    def position(self, unread: int) -> dict[str, Any]:
        """Return which file it is, where to go on in it, and what stands before."""
        found, at = os.fstat(self._file.fileno()), self.offset - unread
        return {"device": found.st_dev, "inode": found.st_ino, "offset": at, "mark": self._mark(self._file, at)}

    def close(self) -> None:
        """Close the file."""
        self._stack.close()

    def _begin(self, position: Mapping[str, Any]) -> BinaryIO:
        """Open the file that was being read, by whatever name in the same folder; else the one at the path."""
        find(self.path, InputError)
        for path in (self.path, *self._beside(position)):
            file = self._open(path)
            if position and self._mark(file, int(position["offset"])) == position["mark"]:
                self.offset, self.found, self._fresh = int(position["offset"]), True, False
                file.seek(self.offset)
                return file
        return self._open(self.path)

    def _beside(self, position: Mapping[str, Any]) -> list[Path]:
        """Return the files of the folder that are the one of a position, under another name."""
        wanted = position.get("device"), position.get("inode")
        try:
            files = [Path(one.path) for one in os.scandir(self.path.parent) if one.is_file()]
            return [one for one in files if (os.stat(one).st_dev, os.stat(one).st_ino) == wanted]
        except OSError:
            return []

    def _open(self, path: Path) -> BinaryIO:
        self._stack.close()
        self._file = self._stack.enter_context(opened(path, InputError))
        self.offset = 0
        return self._file

    def _mark(self, file: BinaryIO, offset: int) -> str:
        """Return a digest of what stands before a position."""
        here = file.tell()
        file.seek(max(offset - MARK, 0))
        data = file.read(min(MARK, offset))
        file.seek(here)
        return sha256(data).hexdigest() if len(data) == min(MARK, offset) else ""

    def _replaced(self) -> bool:
        """Return whether another file has the name now, or this one was cut."""
        try:
            now = os.stat(self.path)
        except OSError:
            return False  # between two files
        own = os.fstat(self._file.fileno())
        return (now.st_dev, now.st_ino) != (own.st_dev, own.st_ino) or own.st_size < self.offset
