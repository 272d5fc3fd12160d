"""The only place where input files are opened, within a budget of memory.

What a run has read, it does not replace: ``files/results.py`` asks here before it writes.
"""

from __future__ import annotations

import glob
import os
import re
import stat
from collections import deque
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO, TypeVar

from dynident.runtime import (
    MEMORY_VARIABLE,
    ConfigError,
    DynidentError,
    InputError,
    budget_scope,
    choices,
    format_bytes,
    install_command,
    memory_budget,
    set_budget,
)

Failure = Callable[[str], DynidentError]  # the type of the error, or what makes one of a sentence

XML_WEIGHT = 80  # memory of a tree of elements, per byte of its text
MAX_FILE_BUDGETS = 16  # times the budget: a file of which only a part is read
MAX_SHOWN_PATH = 200  # characters of a path in a message
_FLAGS = os.O_RDONLY | sum(getattr(os, name, 0) for name in ("O_NONBLOCK", "O_CLOEXEC", "O_NOCTTY", "O_BINARY"))
_FILE_TYPES = {
    stat.S_ISFIFO: "a named pipe",
    stat.S_ISCHR: "a device",
    stat.S_ISBLK: "a device",
    stat.S_ISSOCK: "a socket",
    stat.S_ISDIR: "a folder",
}

# the files that one command, or one call, has read: the name of each by its device and inode
_READ_FILES: ContextVar[dict[tuple[int, int], str] | None] = ContextVar("read files", default=None)

T = TypeVar("T")
ADDRESS = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+://")  # one letter would be a drive
STAMP_KEYS = ("ETag", "etag", "md5Hash", "generation", "mtime", "LastModified", "last_modified", "updated", "created")


@contextmanager
def watch_inputs(*inputs: str | Path) -> Iterator[None]:
    """Remember the files that are read inside, and ``inputs``: nothing written inside may replace them.

    Outside, nothing is remembered, so that one call from Python does not depend on an earlier one.
    """
    read_files = _READ_FILES.get()
    token = _READ_FILES.set({} if read_files is None else read_files)
    try:
        for path in inputs:
            remember_inputs(path)
        with budget_scope():
            yield
    finally:
        _READ_FILES.reset(token)


def remember_inputs(path: str | Path) -> None:
    """Count a file, or the files of a folder, as read, even if it is not opened or does not exist."""
    try:
        members = Path(path).iterdir() if os.path.isdir(path) else ()
        for file in (Path(path), *members):
            _remember(os.stat(file), file)
    except (OSError, ValueError):
        return


def refuse_inputs(*targets: str | Path) -> None:
    """Raise ConfigError where a file to be written was read, under whatever name; InputError for a device."""
    read_files = _READ_FILES.get() or {}
    for target in targets:
        for name in (os.fspath(target), _resolve(target)):  # the folders on the way may not be there yet
            try:
                status = os.stat(name)
            except (OSError, ValueError):
                continue
            if not (stat.S_ISREG(status.st_mode) or stat.S_ISDIR(status.st_mode)):
                raise InputError(
                    f"{target}: is {_file_kind(status)}, and no file that can be replaced; choose another name."
                )
            # device and inode see through links and other spellings of a name
            read = read_files.get((status.st_dev, status.st_ino))
            if read is not None:
                alias = "" if read == str(target) else f" as {read}"
                raise ConfigError(
                    f"{target}: would be replaced, but this run reads it{alias}; choose another name or folder."
                )


def set_memory(gigabytes: float | None) -> None:
    """Set the budget of this run, in GB; None leaves it as it is."""
    if _READ_FILES.get() is not None and gigabytes is not None:
        set_budget(gigabytes)


def afford(needed: int, subject: str, error: Failure = InputError) -> None:
    """Raise ``error`` where this many bytes exceed the budget; its message begins with ``subject``."""
    if needed > memory_budget():
        raise error(
            f"{subject} {format_bytes(needed)} of memory, more than the {format_bytes(memory_budget())} that a file "
            f"may take; raise this by --memory or {MEMORY_VARIABLE} (in GB), if the file is what it should be."
        )


def file_status(path: str | Path, error: Failure = InputError, kinds: Collection[str] = ()) -> os.stat_result:
    """Return the status of a file or folder.

    Raises ``error`` where there is none, naming files of these ``kinds`` in the same folder.
    """
    try:
        return os.stat(path)
    except (FileNotFoundError, NotADirectoryError) as wrong:
        folder = Path(path).parent
        if not os.path.isdir(folder):
            raise error(f"{_shorten(path)}: the folder {_shorten(folder)} does not exist.") from wrong
        hint = "."
        with suppress(OSError):
            if names := sorted(entry.name for entry in folder.iterdir() if entry.suffix.lower() in kinds):
                hint = f"; {choices(Path(path).name, names)}"
        raise error(f"{_shorten(path)}: cannot be read: there is no such file{hint}") from wrong
    except (OSError, ValueError) as wrong:
        raise error(f"{_shorten(path)}: cannot be read: {cause(wrong)}.") from wrong


