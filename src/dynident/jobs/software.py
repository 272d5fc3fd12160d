"""The software that decides what numbers a process gives, to be compared between processes."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from functools import cache
from hashlib import sha256
from importlib import metadata
from pathlib import Path

from dynident import __version__
from dynident.errors import listed
from dynident.kernel import kernel

__all__ = ["code_digest", "code_version", "differences", "software"]

SOURCE = Path(__file__).parents[1]
PACKAGES = ("numpy", "scipy", "sympy", "clarabel", "distributed")
FEW = 3  # places that are named


@cache
def software() -> dict[str, str]:
    """Return the versions of what this process computes with, by name; what computes, without its level, of which all
    give the same bits. Raises ConfigError, as ``kernel``."""
    return {
        "Python": f"{sys.version_info.major}.{sys.version_info.minor}",
        "dynident": __version__,
        "the code of dynident": code_digest(),
        "the kernel of dynident": "compiled" if kernel().level else "NumPy and LAPACK",
        **{name: _version(name) for name in PACKAGES},
    }


def differences(here: Mapping[str, str], there: Mapping[str, Mapping[str, str]]) -> list[str]:
    """Return what differs between this process and others, given by place: ``numpy is 2.4.6 here, 2.4.5 on ...``."""
    found = []
    for name, own in here.items():
        others: dict[str, list[str]] = {}
        for place, theirs in there.items():
            if (other := theirs.get(name, own)) != own:
                others.setdefault(other, []).append(place)
        if others:
            said = (f"{other} on {listed(places, FEW)}" for other, places in others.items())
            found.append(f"{name} is {own} here, {', '.join(said)}")
    return found


@cache
def code_version() -> str:
    """Return the version of the code: that of the package, a digest of its sources, and "kernel" or "numpy".

    All levels of the kernel give the same numbers, NumPy others by rounding.
    """
    return f"{metadata.version('dynident')}+{code_digest()}.{'kernel' if kernel().level else 'numpy'}"


def code_digest() -> str:
    """Return a digest of the Python files of the package; those of C have theirs in the kernel's."""
    every = sha256()
    for path in sorted(SOURCE.rglob("*.py"), key=lambda one: one.relative_to(SOURCE).parts):
        content = path.read_bytes().replace(b"\r\n", b"\n")
        every.update(f"{path.relative_to(SOURCE).as_posix()} {len(content)}\n".encode() + content)
    return every.hexdigest()[:12]


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return "missing"
