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
from hashlib import sha256
from pathlib import Path
from typing import IO
from uuid import uuid4

from dynident.files.opener import cause, content, real_path, refuse_inputs
from dynident.runtime import ConfigError, InputError

REPORT = "report.html"  # of each command that writes a folder
LOCK_NAME, STAGING_NAME, READY_NAME = ".dynident.lock", ".dynident.tmp", ".dynident.new"
# in both hidden folders: the new files, and empty files named as those to be removed
NEW_FILES, REMOVED_FILES = "put", "gone"
TEMPORARY = re.compile(r"\.dynident-[0-9a-f]{32}\.tmp")
PATIENCE = 10.0  # s for another run to move its files
UNCHANGED = "the files here are as they were"
RUN_AGAIN = "run the same command again"


@dataclass
class ResultFolder:
    """A folder in which this run alone writes results; ``written`` says whether it has done so."""

    path: Path
    written: bool = False

    def replace(self, files: Mapping[str, str | bytes], removed: Iterable[str] = ()) -> tuple[Path, ...]:
        """Write files by name and remove those in ``removed``, all or none; return the paths of the new files.

        Raises InputError where one cannot be written, ConfigError where one was read.
        """
        # a file that is written again is not removed
        removed = set(removed) - set(files)
        for name in (*files, *removed):
            if Path(name).name != name or (self.path / name).is_dir():
                raise InputError(f"{self.path / name}: cannot be written: it is a folder, or in another one.")
        refuse_inputs(*(self.path / name for name in (*files, *removed)))
        try:
            self._stage(files, removed)
            # the rename is the commit: before it nothing has changed, after it any run can finish the job
            os.rename(self.path / STAGING_NAME, self.path / READY_NAME)
        except (OSError, ValueError) as error:
            raise InputError(
                f"{self.path}: the results cannot be written: {cause(error)}; {UNCHANGED}. "
                "Make room, allow writing, or choose another folder."
            ) from error
        self.written = True
        _finish(self.path)
        return tuple(self.path / name for name in files)

    def write_from(self, name: str, position: int, text: str) -> None:
        """Write text to a file in place of what follows a ``position`` (bytes), for logs that grow.

        Raises InputError where it cannot be written, ConfigError where it was read.
        """
        path = self.path / name
        refuse_inputs(path)
        try:
            with _open_file(path, os.O_CREAT) as file:
                # a file that somebody made shorter goes on at its end
                file.truncate(min(position, os.fstat(file.fileno()).st_size))
                file.seek(0, os.SEEK_END)
                file.write(text.encode("utf-8", "backslashreplace"))
                _sync_file(file)
        except (OSError, ValueError) as error:
            raise InputError(f"{path}: cannot be written: {cause(error)}. Make room, or allow writing.") from error
        self.written = True

    def _stage(self, files: Mapping[str, str | bytes], removed: Iterable[str]) -> None:
        staging = self.path / STAGING_NAME
        shutil.rmtree(staging, ignore_errors=True)  # of files that could not be written before
        for kind in (NEW_FILES, REMOVED_FILES):
            (staging / kind).mkdir(parents=True)
        for name, contents in files.items():
            with open(staging / NEW_FILES / name, "xb") as file:
                file.write(contents.encode("utf-8", "backslashreplace") if isinstance(contents, str) else contents)
                _sync_file(file)
        for name in removed:
            (staging / REMOVED_FILES / name).touch()
        # the content must be on the disk before the rename that makes it count
        for folder in (staging / NEW_FILES, staging / REMOVED_FILES, staging):
            _sync_folder(folder)


def refuse_other_report(folder: Path, numbers: str) -> None:
    """Raise ConfigError where a folder holds the report of another command: one without the file ``numbers``, which
    this command writes beside its own."""
    if os.path.exists(folder / REPORT) and not os.path.exists(folder / numbers):
        raise ConfigError(
            f"{folder / REPORT}: is the report of another command, and would be replaced; name another folder."
        )


