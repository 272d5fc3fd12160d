"""The one way in: every file that the library reads is opened here, within a budget of memory; and what a run has read,
it does not replace (``io/results.py`` asks here before it writes).
"""

from __future__ import annotations

import os
import stat
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from dynident.errors import MEMORY, ConfigError, DynidentError, InputError, amount, budgeted, choices, give, memory

__all__ = [
    "XML_WEIGHT",
    "Run",
    "afford",
    "content",
    "find",
    "keep",
    "opened",
    "real",
    "refuse_inputs",
    "set_memory",
    "text",
    "watched",
]

Failure = Callable[[str], DynidentError]  # the type of the error, or what makes one of a sentence

XML_WEIGHT = 80  # memory of a tree of elements, per byte of its text
LARGEST = 16  # times the budget: a file of which only a part is read
LONGEST = 200  # characters of a path in a message
_FLAGS = os.O_RDONLY | sum(getattr(os, name, 0) for name in ("O_NONBLOCK", "O_CLOEXEC", "O_NOCTTY", "O_BINARY"))
_TYPES = {
    stat.S_ISFIFO: "a named pipe",
    stat.S_ISCHR: "a device",
    stat.S_ISBLK: "a device",
    stat.S_ISSOCK: "a socket",
    stat.S_ISDIR: "a folder",
}


@dataclass
class Run:
    """What one command, or one call, has read: the name of each file by its identity (device, inode)."""

    files: dict[tuple[int, int], str] = field(default_factory=dict)


_RUN: ContextVar[Run | None] = ContextVar("run", default=None)


@contextmanager
def watched(*inputs: str | Path) -> Iterator[None]:
    """Remember what is read inside, and ``inputs``: nothing that is written inside may replace it.

    Outside, nothing is remembered, so that one call from Python does not depend on an earlier one.
    """
    token = _RUN.set(_RUN.get() or Run())
    try:
        for path in inputs:
            keep(path)
        with budgeted():
            yield
    finally:
        _RUN.reset(token)


def keep(path: str | Path) -> None:
    """Count a file, or the files of a folder, among those read, though it may not be opened or not be there."""
    try:
        inside = Path(path).iterdir() if os.path.isdir(path) else ()
        for one in (Path(path), *inside):
            _remember(os.stat(one), one)
    except (OSError, ValueError):
        return


def refuse_inputs(*targets: str | Path) -> None:
    """Raise ConfigError where one of the files to be written was read, under whatever name; InputError for a device."""
    run = _RUN.get() or Run()
    for target in targets:
        for name in (os.fspath(target), _resolved(target)):  # the folders on the way may not be there yet
            try:
                found = os.stat(name)
            except (OSError, ValueError):
                continue
            if not (stat.S_ISREG(found.st_mode) or stat.S_ISDIR(found.st_mode)):
                raise InputError(f"{target}: is {_kind(found)}, and no file that can be replaced; choose another name.")
            read = run.files.get((found.st_dev, found.st_ino))
            if read is not None:
                same = "" if read == str(target) else f" as {read}"
                raise ConfigError(
                    f"{target}: would be replaced, but this run reads it{same}; choose another name or folder."
                )


def set_memory(gigabytes: float | None) -> None:
    """Set the budget of this run, in GB; None leaves it as it is."""
    if _RUN.get() is not None and gigabytes is not None:
        give(gigabytes)


def afford(needed: int, what: str, error: Failure = InputError) -> None:
    """Raise ``error`` where this many bytes are more than the budget; ``what`` begins the sentence."""
    if needed > memory():
        raise error(
            f"{what} {amount(needed)} of memory, more than the {amount(memory())} that a file may take; "
            f"raise this by --memory or {MEMORY} (in GB), if the file is what it should be."
        )


def find(path: str | Path, error: Failure = InputError, kinds: Collection[str] = ()) -> os.stat_result:
    """Return the status of a file or folder; ``error`` where there is none, with files of these ``kinds`` beside it."""
    try:
        return os.stat(path)
    except (FileNotFoundError, NotADirectoryError) as wrong:
        folder = Path(path).parent
        if not os.path.isdir(folder):
            raise error(f"{_short(path)}: the folder {_short(folder)} does not exist.") from wrong
        beside = _beside(folder, kinds)
        near = f"; {choices(Path(path).name, beside)}" if beside else "."
        raise error(f"{_short(path)}: cannot be read: there is no such file{near}") from wrong
    except (OSError, ValueError) as wrong:
        raise error(f"{_short(path)}: cannot be read: {getattr(wrong, 'strerror', None) or wrong}.") from wrong


