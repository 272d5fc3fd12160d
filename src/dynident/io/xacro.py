"""Macros of URDF files, expanded by ROS's program xacro.

A xacro file is code: its expressions are evaluated. The program runs without a shell, and within a time and a size.
"""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from threading import Timer

from dynident.errors import ModelError, install_command, memory
from dynident.io.opener import XML_WEIGHT, find, keep, real

__all__ = ["XACRO", "expand"]

XACRO = ".xacro"
LONGEST = 60.0  # s
ADVICE = (
    "expand the file where ROS is installed, with `xacro robot.urdf.xacro > robot.urdf`, and name robot.urdf; or "
    "install xacro by: "
)


def expand(path: Path) -> str:
    """Return the URDF that a xacro file stands for, with the default values of its arguments.

    Raises ModelError where the file is not there, xacro is not installed, fails, or takes more than a minute.
    """
    find(path, ModelError, (XACRO, ".urdf"))
    keep(path)
    out, errors, code = _run([*_program(path), str(real(path, ModelError))])
    if len(out) * XML_WEIGHT > memory():
        raise ModelError(f"{path}: xacro makes more of it than the memory that a file may take.")
    if code < 0:
        raise ModelError(
            f"{path}: xacro was stopped after {LONGEST:g} s; expand the file by hand, and name the result."
        )
    if code:
        lines = [line for line in errors.decode(errors="replace").splitlines() if line.strip()]
        words = "".join(x if x.isprintable() else " " for x in " ".join(lines[-6:]))[:500]
        raise ModelError(f"{path}: xacro cannot expand it: {words or f'it ends with code {code}'}.")
    try:
        return out.decode()
    except UnicodeDecodeError as error:
        raise ModelError(f"{path}: what xacro makes of it is not a UTF-8 text ({error}).") from error


def _program(path: Path) -> list[str]:
    """Return the command on the path, else that of the installed package."""
    if (command := shutil.which("xacro")) is not None:
        return [command]
    if importlib.util.find_spec("xacro") is None:
        raise ModelError(f"{path}: needs xacro, which is not installed: {ADVICE}{install_command('xacro')}")
    return [sys.executable, "-P", "-c", "from xacro import main; main()"]


def _run(command: list[str]) -> tuple[bytes, bytes, int]:
    """Return output, errors and exit code of a program; the code is negative where it was stopped."""
    with (
        tempfile.TemporaryFile() as errors,
        subprocess.Popen(  # noqa: S603 - the program is xacro, and no shell reads its argument
            command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=errors
        ) as process,
    ):
        alarm = Timer(LONGEST, process.kill)
        alarm.start()
        try:
            out = process.stdout.read(memory() // XML_WEIGHT + 1) if process.stdout else b""
            if len(out) > memory() // XML_WEIGHT:
                process.kill()
            code = process.wait()
        finally:
            alarm.cancel()
            process.kill()
        errors.seek(0)
        return out, errors.read(100_000), code
