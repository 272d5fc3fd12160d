"""Writing of results, as a whole or not at all."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any
from uuid import uuid4

import numpy as np

from dynident.files.folder import write_whole
from dynident.files.opener import afford, cause, content, real_path, refuse_inputs, remember_inputs
from dynident.files.parquet import row_count
from dynident.files.text import call_polars
from dynident.runtime import ConfigError, InputError, check_type, choices

if TYPE_CHECKING:
    import polars as pl

_TABLES = (".parquet", ".csv")
_COMPRESSION_MAGIC = (b"\x1f\x8b", b"x\x01", b"x\x9c", b"x\xda", b"(\xb5/\xfd")  # what polars would decompress
MAX_LINE_WIDTH = 160  # of a line of JSON that holds a whole mapping


def as_path(path: object) -> Path:
    """Return a path; InputError for an object that is none."""
    check_type("path", path, (str, Path), "give the path of a file or folder")
    return Path(path)  # type: ignore[arg-type]


def claim_json(target: Path | None, *inputs: str | Path) -> None:
    """Raise the error, before long work, that a JSON file cannot be written or would replace another kind of file.

    It may not be one of the ``inputs`` either. None is no file, and cannot fail.
    """
    for path in inputs:
        remember_inputs(path)
    if target is None:
        return
    refuse_inputs(target)
    if os.path.exists(target) and target.suffix.lower() != ".json":
        raise ConfigError(f"{target}: exists already and is not named .json; choose another name for the numbers.")
    probe_folder(target.parent)


def probe_folder(folder: str | Path) -> None:
    """Create a folder and a file in it, and remove both; InputError, before long work, where that fails."""
    folder = real_path(folder)
    probe = folder / f".dynident-{uuid4().hex}.tmp"
    try:
        created = [directory for directory in (folder, *folder.parents) if not os.path.exists(directory)]
        folder.mkdir(parents=True, exist_ok=True)
        try:
            probe.touch(exist_ok=False)
        finally:
            probe.unlink(missing_ok=True)
            for directory in created:
                directory.rmdir()
    except (OSError, ValueError) as error:
        raise InputError(f"{folder}: nothing can be written here: {cause(error)}. Choose another folder.") from error


def append_log(path: Path, head: str) -> IO[str]:
    """Open a log for appending, which begins with the line ``head``; folders are created.

    Raises InputError where that is impossible, or where the file exists and begins otherwise, so that it is no
    log.
    """
    refuse_inputs(path)
    if os.path.exists(path) and (old := content(path, remember=False)) and not old.startswith(head.encode()):
        raise InputError(f"{path}: exists already and is no log of dynident; choose another name for the log.")
    try:
        real_path(path).parent.mkdir(parents=True, exist_ok=True)
        file = open(real_path(path), "a", buffering=1, encoding="utf-8", errors="backslashreplace")  # noqa: SIM115
        if not file.tell():
            file.write(f"{head}\n")
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {cause(error)}. Choose another name for the log.") from error
    return file


def write_text(path: str | Path, text: str) -> Path:
    """Write UTF-8 text and return the path; folders are made. Raises InputError where that is impossible."""
    return write_bytes(as_path(path), text.encode("utf-8", "backslashreplace"))


def write_json(path: str | Path, data: Any) -> Path:
    """Write mappings, sequences, NumPy values and paths as JSON, one row per line; NaN and infinity become null.

    Raises InputError where the file cannot be written, TypeError for values that JSON cannot hold.
    """
    return write_text(path, json_text(data))


def json_text(data: Any) -> str:
    """Return what ``write_json`` writes."""
    return _format_json(_to_json_types(data)) + "\n"


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
        # a small compressed file could fill the memory
        if data.startswith(_COMPRESSION_MAGIC):
            raise ValueError("it is compressed")
        if kind == ".csv":
            return call_polars(lambda: pl.read_csv(BytesIO(data), infer_schema_length=None))
        rows, columns = row_count(BytesIO(data)), call_polars(lambda: pl.read_parquet_schema(BytesIO(data)))
        afford(16 * rows * len(columns), f"{path}: its {rows} rows would take")
        return call_polars(lambda: pl.read_parquet(BytesIO(data)))
    except (pl.exceptions.PolarsError, ValueError) as error:
        raise InputError(f"{path}: is not a readable table ({error}); delete it and run again.") from error


def table_kind(path: Path) -> str:
    """Return the extension of a table's file; InputError for one that is not known."""
    kind = path.suffix.lower()
    if kind not in _TABLES:
        raise InputError(f"{path}: tables cannot have the extension {kind!r}; {choices(kind, _TABLES)}")
    return kind


def _format_json(value: Any, indent: str = "") -> str:
    """Return JSON with lists of plain values, and short mappings, on one line."""
    children = list(value.values()) if isinstance(value, dict) else value
    # a collection without others inside stands on one line, which keeps matrices readable
    if not isinstance(value, dict | list) or not any(isinstance(child, dict | list) for child in children):
        line = _json_line(value)
        if not isinstance(value, dict) or len(line) + len(indent) <= MAX_LINE_WIDTH:
            return line
    inner_indent = indent + "  "
    rows = [_format_json(child, inner_indent) for child in children]
    if isinstance(value, dict):
        rows = [f"{_json_line(key)}: {row}" for key, row in zip(value, rows, strict=True)]
    opening, closing = "{}" if isinstance(value, dict) else "[]"
    return f"{opening}\n{inner_indent}" + f",\n{inner_indent}".join(rows) + f"\n{indent}{closing}"


def _json_line(value: Any) -> str:
    r"""Return JSON on one line, with invisible and control characters escaped, as ``\\u202e``."""
    line = json.dumps(value, ensure_ascii=False, allow_nan=False)
    return (
        line
        if line.isprintable()
        else "".join(character if character.isprintable() else json.dumps(character)[1:-1] for character in line)
    )


def _to_json_types(value: Any) -> Any:
    """Return the value in types that JSON has."""
    if isinstance(value, Mapping):
        return {str(key): _to_json_types(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return _to_json_types(value.tolist())
    if isinstance(value, list | tuple):
        return [_to_json_types(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return str(value) if isinstance(value, Path) else value


def write_bytes(path: Path, data: bytes) -> Path:
    """Write bytes and return the path; folders are made. Raises InputError where that is impossible."""
    try:
        write_whole(path, data)
    except (OSError, ValueError) as error:
        raise InputError(
            f"{path}: cannot be written: {cause(error)}. Make room, allow writing, or choose another folder."
        ) from error
    return path
