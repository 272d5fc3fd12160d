"""Compiles the kernel with whatever C compiler there is; only the standard library is needed.

``hatch_build.py`` and ``dev.py`` load this file by its path, where dynident is installed from sources, without it.
"""

from __future__ import annotations

import hashlib
import os
import platform
import sys
import time
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from subprocess import Popen

FOLDER = Path(__file__).parent
FILE = "kernel.bin"  # the same name everywhere: ctypes needs no suffix
RECORD = "kernel.bin.sum"  # beside it: of which sources it is, and its own checksum
# of each architecture the levels from the least to the best: name, doubles in a vector, flags
LEVELS = {
    "x86_64": (("sse2", 2, ()), ("avx2", 4, ("-mavx2", "-mfma")), ("avx512", 8, ("-mavx512f", "-mavx512dq", "-mfma"))),
    "aarch64": (("neon", 2, ()),),
    "": (("scalar", 2, ()),),
}
FLAGS = ("-std=c11", "-O3", "-ffp-contract=off", "-fno-math-errno", "-fvisibility=hidden", "-Wall", "-Wno-psabi")
SECONDS = 60.0  # an installation does not wait longer for a compiler


class BuildError(Exception):
    """No compiler could make the library; the text says why."""


def architecture(machine: str | None = None) -> str:
    """Return the key of LEVELS for this machine, or one of the given name."""
    name = (machine or platform.machine()).lower()
    keys = {"amd64": "x86_64", "x86_64": "x86_64", "arm64": "aarch64", "aarch64": "aarch64"}
    return keys.get(name, "")


def digest() -> str:
    """Return the digest of the sources, which tells a library made of these from one of others."""
    files = [*sorted(FOLDER.glob("*.[ch]")), Path(__file__)]
    return hashlib.sha256(b"".join(path.read_bytes().replace(b"\r\n", b"\n") for path in files)).hexdigest()[:16]


def record(library: bytes) -> str:
    """Return the text of RECORD for a library of these sources."""
    return f"{digest()} {hashlib.sha256(library).hexdigest()}\n"


def compilers() -> list[list[str]]:
    """Return the compilers of this machine, the best first: $CC, cc, clang, gcc.

    Raises BuildError where $CC is no command.
    """
    import shlex
    import shutil

    try:
        cc_command = shlex.split(os.environ.get("CC", ""), posix=os.name != "nt")
    except ValueError as error:
        raise BuildError(f"CC is {os.environ['CC']!r}: {error}") from error
    commands = [cc_command] if cc_command else []
    commands += [[path] for name in ("cc", "clang", "gcc") if (path := shutil.which(name))]
    return commands


def make(
    target: Path, compiler: Sequence[str] | None = None, machine: str | None = None, seconds: float = SECONDS
) -> None:
    """Compile the library into ``target``, with its RECORD beside it; BuildError where that is not possible.

    ``compiler`` is a command, by default the first that works; ``machine`` the architecture it compiles for; a compiler
    that takes longer than ``seconds`` is ended. OSError where the folder cannot be written to.
    """
    import shlex

    errors = []
    for command in [list(compiler)] if compiler else compilers():
        try:
            library = _compile(command, architecture(machine), time.monotonic() + seconds)
        except (OSError, BuildError) as error:
            errors.append(f"{shlex.join(command)}: {error}")
        else:
            _write_atomically(target, library)
            _write_atomically(target.with_name(RECORD), record(library).encode())
            return
    raise BuildError("; ".join(errors) or "there is no C compiler (cc, clang, gcc)")


def _compile(command: list[str], machine: str, until: float) -> bytes:
    """Compile each source for each level at the same time, then link them; return the library."""
    import tempfile

    # only Windows needs no position-independent code
    code, libraries = ((), ()) if os.name == "nt" else (("-fPIC",), ("-lm",))
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        jobs = {"cpu.o": ["-DLANES=2", "-DLEVEL=any", str(FOLDER / "cpu.c")]}
        for level, width, flags in LEVELS[machine]:
            for path in sorted(FOLDER.glob("*.c")):
                if path.name != "cpu.c":
                    options = [f"-DLANES={width}", f"-DLEVEL={level}", *flags]
                    jobs[f"{path.stem}_{level}.o"] = [*options, str(path)]
        _run_commands(
            ([*command, *FLAGS, *code, *words, "-c", "-o", name] for name, words in jobs.items()), folder, until
        )
        _run_commands([[*command, "-shared", "-o", FILE, *jobs, *libraries]], folder, until)
        return Path(folder, FILE).read_bytes()


def _run_commands(commands: Iterable[list[str]], folder: str, until: float) -> None:
    """Run commands at the same time; BuildError where one fails or takes too long, and then none goes on."""
    from subprocess import DEVNULL, PIPE, Popen, TimeoutExpired

    running: list[Popen[str]] = []
    try:
        for command in commands:
            process = Popen(  # noqa: S603
                command,
                cwd=folder,
                stdin=DEVNULL,
                stdout=DEVNULL,
                stderr=PIPE,
                text=True,
                errors="replace",
                start_new_session=True,
            )
            running.append(process)
        while running:
            messages = running[0].communicate(timeout=max(0.0, until - time.monotonic()))[1]
            if code := running.pop(0).returncode:
                raise BuildError(messages.strip()[-2000:] or f"ends with code {code}")
    except TimeoutExpired as error:
        raise BuildError("it took too long and was ended") from error
    finally:
        for process in running:
            _end_process(process)


def _end_process(process: Popen[str]) -> None:
    """End a process, and what it has started, which may outlive it."""
    import signal

    if os.name == "nt":
        process.kill()
    else:
        with suppress(OSError):
            os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    if process.stderr is not None:
        process.stderr.close()


def _write_atomically(target: Path, content: bytes) -> None:
    """Write a file at once: a process that has the old one loaded keeps it, and two that write do no harm."""
    import tempfile

    handle, name = tempfile.mkstemp(prefix=f"{FILE}.", dir=target.parent)
    try:
        with open(handle, "wb") as file:
            file.write(content)
        os.chmod(name, 0o644)  # for all who share the environment
        os.replace(name, target)
    except BaseException:
        with suppress(OSError):
            os.unlink(name)
        raise


if __name__ == "__main__":
    try:
        make(FOLDER / FILE)
    except (BuildError, OSError) as error:
        sys.exit(f"The kernel is not compiled, NumPy and LAPACK are used instead: {error}")