@contextmanager
def open_input(
    path: str | Path, error: Failure = InputError, kinds: Collection[str] = (), *, remember: bool = True
) -> Iterator[BinaryIO]:
    """Open a regular file, or a link to one, for reading bytes.

    It is remembered as read, unless ``remember`` is false because the run itself wrote it. Raises ``error`` where
    there is no such file (naming those of ``kinds`` in its folder), where it is a pipe, a device or a folder, or
    larger than 16 budgets.
    """
    _require_regular(file_status(path, error, kinds), path, error)  # to open a device may do something already
    try:
        file = os.fdopen(os.open(path, _FLAGS), "rb")
    except (OSError, ValueError) as wrong:
        raise error(f"{_shorten(path)}: cannot be read: {cause(wrong)}.") from wrong
    with file:
        status = os.fstat(file.fileno())
        # checked again: the file may have been exchanged between status and open
        _require_regular(status, path, error)
        if status.st_size > MAX_FILE_BUDGETS * memory_budget():
            afford(
                status.st_size // MAX_FILE_BUDGETS,
                f"{path}: its {format_bytes(status.st_size)} would take at least",
                error,
            )
        if remember:
            _remember(status, path)
        yield file


def content(
    path: str | Path,
    error: Failure = InputError,
    kinds: Collection[str] = (),
    weight: int = 1,
    *,
    remember: bool = True,
) -> bytes:
    """Return the bytes of a file; ``weight`` is the memory per byte that reading takes. Raises as ``open_input``."""
    with open_input(path, error, kinds, remember=remember) as file:
        size = os.fstat(file.fileno()).st_size
        afford(weight * size, f"{path}: its {format_bytes(size)} would take", error)
        try:
            data = file.read(size + 1)  # a growing file is no way around the budget
        except OSError as wrong:
            raise error(f"{_shorten(path)}: cannot be read: {cause(wrong)}.") from wrong
    if len(data) > size:
        raise error(f"{path}: grows while it is read; read it when it is complete.")
    return data


def read_text(path: str | Path, error: Failure = InputError, kinds: Collection[str] = (), weight: int = 1) -> str:
    """Return the text (UTF-8) of a file with its own line endings; raises as ``content``, and where it is no text."""
    try:
        return content(path, error, kinds, weight).decode("utf-8-sig")
    except UnicodeDecodeError as wrong:
        raise error(f"{path}: is not a UTF-8 text ({wrong}); save it as one.") from wrong


def real_path(path: str | Path, error: Failure = InputError) -> Path:
    """Return the absolute path with links followed; ``error`` where no file can have that name."""
    try:
        return Path(os.path.realpath(path))
    except (OSError, ValueError) as wrong:
        raise error(f"{_shorten(path)}: is no name of a file ({cause(wrong)}).") from wrong


def _require_regular(status: os.stat_result, path: str | Path, error: Failure) -> None:
    if not stat.S_ISREG(status.st_mode):
        raise error(f"{_shorten(path)}: cannot be read: it is {_file_kind(status)}; give a file.")


def _file_kind(status: os.stat_result) -> str:
    return next((words for test, words in _FILE_TYPES.items() if test(status.st_mode)), "no file")


def _remember(status: os.stat_result, path: str | Path) -> None:
    # the first name is kept, as messages should show the one that the user gave
    if (read_files := _READ_FILES.get()) is not None:
        read_files.setdefault((status.st_dev, status.st_ino), str(path))


def _resolve(path: str | Path) -> str:
    try:
        return os.path.realpath(path)
    except (OSError, ValueError):
        return os.fspath(path)


def cause(error: Exception) -> str:
    """Return what the operating system says is wrong, without its number and the name of the file."""
    return getattr(error, "strerror", None) or str(error)


def _shorten(path: str | Path) -> str:
    name = str(path)
    name = name if len(name) <= MAX_SHOWN_PATH else f"{name[: MAX_SHOWN_PATH // 2]}...{name[-MAX_SHOWN_PATH // 2 :]}"
    return name if name.isprintable() else repr(name)


@dataclass(frozen=True)
class RecordingFile:
    """A file, or a folder that stands for one recording: its path or address, and a ``stamp`` of its content.

    The stamp changes with the content; ``match_name`` is what a pattern of ``strip_scheme`` is compared with.
    """

    name: str
    match_name: str
    stamp: str


def is_address(name: str) -> bool:
    """Return whether a name has a scheme."""
    return ADDRESS.match(name) is not None


def strip_scheme(pattern: str) -> str:
    """Return a pattern as ``match_name`` has it: that of an address without its scheme."""
    return _open_store(pattern)[1] if is_address(pattern) else pattern


