"""Columns of numbers from a text: separator, header and decimal comma are detected, damaged rows reported."""

from __future__ import annotations

import csv
import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Lock
from typing import TYPE_CHECKING, TypeVar

import numpy as np
from numpy.typing import NDArray

from dynident.errors import InputError
from dynident.io.stamps import is_stamp, parse_stamps

if TYPE_CHECKING:
    import polars as pl

__all__ = ["first_row", "parse_text", "row_cells", "unit_row", "unpanicked", "weight"]

Array = NDArray[np.float64]
T = TypeVar("T")
_READING = Lock()  # the descriptors belong to all threads

_NUMBER = re.compile(r"[-+]?(\d+([.,]\d*)?|[.,]\d+)([eE][-+]?\d+)?")
_UNIT = re.compile(r"-|[\[(][^\d\])]{0,12}[\])]|(?!(?i:nan?|null|none|inf)$)[^\W\d_][\w/^*·%°²-]{0,11}|[%°µ]\w{0,3}")
_ENDS = list(b"\n\r\v\f\x1c\x1d\x1e\x85\xa8\xa9")  # bytes that end a line, in any encoding
_SEPARATORS = list(b",;\t ")
_PART = 1 << 20
_EMPTY = ("", "na", "n/a", "null", "none", "nan", "-nan")  # missing values, in lower case


def parse_text(
    data: bytes, source: str
) -> tuple[dict[str, Array], dict[str, str], list[int], tuple[str, ...], dict[str, str]]:
    """Return the columns of a text, the faults of those that are not numbers, the line of each row, the columns that
    hold dates with times, in seconds, and what is in columns with the same text in each row.

    The separator is ``;``, tab, comma or blanks; a decimal comma is read where it is not the separator; lines that
    start with # or % are comments. Raises InputError for truncated rows and for ambiguous numbers.
    """
    lines, body = _lines(data, source)
    separator = _separator(body[min(1, len(body) - 1)][1])
    names, header = _header(body[0][1], [line for k, line in lines if k < body[0][0]], separator)
    body = body[header:]
    if header and body and (units := unit_row(body[0][1], names, separator)) is not None:
        names, body = units, body[1:]
    if not body:
        raise InputError(f"{source}: holds a header, but no row of numbers.")
    numbers, rows = [k for k, _ in body], [row for _, row in body]
    names, rows = _trimmed(names, [row.replace('"', "") for row in rows] if b'"' in data else rows, separator)
    _check_rows(rows, numbers, len(names), separator, source)
    cells, names = _cells(rows, separator), _distinct(names, source)
    columns, faults, stamps = _parsed(cells, names, numbers, source)
    every = {name: cells.gather_every(len(names), k) for k, name in enumerate(names) if name in faults}
    texts = {name: str(column[0]) for name, column in every.items() if column.n_unique() == 1}
    return columns, faults, numbers, stamps, texts


def weight(data: bytes) -> int:
    """Return the memory (bytes) that ``parse_text`` takes at most, by the number of lines and cells (measured)."""
    parts = (np.frombuffer(data[k : k + _PART], np.uint8) for k in range(0, len(data), _PART))
    counts = sum((np.bincount(part, minlength=256) for part in parts), np.zeros(256, int))
    lines = 1 + int(counts[_ENDS].sum())
    return 5 * len(data) + 350 * lines + 80 * (lines + int(counts[_SEPARATORS].sum()))


def _lines(data: bytes, source: str) -> tuple[list[tuple[int, str]], list[tuple[int, str]]]:
    """Return the lines that are not empty with their numbers, and those of them that are no comments."""
    text = _decoded(data, source)
    lines = [(k, line) for k, line in enumerate(text.splitlines(), 1) if line and not line.isspace()]
    commented = "#" in text or "%" in text
    body = [(k, line) for k, line in lines if line.lstrip()[0] not in "#%"] if commented else lines
    if not body:
        raise InputError(f"{source}: holds no numbers, only comments.")
    return lines, body


def _header(line: str, comments: list[str], separator: str | None) -> tuple[list[str], bool]:
    """Return the names of the columns, and whether the first line has them; else the last comment may, or nothing."""
    first = _fields(line, separator)
    numbers = [_is_number(cell) or is_stamp(cell) for cell in first]
    said = _fields(comments[-1].strip().lstrip("#% "), separator) if comments else []
    named = len(said) == len(first) and not any(_NUMBER.fullmatch(cell) for cell in said)
    if not all(numbers) and not (named and separator and any(numbers)):  # a row may have texts, as names of joints
        return first, True
    return (said if len(said) == len(first) else [str(k) for k in range(len(first))]), False


def unit_row(line: str, names: list[str], separator: str | None) -> list[str] | None:
    """Return the names with the units in the line below them, as ``name [unit]``; None where it is no such line."""
    cells = _fields(line, separator)
    if len(cells) != len(names) or not any(_UNIT.fullmatch(cell) for cell in cells):
        return None
    if any(cell and not _UNIT.fullmatch(cell) for cell in cells):
        return None
    bare = [cell.strip("[]()- ") for cell in cells]
    return [f"{name} [{unit}]" if unit else name for name, unit in zip(names, bare, strict=True)]


def first_row(line: str, comments: list[str]) -> tuple[list[str], bool, str | None]:
    """Return of the first line that is no comment the names of the columns, whether it has them, and the separator."""
    separator = _separator(line)
    return *_header(line, comments, separator), separator


def row_cells(line: str, separator: str | None) -> list[str]:
    """Return the cells of a line."""
    return _fields(line, separator)


