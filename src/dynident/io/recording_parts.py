"""One recording in several Parquet files: a folder of them, or a pattern such as ``day/*.parquet``."""

from __future__ import annotations

import glob
import os
import re
from pathlib import Path

from dynident.errors import InputError

__all__ = ["PARQUET", "is_divided", "recording_parts"]

PARQUET = ".parquet"


def is_divided(path: Path) -> bool:
    """Return whether a path names parts of a recording: a pattern, or a folder with Parquet files that is no bag."""
    if os.path.isdir(path):  # also of a name that is too long
        return not (path / "metadata.yaml").exists() and any(one.suffix.lower() == PARQUET for one in path.iterdir())
    return glob.has_magic(path.name) and not os.path.exists(path)


def recording_parts(path: Path) -> tuple[Path, ...]:
    """Return the parts of a recording in the order of their names, in which numbers count as such; or the file alone.

    Raises InputError where a pattern matches nothing, or another file than Parquet.
    """
    if not is_divided(path):
        return (path,)
    pattern = "*" if path.is_dir() else path.name
    folder = path if path.is_dir() else path.parent
    found = sorted(Path(folder, name) for name in glob.glob(pattern, root_dir=folder))
    kept = [one for one in found if one.suffix.lower() == PARQUET]
    if not path.is_dir() and len(kept) < len(found):
        other = next(one for one in found if one not in kept)
        raise InputError(f"{path}: matches {other.name}, too; the parts of one recording must be Parquet files.")
    if not kept:
        raise InputError(f"{path}: matches no file; look at the folder and the pattern.")
    return tuple(sorted(kept, key=lambda one: _natural(one.name)))


def _natural(name: str) -> list[tuple[int, str]]:
    """Return a key by which part10 follows part9."""
    return [(int(one), "") if one.isdigit() else (-1, one) for one in re.split(r"(\d+)", name)]
