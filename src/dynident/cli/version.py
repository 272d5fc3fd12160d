"""``dynident --version``: what it was built from and runs with, without importing any of it."""

from __future__ import annotations

import platform
import subprocess
from importlib import metadata
from pathlib import Path

from dynident import __version__
from dynident.kernel import kernel

__all__ = ["commit", "version_text"]

PACKAGES = ("numpy", "scipy", "polars", "click")


def version_text() -> str:
    """Return the versions of dynident, Python and the libraries that results depend on most, and what computes.

    Raises ConfigError, as ``kernel``.
    """
    own = f"dynident {__version__}" + (f", commit {found}" if (found := commit()) else "")
    python = f"{platform.python_implementation()} {platform.python_version()}, {platform.platform()}"
    packages = ", ".join(f"{name} {_version(name)}" for name in PACKAGES)
    return "\n".join((own, python, packages, f"kernel: {kernel()}"))


def commit() -> str | None:
    """Return the commit of the clone from which dynident runs, or was built (`hatch_build.py`), with "-dirty" where
    files differed from it; None where it is not known.
    """
    root, built = Path(__file__).parents[3], Path(__file__).parents[1] / "commit.txt"
    if built.is_file():
        return built.read_text().strip()
    if not (root / ".git").exists() or not (root / "src" / "dynident").is_dir():
        return None
    asked = ["git", "-C", str(root), "describe", "--always", "--dirty", "--exclude=*"]
    try:
        return subprocess.run(asked, capture_output=True, text=True, timeout=5, check=True).stdout.strip()  # noqa: S603
    except (OSError, subprocess.SubprocessError):  # there is no git, or it does not trust the folder
        return None


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "not installed"
