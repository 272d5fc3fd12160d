"""A folder of results as one thing: its files are replaced all together, by one run at a time.

The folder may hold files of the user's own, so it is not renamed as a whole. New files are written and synced in a
hidden folder inside it; renaming that one to ``.dynident.new`` is the moment from which they count. Then they are moved
into place one by one, and whoever reads or writes in the folder next moves what a killed run could not (``settle``).
Moving needs no space: a full disk stops a run before that moment, when nothing has changed.

No file is compared with another when it is read, so a result can be moved, copied, opened where nothing can be written,
made smaller by deleting the report, or edited by hand; result.json alone is enough to predict and export.

Locks are the operating system's and end with the process that holds them, however it ends.
"""

from __future__ import annotations

import os
import re
import shutil
import socket
import sys
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO
from uuid import uuid4

from dynident.errors import ConfigError, InputError
from dynident.io.opener import real, refuse_inputs

__all__ = [
    "REPORT", "ResultFolder", "held", "refuse_other_report", "result_folder", "settle", "whole_file", "write_whole",
]  # fmt: skip

REPORT = "report.html"  # of each command that writes a folder
LOCK, STAGED, READY = ".dynident.lock", ".dynident.tmp", ".dynident.new"
PUT, GONE = "put", "gone"  # in both hidden folders: the new files, and empty files named as those to be removed
TEMPORARY = re.compile(r"\.dynident-[0-9a-f]{32}\.tmp")
PATIENCE = 10.0  # s for another run to move its files
KEPT = "the files here are as they were"
AGAIN = "run the same command again"


@dataclass
class ResultFolder:
    """A folder that this run alone writes results to; ``written`` says whether it has."""

    path: Path
    written: bool = False

    def replace(self, files: Mapping[str, str | bytes], gone: Iterable[str] = ()) -> tuple[Path, ...]:
        """Write files by name and remove those in ``gone``, all or none; return the paths of the new files.

        Raises InputError where one cannot be written, ConfigError where one was read.
        """
        gone = set(gone) - set(files)
        for name in (*files, *gone):
            if Path(name).name != name or (self.path / name).is_dir():
                raise InputError(f"{self.path / name}: cannot be written: it is a folder, or in another one.")
        refuse_inputs(*(self.path / name for name in (*files, *gone)))
        try:
            self._stage(files, gone)
            os.rename(self.path / STAGED, self.path / READY)
        except (OSError, ValueError) as error:
            raise InputError(
                f"{self.path}: the results cannot be written: {_reason(error)}; {KEPT}. "
                "Make room, allow writing, or choose another folder."
            ) from error
        self.written = True
        _finish(self.path)
        return tuple(self.path / name for name in files)

    def _stage(self, files: Mapping[str, str | bytes], gone: Iterable[str]) -> None:
        staged = self.path / STAGED
        for place in (PUT, GONE):
            (staged / place).mkdir(parents=True)
        for name, content in files.items():
            with open(staged / PUT / name, "xb") as file:
                file.write(content.encode("utf-8", "backslashreplace") if isinstance(content, str) else content)
                _synced(file)
        for name in gone:
            (staged / GONE / name).touch()
        for folder in (staged / PUT, staged / GONE, staged):
            _sync(folder)


def refuse_other_report(folder: Path, numbers: str) -> None:
    """Raise ConfigError where a folder holds the report of another command: one without the file ``numbers``, which
    this command writes beside its own."""
    if os.path.exists(folder / REPORT) and not os.path.exists(folder / numbers):
        raise ConfigError(
            f"{folder / REPORT}: is the report of another command, and would be replaced; name another folder."
        )


@contextmanager
def result_folder(path: str | Path) -> Iterator[ResultFolder]:
    """Make a folder, if need be, and hold it alone; what a killed run left in it is moved into place or removed.

    A folder that was made is removed where nothing is in it at the end. Raises InputError, before long work, where
    nothing can be written or another run holds the folder.
    """
    folder = ResultFolder(real(path))  # of x/../y, x need not be there
    made = [one for one in (folder.path, *folder.path.parents) if not os.path.exists(one)]
    try:
        with held(folder.path):
            try:
                _finish(folder.path)
                yield folder
            finally:  # whatever stops the run
                folder.written |= _left(folder.path, READY)
                _finish(folder.path)
    except KeyboardInterrupt as stop:
        if not hasattr(stop, "__notes__"):
            kept = "the new files are in place" if folder.written else f"{KEPT}; {AGAIN}"
            stop.add_note(f"{folder.path}: {kept}.")
        raise
    finally:
        for one in made:
            with suppress(OSError):  # not empty
                one.rmdir()


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """Make a folder, if need be, and hold it alone; temporary files of runs that have ended are removed.

    Raises InputError where nothing can be written or another run holds it.
    """
    lock = _hold(folder)
    try:
        _sweep(folder)
        yield
    finally:
        _release(lock, folder / LOCK)


def settle(folder: Path) -> None:
    """Finish what a killed run left in a folder, before anything in it is read or written.

    Raises InputError where files of two runs lie there and that cannot be changed.
    """
    end = time.monotonic() + PATIENCE
    while _left(folder, LOCK) or _left(folder, READY):
        try:
            lock = _take(folder / LOCK)
        except BlockingIOError:
            if not _left(folder, READY):
                return  # its run is alive, and has not begun to move files
            if time.monotonic() > end:
                raise InputError(_held_by(folder)) from None
            time.sleep(0.02)
        except OSError as error:
            if not _left(folder, READY):
                return
            raise _mixed(folder, error) from error
        else:
            try:
                _finish(folder)
            finally:
                _release(lock, folder / LOCK)
            return