def matching_files(pattern: str, folder: Path) -> tuple[list[RecordingFile], tuple[str, ...]]:
    """Return the files that match a pattern of ``glob``, sorted by name; local ones relative to ``folder``.

    A local folder counts once, by a name without links if there is one. With the files come the links that lead to a
    folder once more. Raises InputError where a store does not answer.
    """
    if is_address(pattern):
        store, path = _open_store(pattern)
        details = _ask_store(pattern, lambda: store.glob(path, detail=True))
        files = sorted((name, detail) for name, detail in details.items() if detail.get("type") != "directory")
        return [RecordingFile(store.unstrip_protocol(name), name, _store_stamp(detail)) for name, detail in files], ()
    folder = Path(os.path.realpath(folder))
    matches, links = _local_matches(re.sub(r"(^|/)\*\*$", r"\1**/*", pattern), folder)
    names: dict[tuple[str, str], str] = {}
    # told by folder and name there: a link to a file is a recording of its own
    for name in sorted(matches, key=lambda name: (_is_behind_link(folder / name), name)):
        parent, file_name = os.path.split(name)
        if names.setdefault((os.path.realpath(folder / parent), file_name), name) != name:
            links.append(parent)
    stamps = {name: file_stamp(name, folder) for name in sorted(names.values())}
    return [RecordingFile(name, name, stamp) for name, stamp in stamps.items() if stamp], tuple(dict.fromkeys(links))


def _local_matches(pattern: str, folder: Path) -> tuple[list[str], list[str]]:
    """Return the names that match a pattern, and the links that are not followed, as ``glob`` would without end."""
    before, stars, after = f"/{pattern}".partition("/**/")
    if not stars:
        return [Path(name).as_posix() for name in glob.glob(pattern, root_dir=folder)], []
    top = before[1:] or pattern[: pattern.startswith("/")]
    folders, links = _folders_below(glob.glob(top, root_dir=folder) if top else [""], folder)
    matches: dict[str, None] = {}
    for name in folders:
        names, more_links = _local_matches(after, folder / name)
        matches |= dict.fromkeys(Path(name, match).as_posix() for match in names)
        links += [Path(name, link).as_posix() for link in more_links]
    return list(matches), links


def _folders_below(tops: Collection[str], folder: Path) -> tuple[list[str], list[str]]:
    """Return the names of the folders in and below ``tops``, each real one once, and the links that lead to them."""
    links = deque(sorted(name for name in tops if _is_behind_link(folder / name)))
    queue = deque(sorted({*tops} - {*links}))
    names, repeated_links = dict[str, str](), []
    while queue or links:
        # links come last: what leads to a folder besides does not change its name
        name = queue.popleft() if queue else links.popleft()
        if names.setdefault(os.path.realpath(folder / name), name) != name:
            repeated_links.append(name)
            continue
        with suppress(OSError), os.scandir(folder / name) as entries:
            for entry in sorted(entries, key=lambda entry: entry.name):
                if entry.is_dir() and not entry.name.startswith("."):
                    (links if entry.is_symlink() else queue).append(Path(name, entry.name).as_posix())
    return list(names.values()), repeated_links


def _is_behind_link(path: Path) -> bool:
    """Return whether a path has another name without links."""
    return os.path.realpath(path) != os.path.abspath(path)


def file_stamp(name: str, folder: Path) -> str:
    """Return the stamp of a file, empty where there is none; InputError where a store does not answer."""
    if is_address(name):
        store, path = _open_store(name)
        try:
            return _store_stamp(_ask_store(name, lambda: store.info(path)))
        except FileNotFoundError:
            return ""
    try:
        status = os.stat(folder / name)
        statuses = [entry.stat() for entry in os.scandir(folder / name)] if os.path.isdir(folder / name) else [status]
    except (OSError, ValueError):
        return ""
    # for a folder: number of bytes and newest change of its files
    newest = max((entry.st_mtime_ns for entry in statuses), default=0)
    return f"{sum(entry.st_size for entry in statuses)} {newest}"


@contextmanager
def local_file(name: str, folder: Path) -> Iterator[Path]:
    """Yield the path of a file; one of a store is copied to a temporary folder for as long as it is needed.

    Raises InputError where it cannot be fetched.
    """
    if not is_address(name):
        yield folder / name
        return
    store, path = _open_store(name)
    with TemporaryDirectory(prefix="dynident-") as temporary:
        copy = Path(temporary, path.rstrip("/").rpartition("/")[2])
        try:
            _ask_store(name, lambda: store.get_file(path, str(copy)))
        except FileNotFoundError:
            raise InputError(f"{name}: there is no such file.") from None
        yield copy


def _open_store(name: str) -> tuple[Any, str]:
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


def _ask_store(name: str, ask: Callable[[], T]) -> T:
    """Return the answer of a store; its errors, of any type, become InputError."""
    try:
        return ask()
    except FileNotFoundError:
        raise
    except Exception as error:
        raise InputError(f"{name}: the store does not answer: {type(error).__name__}: {error}") from error


def _store_stamp(details: Mapping[str, Any]) -> str:
    """Return size and version of a file as stores report them; a time may be a date or seconds since 1970."""
    values = [details[key] for key in ("size", *STAMP_KEYS) if details.get(key) is not None]
    return " ".join(str(value.timestamp() if isinstance(value, datetime) else value) for value in values)


def relative(path: Path, folder: Path) -> str:
    """Return the path relative to a folder, with forward slashes; unchanged on another drive."""
    try:
        return Path(os.path.relpath(path, folder)).as_posix()
    except ValueError:
        return path.resolve().as_posix()
