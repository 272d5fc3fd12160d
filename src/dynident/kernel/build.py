"""Compiles the kernel with whatever C compiler there is; only the standard library is needed.

Used where dynident is installed from sources (``hatch_build.py``) and for the wheels of other systems
(``tools/wheels.py``), both of which load this file by its path, without dynident.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import platform
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

__all__ = ["FILE", "LEVELS", "BuildError", "architecture", "compilers", "digest", "make"]

FOLDER = Path(__file__).parent
FILE = "kernel.bin"  # the same name everywhere: ctypes needs no suffix
# of each architecture the levels from the least to the best: name, doubles in a vector, flags
LEVELS = {
    "x86_64": (("sse2", 2, ()), ("avx2", 4, ("-mavx2", "-mfma")), ("avx512", 8, ("-mavx512f", "-mavx512dq", "-mfma"))),
    "aarch64": (("neon", 2, ()),),
    "": (("scalar", 2, ()),),
}
FLAGS = ("-std=c11", "-O3", "-ffp-contract=off", "-fno-math-errno", "-fvisibility=hidden", "-Wall", "-Wno-psabi")
SECONDS = 300.0  # a compiler that takes longer hangs


class BuildError(Exception):
    """No compiler could make the library; the text says why."""


def architecture(machine: str | None = None) -> str:
    """Return the key of LEVELS for this machine, or one of the given name."""
    name = (machine or platform.machine()).lower()
    known = {"amd64": "x86_64", "x86_64": "x86_64", "arm64": "aarch64", "aarch64": "aarch64"}
    return known.get(name, "")


def digest() -> str:
    """Return what tells a library of these sources from one of others."""
    files = [*sorted(FOLDER.glob("*.[ch]")), Path(__file__)]
    return hashlib.sha256(b"".join(path.read_bytes().replace(b"\r\n", b"\n") for path in files)).hexdigest()[:16]


def compilers() -> list[list[str]]:
    """Return the compilers of this machine, the best first: $CC, cc, clang, gcc, or that of the package ziglang."""
    found = [shlex.split(os.environ["CC"])] if os.environ.get("CC") else []
    found += [[path] for name in ("cc", "clang", "gcc") if (path := shutil.which(name))]
    if importlib.util.find_spec("ziglang"):
        found.append([sys.executable, "-m", "ziglang", "cc"])
    return found


def make(target: Path, compiler: Sequence[str] | None = None, machine: str | None = None) -> None:
    """Compile the library into ``target``; BuildError where that is not possible, and then nothing is written.

    ``compiler`` is a command, by default the first that works; ``machine`` the architecture it compiles for.
    """
    tried = [list(compiler)] if compiler else compilers()
    errors = []
    for command in tried:
        try:
            return _made(target, command, architecture(machine))
        except (OSError, subprocess.SubprocessError, BuildError) as error:
            errors.append(f"{shlex.join(command)}: {error}")
    raise BuildError("; ".join(errors) or "there is no C compiler (cc, clang, gcc, or the package ziglang)")


def _made(target: Path, command: list[str], machine: str) -> None:
    """Compile each source for each level at the same time, then link them."""
    with tempfile.TemporaryDirectory() as place:
        jobs = [(Path(place, "cpu.o"), "cpu.c", [f'-DSOURCES="{digest()}"', "-DLANES=2", "-DLEVEL=any"])]
        for level, width, flags in LEVELS[machine]:
            for source in sorted(path.name for path in FOLDER.glob("*.c") if path.name != "cpu.c"):
                defined = [f"-DLANES={width}", f"-DLEVEL={level}", *flags]
                jobs.append((Path(place, f"{source}.{level}.o"), source, defined))
        code = () if os.name == "nt" and not any("target" in word for word in command) else ("-fPIC",)
        running = [
            subprocess.Popen(  # noqa: S603
                [*command, *FLAGS, *code, *defined, "-c", str(FOLDER / source), "-o", str(out)],
                stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, errors="replace",
            )
            for out, source, defined in jobs
        ]  # fmt: skip
        said = [process.communicate(timeout=SECONDS)[1] for process in running]
        for process, text in zip(running, said, strict=True):
            if process.returncode:
                raise BuildError(text.strip()[-2000:])
        library = Path(place, FILE)
        link = [*command, "-shared", "-o", str(library), *(str(out) for out, _, _ in jobs)]
        done = subprocess.run(  # noqa: S603
            link, capture_output=True, text=True, errors="replace", timeout=SECONDS
        )
        if done.returncode or not library.is_file():
            raise BuildError(done.stderr.strip()[-2000:] or "nothing was linked")
        fresh = target.with_name(f"{target.name}.new")
        shutil.copyfile(library, fresh)
        os.replace(fresh, target)  # a process that has the old one loaded keeps it


if __name__ == "__main__":
    make(FOLDER / FILE)