@contextmanager
def opened(
    path: str | Path, error: Failure = InputError, kinds: Collection[str] = (), *, remember: bool = True
) -> Iterator[BinaryIO]:
    """Open a regular file, or a link to one, for reading bytes; ``remember`` it, unless the run itself wrote it.

    Raises ``error`` where there is no such file (with those of ``kinds`` beside it), where it is a pipe, a device or a
    folder, or larger than 16 budgets.
    """
    _regular(find(path, error, kinds), path, error)  # to open a device may do something already
    try:
        file = os.fdopen(os.open(path, _FLAGS), "rb")
    except (OSError, ValueError) as wrong:
        raise error(f"{_short(path)}: cannot be read: {getattr(wrong, 'strerror', None) or wrong}.") from wrong
    with file:
        found = os.fstat(file.fileno())
        _regular(found, path, error)
        if found.st_size > LARGEST * memory():
            afford(found.st_size // LARGEST, f"{path}: its {amount(found.st_size)} would take at least", error)
        if remember:
            _remember(found, path)
        yield file


def content(
    path: str | Path,
    error: Failure = InputError,
    kinds: Collection[str] = (),
    weight: int = 1,
    *,
    remember: bool = True,
) -> bytes:
    """Return the bytes of a file; ``weight`` is the memory that reading it takes, per byte. Raises as ``opened``."""
    with opened(path, error, kinds, remember=remember) as file:
        size = os.fstat(file.fileno()).st_size
        afford(weight * size, f"{path}: its {amount(size)} would take", error)
        try:
            data = file.read(size + 1)  # a growing file is no way around the budget
        except OSError as wrong:
            raise error(f"{_short(path)}: cannot be read: {wrong.strerror or wrong}.") from wrong
    if len(data) > size:
        raise error(f"{path}: grows while it is read; read it when it is complete.")
    return data


def text(path: str | Path, error: Failure = InputError, kinds: Collection[str] = (), weight: int = 1) -> str:
    """Return the text (UTF-8) of a file, with its own line endings; raises as ``content``, and where it is no text."""
    try:
        return content(path, error, kinds, weight).decode("utf-8-sig")
    except UnicodeDecodeError as wrong:
        raise error(f"{path}: is not a UTF-8 text ({wrong}); save it as one.") from wrong


def real(path: str | Path, error: Failure = InputError) -> Path:
    """Return the absolute path with links followed; ``error`` where no file can have that name."""
    try:
        return Path(os.path.realpath(path))
    except (OSError, ValueError) as wrong:
        raise error(f"{_short(path)}: is no name of a file ({getattr(wrong, 'strerror', None) or wrong}).") from wrong


def _regular(found: os.stat_result, path: str | Path, error: Failure) -> None:
    if not stat.S_ISREG(found.st_mode):
        raise error(f"{_short(path)}: cannot be read: it is {_kind(found)}; give a file.")


def _kind(found: os.stat_result) -> str:
    return next((words for test, words in _TYPES.items() if test(found.st_mode)), "no file")


def _remember(found: os.stat_result, path: str | Path) -> None:
    run = _RUN.get()
    if run is not None:
        run.files.setdefault((found.st_dev, found.st_ino), str(path))


def _beside(folder: Path, kinds: Collection[str]) -> list[str]:
    try:
        return sorted(one.name for one in folder.iterdir() if one.suffix.lower() in kinds)
    except OSError:
        return []


def _resolved(path: str | Path) -> str:
    try:
        return os.path.realpath(path)
    except (OSError, ValueError):
        return os.fspath(path)


def _short(path: str | Path) -> str:
    name = str(path)
    name = name if len(name) <= LONGEST else f"{name[: LONGEST // 2]}...{name[-LONGEST // 2 :]}"
    return name if name.isprintable() else repr(name)
