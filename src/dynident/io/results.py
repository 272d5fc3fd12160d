"""Results to files, never half written."""

from __future__ import annotations

import json
import math
import os
import shutil
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any
from uuid import uuid4

import numpy as np

from dynident.errors import ConfigError, InputError, choices
from dynident.io.folder import whole_file, write_whole
from dynident.io.opener import afford, content, real, refuse_inputs
from dynident.io.text import unpanicked

if TYPE_CHECKING:
    import polars as pl

__all__ = [
    "CHANGED",
    "append_log",
    "as_path",
    "check_json",
    "json_text",
    "probe_folder",
    "read_table",
    "replace_text",
    "table_kind",
    "write_bytes",
    "write_json",
    "write_table",
    "write_text",
]

_TABLES = (".parquet", ".csv")
_COMPRESSED = (b"\x1f\x8b", b"x\x01", b"x\x9c", b"x\xda", b"(\xb5/\xfd")  # what polars would decompress
CHANGED = "has been changed by another program since it was read; nothing was written. Start again to read it as it is."
WIDTH = 160  # of a line of JSON that holds a whole mapping


def as_path(path: object) -> Path:
    """Return a path; InputError for what is none."""
    if not isinstance(path, str | Path):
        raise InputError(f"the path of a file or folder is expected, not {path!r}.")
    return Path(path)


def check_json(target: Path) -> None:
    """Raise ConfigError where a file that is no JSON, such as a recording, would be replaced."""
    if os.path.exists(target) and target.suffix.lower() != ".json":
        raise ConfigError(f"{target}: exists already and is not named .json; choose another name for the numbers.")


def probe_folder(folder: str | Path) -> None:
    """Make a folder and a file in it, and remove both: InputError, before long work, where that is impossible."""
    folder = real(folder)
    probe = folder / f".dynident-{uuid4().hex}.tmp"
    try:
        made = [one for one in (folder, *folder.parents) if not os.path.exists(one)]
        folder.mkdir(parents=True, exist_ok=True)
        try:
            probe.touch(exist_ok=False)
        finally:
            probe.unlink(missing_ok=True)
            for one in made:
                one.rmdir()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"{folder}: nothing can be written here: {reason}. Choose another folder.") from error


def append_log(path: Path, head: str) -> IO[str]:
    """Open a log to add lines to, which begins with the words ``head``, at most buffered by line; folders are made.

    Raises InputError where that is impossible, or where the file is there and begins otherwise: it is no log.
    """
    refuse_inputs(path)
    if os.path.exists(path) and (old := content(path, remember=False)) and not old.startswith(head.encode()):
        raise InputError(f"{path}: exists already and is no log of dynident; choose another name for the log.")
    try:
        real(path).parent.mkdir(parents=True, exist_ok=True)
        file = open(real(path), "a", buffering=1, encoding="utf-8", errors="backslashreplace")  # noqa: SIM115
        if not file.tell():
            file.write(f"{head}\n")
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}. Choose another name for the log.") from error
    return file


def write_text(path: str | Path, text: str) -> Path:
    """Write UTF-8 text and return the path; folders are made. Raises InputError where that is impossible."""
    return write_bytes(as_path(path), text.encode("utf-8", "backslashreplace"))


def replace_text(path: Path, text: str, was: str) -> None:
    """Write UTF-8 text in place of ``was``, which a file must still hold: as a whole, with its mode, links followed.

    Raises ConfigError where the file is not as it was, InputError where it cannot be written, is there no longer, or
    may only be read: the folder alone would let it be replaced.
    """
    place = real(path)
    if not os.path.exists(place):
        raise InputError(f"{path}: is there no longer; nothing was written. Put it back, then start again.")
    if not (os.access(place, os.W_OK) and place.stat().st_mode & 0o222):
        raise InputError(f"{path}: may only be read; nothing was changed. Allow writing it, then try again.")
    try:
        with whole_file(place) as temporary:
            temporary.write_bytes(text.encode())
            shutil.copymode(place, temporary)
            if content(place, ConfigError, remember=False) != was.encode():
                raise ConfigError(f"{path}: {CHANGED}")
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(f"{path}: cannot be written: {reason}. Nothing was changed; allow writing.") from error