@contextmanager
def result_folder(path: str | Path) -> Iterator[ResultFolder]:
    """Hold a folder exclusively, creating it if needed; finish or remove what a killed run left in it.

    A folder that was created here is removed if it is empty in the end. Raises InputError, before long work,
    where nothing can be written or another run holds the folder.
    """
    folder = ResultFolder(real_path(path))  # of x/../y, x need not be there
    created = [directory for directory in (folder.path, *folder.path.parents) if not os.path.exists(directory)]
    try:
        with hold_folder(folder.path):
            try:
                _finish(folder.path)
                yield folder
            finally:  # whatever stops the run
                folder.written |= _is_present(folder.path, READY_NAME)
                _finish(folder.path)
    except KeyboardInterrupt as stop:
        if not hasattr(stop, "__notes__"):
            state = "the new files are in place" if folder.written else f"{UNCHANGED}; {RUN_AGAIN}"
            stop.add_note(f"{folder.path}: {state}.")
        raise
    finally:
        for directory in created:
            with suppress(OSError):  # not empty
                directory.rmdir()


@contextmanager
def hold_folder(folder: Path) -> Iterator[None]:
    """Hold a folder exclusively, creating it if needed; temporary files of ended runs are removed.

    Raises InputError where nothing can be written or another run holds it.
    """
    lock = _lock_folder(folder)
    try:
        _sweep(folder)
        yield
    finally:
        _release(lock, folder / LOCK_NAME)


def is_unchanged(path: Path, digest: object) -> bool:
    """Return whether a file that was written with this SHA-256 is still as it was."""
    try:
        return sha256(content(path, remember=False)).hexdigest() == digest
    except InputError:
        return False


def settle(folder: Path) -> None:
    """Finish what a killed run left in a folder, before anything in it is read or written.

    Raises InputError where files of two runs are mixed there and this cannot be changed.
    """
    end = time.monotonic() + PATIENCE
    # wait only for a run that is moving its files; one that still computes does not disturb readers
    while _is_present(folder, LOCK_NAME) or _is_present(folder, READY_NAME):
        try:
            # a run that holds the lock is either computing (leave it alone) or moving files (wait for it)
            lock = _open_locked(folder / LOCK_NAME)
        except BlockingIOError:
            if not _is_present(folder, READY_NAME):
                return  # its run is alive, and has not begun to move files
            if time.monotonic() > end:
                raise InputError(_holder_message(folder)) from None
            time.sleep(0.02)
        except OSError as error:
            if not _is_present(folder, READY_NAME):
                return
            raise _mixed_files_error(folder, error) from error
        else:
            try:
                _finish(folder)
            finally:
                _release(lock, folder / LOCK_NAME)
            return


