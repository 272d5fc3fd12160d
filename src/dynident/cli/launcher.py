"""Commands to type next, as they can be pasted: begun as this one was, with names quoted for the shell."""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

__all__ = ["COMMAND", "command", "launcher"]

COMMAND = "DYNIDENT_COMMAND"  # the environment variable with what the user typed in place of ``dynident``


def launcher() -> str:
    """Return what the user typed to start dynident."""
    if given := os.environ.get(COMMAND):
        return given
    started = Path(sys.argv[0] if sys.argv else "")
    if started.name == "__main__.py" and started.parent.name == "dynident":
        return f"{_program(sys.executable)} -m dynident"
    return _program(str(started)) if started.stem == "dynident" else "dynident"


def command(*words: object) -> str:
    """Return a command to paste: the launcher and words, those with spaces or the like in quotes; a ``Path`` is never
    taken for an option.

    >>> command("check", "my robot.yaml").removeprefix(launcher())
    " check 'my robot.yaml'"
    """
    texts = [f".{os.sep}{one}" if isinstance(one, Path) and str(one).startswith("-") else str(one) for one in words]
    return f"{launcher()} {_joined(texts)}"


def _program(path: str) -> str:
    """Return the name of a program that the shell finds by it, else its path."""
    name = Path(path).name if os.name != "nt" else Path(path).stem
    found = shutil.which(name)
    known = found is not None and os.path.realpath(os.path.dirname(found)) == os.path.realpath(os.path.dirname(path))
    return name if known else _joined([path])


def _joined(words: list[str]) -> str:
    return subprocess.list2cmdline(words) if os.name == "nt" else shlex.join(words)