def _decoded(data: bytes, source: str) -> str:
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16")
    if b"\0" in data:
        raise InputError(f"{source}: is not a text but a binary file; give it the extension of its type.")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:  # an older editor's degree sign in the header; the numbers are ASCII anyhow
        return data.decode("latin-1")


def _separator(line: str) -> str | None:
    """Return the separator of a line: ; before tab before comma, since decimal commas go with the former."""
    return next((mark for mark in (";", "\t", ",") if mark in line), None)


def _fields(line: str, separator: str | None) -> list[str]:
    if separator is None:
        return line.replace('"', "").split()
    cells = (
        next(csv.reader([line], delimiter=separator, skipinitialspace=True)) if '"' in line else line.split(separator)
    )
    return [cell.strip() for cell in cells]


def _is_number(cell: str) -> bool:
    return bool(_NUMBER.fullmatch(cell)) or cell.lower() in (*_EMPTY, "inf", "-inf", "+inf")


def _trimmed(names: list[str], rows: list[str], separator: str | None) -> tuple[list[str], list[str]]:
    """Drop the separator that some recorders write after the last cell of each line."""
    if separator is None or not all(row.endswith(separator) for row in rows):
        return names, rows
    cells = rows[0].count(separator)
    if len(names) == cells + 1 and names[-1] in ("", str(cells)):
        names = names[:-1]
    return (names, [row[:-1] for row in rows]) if len(names) == cells else (names, rows)


def _check_rows(rows: list[str], numbers: list[int], width: int, separator: str | None, source: str) -> None:
    for k, row in enumerate(rows):
        count = len(row.split()) if separator is None else row.count(separator) + 1
        if count == width:
            continue
        hint = "The last line is cut off: delete it." if k == len(rows) - 1 else "Complete or delete the line."
        if separator == "," and count > width:
            hint = "If commas are decimal marks, separate the columns with ';'."
        fields = "1 field" if count == 1 else f"{count} fields"
        raise InputError(f"{source}: line {numbers[k]} has {fields} where {width} are expected. {hint}")


def _distinct(names: list[str], source: str) -> list[str]:
    names = [name or str(k) for k, name in enumerate(names)]
    first: dict[str, int] = {}
    for k, name in enumerate(names):
        if first.setdefault(name, k) < k:
            raise InputError(
                f"{source}: columns {first[name] + 1} and {k + 1} are both named {name!r}; rename one of them."
            )
    return names


def _cells(rows: list[str], separator: str | None) -> pl.Series:
    """Return the cells as texts, row after row."""
    import polars as pl

    if separator is None:
        separator, rows = " ", [" ".join(row.split()) for row in rows]
    return pl.Series([separator.join(rows)]).str.split(separator).explode().str.strip_chars()


def _parsed(
    cells: pl.Series, names: list[str], numbers: list[int], source: str
) -> tuple[dict[str, Array], dict[str, str], tuple[str, ...]]:
    """Return the numbers of each column, with NaN for empty cells, a fault for each column with other text, and the
    columns of dates with times.
    """
    import polars as pl

    values = cells.cast(pl.Float64, strict=False)
    if not values.null_count():  # all are plain numbers
        found = values.to_numpy().reshape(-1, len(names))
        return {name: found[:, k].copy() for k, name in enumerate(names)}, {}, ()
    comma, point = (rf"^[-+]?\d*[{mark}]\d+([eE][-+]?\d+)?$" for mark in ",.")
    decimal_comma = cells.str.contains(comma).any()
    if decimal_comma and cells.str.contains(point).any():
        raise InputError(
            f"{source}: some numbers have a decimal comma and others a decimal point; "
            "write all with one of them and no thousands separators."
        )
    plain = cells.str.replace(",", ".", literal=True) if decimal_comma else cells
    values = plain.cast(pl.Float64, strict=False)
    bad = (values.is_null() & ~cells.str.to_lowercase().is_in(_EMPTY)).to_numpy().reshape(-1, len(names))
    found = values.fill_null(np.nan).to_numpy().reshape(-1, len(names))
    columns, faults, stamps = {}, {}, []
    wrong = np.atleast_1d(bad.any(axis=0))
    for k, name in enumerate(names):
        if wrong[k] and (times := _stamps(cells.gather_every(len(names), k))) is not None:
            columns[name] = times
            stamps.append(name)
        elif wrong[k]:
            row = int(np.argmax(bad[:, k]))
            text, line = cells[row * len(names) + k], numbers[row]
            faults[name] = f"has {text!r} at line {line}, which is not a number; correct or empty the cell."
        else:
            columns[name] = found[:, k].copy()
    return columns, faults, tuple(stamps)


def _stamps(cells: pl.Series) -> Array | None:
    """Return the seconds of a column of dates with times; None where it is none."""
    import polars as pl

    empty = cells.str.to_lowercase().is_in(_EMPTY)
    return parse_stamps(pl.select(pl.when(~empty).then(cells)).to_series())


def unpanicked(read: Callable[[], T]) -> T:
    """Call polars; a panic of its readers, which is not an ``Exception``, becomes one, and its trace is not printed."""
    import polars as pl

    try:
        with _READING, _no_trace():
            return read()
    except pl.exceptions.PanicException as error:
        raise ValueError(str(error)) from error


@contextmanager
def _no_trace() -> Iterator[None]:
    """Send file descriptor 2 to nowhere: Rust writes the trace of a panic there, before Python sees an exception."""
    try:
        kept = os.dup(2)
    except OSError:  # there is no standard error
        yield
        return
    try:
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