def write_whole(path: Path, data: bytes) -> None:
    """Write one file, never half, as ``whole_file`` does."""
    with whole_file(path) as temporary:
        temporary.write_bytes(data)


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Give a temporary file beside ``path``, locked while in use, to be written; it takes the name at the end.

    Those of runs that have ended are removed. Raises OSError or ValueError where it cannot be written, ConfigError
    where it was read.
    """
    refuse_inputs(path)
    folder = real(path.parent)  # of x/../y, x need not be there
    settle(folder)
    folder.mkdir(parents=True, exist_ok=True)
    _sweep(folder)
    temporary, file = _temporary(folder)
    try:
        yield temporary
        _synced(file)
        if sys.platform == "win32":
            file.close()  # an open file cannot be renamed there
        refuse_inputs(path)
        os.replace(temporary, folder / path.name)
    finally:
        _release(file, temporary)


def _temporary(folder: Path) -> tuple[Path, IO[bytes]]:
    """Return a new temporary file, locked."""
    while True:
        path = folder / f".dynident-{uuid4().hex}.tmp"
        with suppress(BlockingIOError):  # a run that sweeps was faster, and removes it
            return path, _take(path)


def _finish(folder: Path) -> None:
    """Move into place what is ready, and drop what is not; the folder is held."""
    shutil.rmtree(folder / STAGED, ignore_errors=True)
    ready = folder / READY
    try:
        if _left(folder, READY):
            _sync(folder)
            for name in _names(ready / GONE):
                (folder / name).unlink(missing_ok=True)
                (ready / GONE / name).unlink()
            for name in _names(ready / PUT):
                os.replace(ready / PUT / name, folder / name)
            shutil.rmtree(ready)
    except OSError as error:
        raise _mixed(folder, error) from error


def _mixed(folder: Path, error: OSError) -> InputError:
    return InputError(
        f"{folder}: files of two runs lie here, since a run was stopped while it moved its files into place, and the "
        f"rest cannot be moved: {_reason(error)}. Allow writing here and {AGAIN}."
    )


def _left(folder: Path, name: str) -> bool:
    return os.path.lexists(folder / name)


def _names(folder: Path) -> list[str]:
    """Return the files of a folder; none where it is not there, or is a link to another place."""
    linked = folder.is_symlink() or folder.parent.is_symlink()
    return sorted(os.listdir(folder)) if folder.is_dir() and not linked else []


def _sweep(folder: Path) -> None:
    """Remove the temporary files of runs that have ended."""
    with suppress(OSError):
        for path in [one for one in folder.iterdir() if TEMPORARY.fullmatch(one.name)]:
            with suppress(OSError), _opened(path) as file:  # in use, or not ours to remove
                if _lock(file.fileno()):
                    _release(file, path)


def _hold(folder: Path) -> IO[bytes]:
    """Return the lock of a folder, with a note of who holds it; InputError where another run does."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = _take(folder / LOCK)
    except BlockingIOError:
        raise InputError(_held_by(folder)) from None
    except (OSError, ValueError) as error:
        raise _unwritable(folder, error) from error
    try:
        lock.truncate()
        now = time.strftime("%Y-%m-%d %H:%M:%S")
        lock.write(f"process {os.getpid()} on {socket.gethostname()} since {now}".encode())
        lock.flush()
    except OSError as error:
        _release(lock, folder / LOCK)
        raise _unwritable(folder, error) from error
    return lock


def _unwritable(folder: Path, error: Exception) -> InputError:
    return InputError(f"{folder}: nothing can be written here: {_reason(error)}. Choose another folder.")


def _held_by(folder: Path) -> str:
    who = ""
    with suppress(OSError):
        who = (folder / LOCK).read_bytes()[:200].decode("utf-8", "replace")
    who = "".join(one for one in who if one.isprintable()) or "its process is not known"
    return f"{folder}: another run writes here ({who}); wait until it ends, or choose another folder."


def _take(path: Path) -> IO[bytes]:
    """Open a file, made if need be, and lock it; BlockingIOError where another process has."""
    while True:
        file = _opened(path, os.O_CREAT)
        try:
            _lock(file.fileno())
            if os.path.samestat(os.fstat(file.fileno()), os.stat(path)):
                return file
        except FileNotFoundError:
            pass  # removed meanwhile, by the one that had it
        except BaseException:
            file.close()
            raise
        file.close()


def _opened(path: Path, flags: int = 0) -> IO[bytes]:
    safe = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
    return os.fdopen(os.open(path, os.O_RDWR | safe | flags, 0o666), "r+b")


def _release(file: IO[bytes], path: Path) -> None:
    """Remove a locked file and unlock it: in this order, where the system allows it, lest another's be removed."""
    steps = (path.unlink, file.close)
    for step in reversed(steps) if sys.platform == "win32" else steps:
        with suppress(OSError):
            step()


def _lock(descriptor: int) -> bool:
    """Lock a file, and return whether its file system can; BlockingIOError where another process has locked it."""
    try:
        if sys.platform == "win32":
            import msvcrt

            os.lseek(descriptor, 1 << 30, os.SEEK_SET)  # what is locked there cannot be read: a byte behind the end
            try:
                msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
            except OSError as error:
                raise BlockingIOError(*error.args) from error
            finally:
                os.lseek(descriptor, 0, os.SEEK_SET)
        else:
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError:
        return False
    return True


def _synced(file: IO[bytes]) -> None:
    """Send a file on to the disk: a name must not reach it before the content."""
    file.flush()
    os.fsync(file.fileno())


def _sync(folder: Path) -> None:
    """Send the names in a folder to the disk, where the system can."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)