def write_json(path: str | Path, data: Any) -> Path:
    """Write JSON of mappings, sequences, NumPy values and paths, a line for each row; NaN and infinity become null.

    Raises InputError where the file cannot be written, TypeError for values that JSON cannot hold.
    """
    return write_text(path, json_text(data))


def json_text(data: Any) -> str:
    """Return what ``write_json`` writes."""
    return _text(_plain(data)) + "\n"


def write_table(path: str | Path, frame: pl.DataFrame) -> Path:
    """Write a polars table as Parquet or CSV, by the file's extension; InputError for another one."""
    path = Path(path)
    buffer = BytesIO()
    if table_kind(path) == ".parquet":
        frame.write_parquet(buffer)
    else:
        frame.write_csv(buffer)
    return write_bytes(path, buffer.getvalue())


def read_table(path: str | Path) -> pl.DataFrame:
    """Read a table that ``write_table`` wrote; InputError where it is missing or damaged."""
    import polars as pl

    path = Path(path)
    kind = table_kind(path)
    data = content(path, weight=1 if kind == ".parquet" else 20, remember=False)
    try:
        if data.startswith(_COMPRESSED):
            raise ValueError("it is compressed")
        return unpanicked(lambda: _parquet(data, path) if kind == ".parquet" else _csv(data))
    except (pl.exceptions.PolarsError, ValueError) as error:
        raise InputError(f"{path}: is not a readable table ({error}); delete it and run again.") from error


def _csv(data: bytes) -> pl.DataFrame:
    import polars as pl

    return pl.read_csv(BytesIO(data), infer_schema_length=None)


def _parquet(data: bytes, path: Path) -> pl.DataFrame:
    import polars as pl

    rows = pl.scan_parquet(BytesIO(data)).select(pl.len()).collect().item()
    afford(16 * rows * len(pl.read_parquet_schema(BytesIO(data))), f"{path}: its {rows} rows would take")
    return pl.read_parquet(BytesIO(data))


def table_kind(path: Path) -> str:
    """Return the extension of a table's file; InputError for one that is not known."""
    kind = path.suffix.lower()
    if kind not in _TABLES:
        raise InputError(f"{path}: tables cannot have the extension {kind!r}; {choices(kind, _TABLES)}")
    return kind


def _text(value: Any, indent: str = "") -> str:
    """Return JSON with lists of plain values, and mappings of a few, in one line."""
    inside = list(value.values()) if isinstance(value, dict) else value
    if not isinstance(value, dict | list) or not any(isinstance(one, dict | list) for one in inside):
        line = _dumps(value)
        if not isinstance(value, dict) or len(line) + len(indent) <= WIDTH:
            return line
    more = indent + "  "
    rows = [_text(one, more) for one in inside]
    if isinstance(value, dict):
        rows = [f"{_dumps(key)}: {row}" for key, row in zip(value, rows, strict=True)]
    opening, closing = "{}" if isinstance(value, dict) else "[]"
    return f"{opening}\n{more}" + f",\n{more}".join(rows) + f"\n{indent}{closing}"


def _dumps(value: Any) -> str:
    r"""Return JSON in one line; characters that a reader does not see, or that a terminal acts on, as ``\\u202e``."""
    line = json.dumps(value, ensure_ascii=False, allow_nan=False)
    return line if line.isprintable() else "".join(one if one.isprintable() else json.dumps(one)[1:-1] for one in line)


def _plain(value: Any) -> Any:
    """Return the value in types that JSON knows."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return str(value) if isinstance(value, Path) else value


def write_bytes(path: Path, data: bytes) -> Path:
    """Write bytes and return the path; folders are made. Raises InputError where that is impossible."""
    try:
        write_whole(path, data)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError(
            f"{path}: cannot be written: {reason}. Make room, allow writing, or choose another folder."
        ) from error
    return path
