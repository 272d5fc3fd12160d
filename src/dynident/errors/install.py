"""How to install what is missing, for the Python that is running."""

from __future__ import annotations

import importlib.util
import os
import shlex
import subprocess
import sys

__all__ = ["install_command"]


def install_command(package: str) -> str:
    """Return the command that installs a package for the running Python, as a shell takes it.

    The package itself and no extra of dynident, which may be on no index. An environment made by uv has no pip.
    """
    pip = [sys.executable, "-m", "pip", "install", package]
    uv = ["uv", "pip", "install", "--python", sys.executable, package]
    words = pip if importlib.util.find_spec("pip") else uv
    return subprocess.list2cmdline(words) if os.name == "nt" else shlex.join(words)
