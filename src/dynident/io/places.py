"""Files by path, or by address in an object store (``s3://bucket/log.parquet``), which fsspec reads."""

from __future__ import annotations

import glob
import os
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

from dynident.errors import InputError
from dynident.errors.install import install_command

__all__ = ["PlacedFile", "is_address", "local_file", "matching", "placed", "stamp_of"]

T = TypeVar("T")
ADDRESS = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+://")  # one letter would be a drive
STAMPS = ("ETag", "etag", "md5Hash", "generation", "mtime", "LastModified", "last_modified", "updated", "created")


@dataclass(frozen=True)
class PlacedFile:
    """A file, or a folder that stands for one recording: its path or address, and a ``stamp`` that changes with its
    content; ``matched`` is what a pattern of ``placed`` is compared with."""

    name: str
    matched: str
    stamp: str


def is_address(name: str) -> bool:
    """Whether a name has a scheme."""
    return ADDRESS.match(name) is not None


def placed(pattern: str) -> str:
    """Return a pattern as the names found by ``matching`` are: of an address without its scheme."""
    return _store(pattern)[1] if is_address(pattern) else pattern


def matching(pattern: str, folder: Path) -> list[PlacedFile]:
    """Return the files that match a pattern of ``glob``, in the order of their names; local ones as seen from
    ``folder``.

    Raises InputError where a store cannot be asked.
    """
    if is_address(pattern):
        store, path = _store(pattern)
        found = _asked(pattern, lambda: store.glob(path, detail=True))
        files = sorted((name, of) for name, of in found.items() if of.get("type") != "directory")
        return [PlacedFile(store.unstrip_protocol(name), name, _stamp(of)) for name, of in files]
    names = sorted(Path(name).as_posix() for name in glob.glob(pattern, root_dir=folder, recursive=True))
    return [PlacedFile(name, name, stamp) for name in names if (stamp := stamp_of(name, folder))]


def stamp_of(name: str, folder: Path) -> str:
    """Return the stamp of a file, empty where there is none; InputError where a store cannot be asked."""
    if is_address(name):
        store, path = _store(name)
        try:
            return _stamp(_asked(name, lambda: store.info(path)))
        except FileNotFoundError:
            return ""
    try:
        found = os.stat(folder / name)
        inside = [one.stat() for one in os.scandir(folder / name)] if os.path.isdir(folder / name) else [found]
    except (OSError, ValueError):
        return ""
    newest = max((one.st_mtime_ns for one in inside), default=0)
    return f"{sum(one.st_size for one in inside)} {newest}"


@contextmanager
def local_file(name: str, folder: Path) -> Iterator[Path]:
    """Give the path of a file; one of a store is copied to a temporary folder for as long as it is needed.

    Raises InputError where it cannot be fetched.
    """
    if not is_address(name):
        yield folder / name
        return
    store, path = _store(name)
    with TemporaryDirectory(prefix="dynident-") as made:
        copy = Path(made, path.rstrip("/").rpartition("/")[2])
        try:
            _asked(name, lambda: store.get_file(path, str(copy)))
        except FileNotFoundError:
            raise InputError(f"{name}: there is no such file.") from None
        yield copy


def _store(name: str) -> tuple[Any, str]:
    """Return the file system of an address, and the path in it."""
    try:
        from fsspec.core import url_to_fs
    except ImportError:
        raise InputError(f"{name}: reading from an object store needs fsspec: {install_command('fsspec')}") from None
    try:
        store, path = url_to_fs(name)
    except (ImportError, ValueError) as error:  # a package that is missing, or a scheme that nobody knows
        raise InputError(f"{name}: cannot be opened: {error}") from error
    return store, str(path)


def _asked(name: str, ask: Callable[[], T]) -> T:
    """Return the answer of a store, whose errors are of any type."""
    try:
        return ask()
    except FileNotFoundError:
        raise
    except Exception as error:
        raise InputError(f"{name}: the store does not answer: {type(error).__name__}: {error}") from error


def _stamp(found: Mapping[str, Any]) -> str:
    """Return size and version of a file, as stores say them; a time is one also where it is seconds since 1970."""
    values = [found[key] for key in ("size", *STAMPS) if found.get(key) is not None]
    return " ".join(str(one.timestamp() if isinstance(one, datetime) else one) for one in values)