def write_whole(path: Path, data: bytes) -> None:
    """Write one file as a whole or not at all, as ``whole_file`` does."""
    with whole_file(path) as temporary:
        temporary.write_bytes(data)


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a temporary file beside ``path`` to be written, locked while in use; it gets the final name in the end.

    Temporary files of ended runs are removed. Raises OSError or ValueError where it cannot be written,
    ConfigError where it was read.
    """
    refuse_inputs(path)
    folder = real_path(path.parent)  # of x/../y, x need not be there
    settle(folder)
    folder.mkdir(parents=True, exist_ok=True)
    _sweep(folder)
    temporary, file = _make_temporary(folder)
    try:
        yield temporary
        # sync before the rename, or a crash could leave an empty file under the final name
        _sync_file(file)
        if sys.platform == "win32":
            file.close()  # an open file cannot be renamed there
        refuse_inputs(path)
        os.replace(temporary, folder / path.name)
    finally:
        _release(file, temporary)


def _make_temporary(folder: Path) -> tuple[Path, IO[bytes]]:
    """Return a new temporary file, locked."""
    while True:
        path = folder / f".dynident-{uuid4().hex}.tmp"
        with suppress(BlockingIOError):  # a run that sweeps was faster, and removes it
            return path, _open_locked(path)


def _finish(folder: Path) -> None:
    """Move prepared files into place and drop unfinished ones; the folder must be held."""
    shutil.rmtree(folder / STAGING_NAME, ignore_errors=True)
    ready = folder / READY_NAME
    try:
        if _is_present(folder, READY_NAME):
            _sync_folder(folder)
            # a name leaves the list only after its file is gone, so that the next run can resume
            for name in _file_names(ready / REMOVED_FILES):
                (folder / name).unlink(missing_ok=True)
                (ready / REMOVED_FILES / name).unlink()
            for name in _file_names(ready / NEW_FILES):
                os.replace(ready / NEW_FILES / name, folder / name)
            shutil.rmtree(ready)
    except OSError as error:
        raise _mixed_files_error(folder, error) from error


def _mixed_files_error(folder: Path, error: OSError) -> InputError:
    return InputError(
        f"{folder}: files of two runs lie here, since a run was stopped while it moved its files into place, and the "
        f"rest cannot be moved: {cause(error)}. Allow writing here and {RUN_AGAIN}."
    )


def _is_present(folder: Path, name: str) -> bool:
    return os.path.lexists(folder / name)


def _file_names(folder: Path) -> list[str]:
    """Return the names of the files of a folder; none where it does not exist or is a link."""
    # only real folders: what lies behind a link does not belong to this run
    linked = folder.is_symlink() or folder.parent.is_symlink()
    return sorted(os.listdir(folder)) if folder.is_dir() and not linked else []


def _sweep(folder: Path) -> None:
    """Remove the temporary files of runs that have ended."""
    with suppress(OSError):
        for path in [entry for entry in folder.iterdir() if TEMPORARY.fullmatch(entry.name)]:
            with suppress(OSError), _open_file(path) as file:  # in use, or not ours to remove
                if _lock(file.fileno()):
                    _release(file, path)


def _lock_folder(folder: Path) -> IO[bytes]:
    """Return the locked lock file of a folder, with a note on its holder; InputError where another run holds it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = _open_locked(folder / LOCK_NAME)
    except BlockingIOError:
        raise InputError(_holder_message(folder)) from None
    except (OSError, ValueError) as error:
        raise _unwritable_error(folder, error) from error
    try:
        # the note is for the message to others only; the lock itself is that of the operating system
        lock.truncate()
        now = time.strftime("%Y-%m-%d %H:%M:%S")
        lock.write(f"process {os.getpid()} on {socket.gethostname()} since {now}".encode())
        lock.flush()
    except OSError as error:
        _release(lock, folder / LOCK_NAME)
        raise _unwritable_error(folder, error) from error
    return lock


def _unwritable_error(folder: Path, error: Exception) -> InputError:
    return InputError(f"{folder}: nothing can be written here: {cause(error)}. Choose another folder.")


def _holder_message(folder: Path) -> str:
    who = ""
    with suppress(OSError):
        who = (folder / LOCK_NAME).read_bytes()[:200].decode("utf-8", "replace")
    who = "".join(character for character in who if character.isprintable()) or "its process is not known"
    return f"{folder}: another run writes here ({who}); wait until it ends, or choose another folder."


def _open_locked(path: Path) -> IO[bytes]:
    """Open and lock a file, creating it if needed; BlockingIOError where another process has locked it."""
    while True:
        file = _open_file(path, os.O_CREAT)
        try:
            _lock(file.fileno())
            # the file may have been removed between open and lock: a lock on a deleted file protects nothing
            if os.path.samestat(os.fstat(file.fileno()), os.stat(path)):
                return file
        except FileNotFoundError:
            pass  # removed meanwhile, by the one that had it
        except BaseException:
            file.close()
            raise
        file.close()


def _open_file(path: Path, flags: int = 0) -> IO[bytes]:
    safe = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
    return os.fdopen(os.open(path, os.O_RDWR | safe | flags, 0o666), "r+b")


def _release(file: IO[bytes], path: Path) -> None:
    """Remove a locked file, then unlock it.

    In this order, where the system allows it, lest the file of another process be removed.
    """
    steps = (path.unlink, file.close)
    for step in reversed(steps) if sys.platform == "win32" else steps:
        with suppress(OSError):
            step()


def _lock(descriptor: int) -> bool:
    """Lock a file and return whether its file system can; BlockingIOError where another process has locked it."""
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


def _sync_file(file: IO[bytes]) -> None:
    """Flush a file to the disk: its name must not reach it before the content."""
    file.flush()
    os.fsync(file.fileno())


def _sync_folder(folder: Path) -> None:
    """Flush the names in a folder to the disk, where the system can."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
