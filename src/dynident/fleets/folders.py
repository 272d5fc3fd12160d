"""What lies where in the folder of a fleet; folders for robots and logs, whose own names may hold anything."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from hashlib import sha256
from pathlib import Path

__all__ = ["FILES", "NOTE", "RECIPE", "REPORT", "RUNS", "TABLE", "folder_names", "is_result"]

RECIPE, NOTE, TABLE, REPORT, RUNS = "recipe.yaml", "fleet.json", "fleet.parquet", "report.html", "runs"
FILES = (RECIPE, NOTE, TABLE, REPORT)

PARTS = f"{TABLE}.parts"

PLAIN = frozenset("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789._-")
RESERVED = {"con", "prn", "aux", "nul", *(f"{name}{k}" for name in ("com", "lpt") for k in range(10))}  # of Windows
LONGEST = 80  # letters


def folder_names(names: Iterable[str]) -> dict[str, str]:
    """Return a folder for each name, by name: readable, the same in every run, and never one for two names.

    Other characters than letters, digits, points and hyphens are written as =xx, which links take as they are. Names
    that then are too long, or alike on a system that ignores case, end with a digest.

    >>> folder_names(["arm 1", "../etc"])
    {'arm 1': 'arm=201', '../etc': '=2E.=2Fetc'}
    """
    every = list(dict.fromkeys(names))
    count = Counter(_escaped(name).casefold() for name in every)
    return {name: _distinct(name) if count[_escaped(name).casefold()] > 1 else _short(name) for name in every}


def is_result(file: Path, out: Path) -> bool:
    """Whether a file is one that a fleet writes to its folder ``out``; others may be there, too."""
    first = file.relative_to(out).parts[:1] if file.is_relative_to(out) else ()
    return first != () and first[0] in (*FILES, RUNS, PARTS)


def _escaped(name: str) -> str:
    text = "".join(one if one in PLAIN else "".join(f"={byte:02X}" for byte in one.encode("utf-8", "surrogatepass"))
                   for one in name)  # fmt: skip
    if text[:1] == ".":
        text = f"=2E{text[1:]}"
    if text[-1:] == ".":
        text = f"{text[:-1]}=2E"
    return text if text.partition(".")[0].lower() not in RESERVED else f"{text}="


def _short(name: str) -> str:
    text = _escaped(name)
    return text if text and len(text) <= LONGEST else _distinct(name)


def _distinct(name: str) -> str:
    """Return a name that no other has: a lone = ends no escape."""
    digest = sha256(name.encode("utf-8", "surrogatepass")).hexdigest()[:12]
    return f"{_escaped(name)[: LONGEST - 14].rstrip('.')}=-{digest}"
