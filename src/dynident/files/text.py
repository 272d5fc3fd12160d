"""Columns of numbers from a text; separator, header and decimal comma are detected, damaged rows reported."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from itertools import takewhile
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from dynident.files.opener import afford
from dynident.files.scope_header import merge_stamps, scope_names
from dynident.files.stamps import is_stamp, join_fractions, parse_stamps
from dynident.files.tables import DataTable, nonempty_content
from dynident.runtime import InputError
from dynident.runtime.arrays import Array

if TYPE_CHECKING:
    import polars as pl

T = TypeVar("T")
_STDERR_LOCK = Lock()  # the descriptors belong to all threads

_NUMBER = re.compile(r"[-+]?(\d+([.,]\d*)?|[.,]\d+)([eE][-+]?\d+)?")
_UNIT_CELL = re.compile(
    r"-|[\[(](?:\d[\d.,e-]* ?(?=[^\W\d]|[%°]))?[^\d\])]{0,12}[\])]"
    r"|(?!(?i:nan?|null|none|inf)$)[^\W\d_][\w/^*·%°²-]{0,11}|[%°µ]\w{0,3}"
)
_LINE_ENDS = list(b"\n\r\v\f\x1c\x1d\x1e\x85\xa8\xa9")  # bytes that end a line, in any encoding
_SEPARATORS = list(b",;\t ")
_COUNT_SIZE = 1 << 20
MAX_TITLE_LINES = 50  # above the names of the columns
_MISSING = ("", "na", "n/a", "null", "none", "nan", "-nan")  # missing values, in lower case


def read_text(path: Path, needed: Collection[str] | None = None) -> DataTable:  # noqa: ARG001
    """Read a table of text; columns of dates with times are in seconds.

    The separator is ``;``, tab, comma or blanks; a decimal comma is read where it is not the separator. Lines that
    start with # or % are comments, and a title may stand above the names, which may be repeated further below. Lists
    in cells, such as ``[0.1, 0.2]``, are columns ``name[0]``, ``name[1]``, ... Rows of one joint each, in a fixed
    order, become rows of all joints, with columns ``joint.name``. Raises InputError for truncated rows and for
    ambiguous numbers.
    """
    data, source = nonempty_content(path), str(path)
    afford(_parsing_memory(data), f"{path}: its {len(data) / 1e6:.3g} MB of text would take")
    lines, body = _split_lines(data, source)
    # not from the first line, as names of columns may contain commas, nor from a line that is cut off
    longest = max((line for _, line in body[1:][-3:] or body), key=len)
    separator = _find_separator(longest)
    body = _drop_title(body, len(row_cells(longest, separator)), separator)
    comments = [line for k, line in lines if k < body[0][0]]
    names, header = _find_header(body[0][1], comments, separator, body[1][1] if len(body) > 1 else "")
    top = (row_cells(line, separator) for _, line in body[:MAX_TITLE_LINES])
    above = takewhile(lambda cells: not (cells and (_is_number(cells[0]) or is_stamp(cells[0]))), top)
    scope_columns, scope_lines = scope_names(above)
    names, header_lines = (scope_columns, scope_lines) if scope_lines else (names, int(header))
    heads, body = body[:header_lines], body[header_lines:]
    if header and body and (units := unit_row(body[0][1], names, separator)) is not None:
        names, heads, body = units, [*heads, body[0]], body[1:]
    # recorders that append to a file write its header again
    repeatable = {line for _, line in heads}
    body = [(k, row) for k, row in body if row not in repeatable] if repeatable else body
    if not body or not names:
        raise InputError(f"{source}: holds {'a header, but ' if header else ''}no row of numbers.")
    numbers, rows = [k for k, _ in body], [row for _, row in body]
    names, rows = _expand_lists(names, rows, separator) if separator else (names, rows)
    # quotes are removed only here: names in the header may hold the separator inside them
    names, rows = _trim_separator(names, [row.replace('"', "") for row in rows] if b'"' in data else rows, separator)
    _check_rows(rows, numbers, len(names), separator, source)
    cells, names = _split_cells(rows, separator), _check_distinct(names, source)
    columns, faults, stamps = _parse_cells(cells, names, numbers, source)
    columns = merge_stamps(columns) if scope_lines else columns
    joined_stamps = join_fractions(columns)
    columns |= joined_stamps
    faulty_cells = {name: cells.gather_every(len(names), k) for k, name in enumerate(names) if name in faults}
    texts = {name: str(column[0]) for name, column in faulty_cells.items() if column.n_unique() == 1}
    columns, faults, n = _gather_keys(columns, {k: column.to_numpy() for k, column in faulty_cells.items()}, faults)
    stamp_units = dict.fromkeys((*stamps, *joined_stamps), "s")
    return DataTable(columns, {}, source, faults, numbers[::n], units=stamp_units, texts=texts)


def _parsing_memory(data: bytes) -> int:
    """Return the memory (bytes) that ``read_text`` takes at most, by the number of lines and cells (measured)."""
    parts = (np.frombuffer(data[k : k + _COUNT_SIZE], np.uint8) for k in range(0, len(data), _COUNT_SIZE))
    counts = sum((np.bincount(part, minlength=256) for part in parts), np.zeros(256, int))
    lines = 1 + int(counts[_LINE_ENDS].sum())
    return 5 * len(data) + 350 * lines + 80 * (lines + int(counts[_SEPARATORS].sum()))


def _split_lines(data: bytes, source: str) -> tuple[list[tuple[int, str]], list[tuple[int, str]]]:
    """Return the nonempty lines with their numbers, and those of them that are not comments."""
    text = _decode(data, source)
    # numbers of lines as an editor shows them, for the messages
    lines = [(k, line) for k, line in enumerate(text.splitlines(), 1) if line and not line.isspace()]
    commented = "#" in text or "%" in text
    body = [(k, line) for k, line in lines if line.lstrip()[0] not in "#%"] if commented else lines
    if not body:
        raise InputError(f"{source}: holds no numbers, only comments.")
    return lines, body


def _drop_title(body: list[tuple[int, str]], width: int, separator: str | None) -> list[tuple[int, str]]:
    """Return the lines from the names of ``width`` columns on, if these stand below others of fewer or more cells."""
    for k, (_, line) in enumerate(body[:MAX_TITLE_LINES]):
        cells = row_cells(line, separator)
        if len(cells) == width:
            return body if any(_is_number(cell) or is_stamp(cell) for cell in cells) else body[k:]
    return body


def _find_header(line: str, comments: list[str], separator: str | None, next_line: str = "") -> tuple[list[str], bool]:
    """Return the column names, and whether the first line has them; else the last comment may have them."""
    cells, numbers = row_cells(line, separator), _numeric_cells(line, separator)
    # some recorders write the names of the columns in a comment
    comment_cells = row_cells(comments[-1].strip().lstrip("#% "), separator) if comments else []
    is_named_by_comment = len(comment_cells) == len(cells) and not any(
        _NUMBER.fullmatch(cell) for cell in comment_cells
    )
    # a row may have texts, as names of joints; without names, the next line is like it, and no name is a decimal
    has_decimals = any("." in cell for cell, number in zip(cells, numbers, strict=True) if number)
    is_row = is_named_by_comment or (has_decimals and numbers == _numeric_cells(next_line, separator))
    if not all(numbers) and not (is_row and separator and any(numbers)):
        return cells, True
    return (comment_cells if len(comment_cells) == len(cells) else [str(k) for k in range(len(cells))]), False


def _numeric_cells(line: str, separator: str | None) -> list[bool]:
    return [_is_number(cell) or is_stamp(cell) for cell in row_cells(line, separator)]


def unit_row(line: str, names: list[str], separator: str | None) -> list[str] | None:
    """Return the names with the units of the line below them, as ``name [unit]``; None where it has no units.

    Where names are repeated, the line below tells them apart, as ``name.joint``.
    """
    cells = row_cells(line, separator)
    if len(cells) != len(names):
        return None
    if len(set(names)) < len(names) and not any(cell and _is_number(cell) for cell in cells):
        return [f"{name}.{cell}" if cell else name for name, cell in zip(names, cells, strict=True)]
    if not any(_UNIT_CELL.fullmatch(cell) for cell in cells):
        return None
    if any(cell and not _UNIT_CELL.fullmatch(cell) for cell in cells):
        return None
    bare = [cell.strip("[]()- ") for cell in cells]
    return [f"{name} [{unit}]" if unit else name for name, unit in zip(names, bare, strict=True)]


def first_row(line: str, comments: list[str]) -> tuple[list[str], bool, str | None]:
    """Return column names of the first line, whether it is a header, and the separator."""
    separator = _find_separator(line)
    return *_find_header(line, comments, separator), separator


def _decode(data: bytes, source: str) -> str:
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16")
    if b"\0" in data:
        raise InputError(f"{source}: is not a text but a binary file; give it the extension of its type.")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:  # an older editor's degree sign in the header; the numbers are ASCII anyhow
        return data.decode("latin-1")


def _find_separator(line: str) -> str | None:
    """Return the separator of a line: ; before tab before comma, since decimal commas go with the former."""
    return next((mark for mark in (";", "\t", ",") if mark in line), None)


def row_cells(line: str, separator: str | None) -> list[str]:
    """Return the cells of a line."""
    if separator is None:
        return line.replace('"', "").split()
    pieces = line.split(separator)
    cells = _join_quoted(pieces, separator) if '"' in line else pieces
    return [cell.strip() for cell in cells]


def _join_quoted(pieces: list[str], separator: str) -> Iterator[str]:
    """Yield the cells of a line that was split within quotes, too, without the quotes around them."""
    cell, quotes = list[str](), 0
    for piece in pieces:
        cell.append(piece)
        quotes += piece.count('"')
        # an odd number of quotes: the separator was within them
        if quotes % 2 and cell[0].lstrip().startswith('"'):
            continue
        yield _unquote(separator.join(cell))
        cell, quotes = [], 0
    if cell:  # a quote without an end
        yield _unquote(separator.join(cell))


def _unquote(cell: str) -> str:
    cell = cell.strip()
    return cell.removeprefix('"').removesuffix('"').replace('""', '"') if cell.startswith('"') else cell


def _is_number(cell: str) -> bool:
    return bool(_NUMBER.fullmatch(cell)) or cell.lower() in (*_MISSING, "inf", "-inf", "+inf")


def _expand_lists(names: list[str], rows: list[str], separator: str) -> tuple[list[str], list[str]]:
    """Return names and rows with a column for each item of the lists in cells."""
    list_cell = re.compile(rf'(?<![^{separator}]) *"?[\[(]([^\[\]()]*)[\])]"? *(?![^{separator}])')

    def items(cell: re.Match[str]) -> list[str]:
        return re.split(r"[,;\s]+", cell[1].replace("'", "").strip())

    # the number of its items takes the place of a list, whose commas are no ends of cells
    cells = row_cells(list_cell.sub(lambda cell: f"[{len(items(cell))}]", rows[0]), separator)
    sizes = [int(cell[1:-1]) if re.fullmatch(r"\[\d+\]", cell) else 0 for cell in cells]
    if len(cells) != len(names) or not any(sizes):
        return names, rows
    expanded_names = [
        f"{name}[{k}]" if size else name for name, size in zip(names, sizes, strict=True) for k in range(size or 1)
    ]
    return expanded_names, [list_cell.sub(lambda cell: separator.join(items(cell)), row) for row in rows]


def _trim_separator(names: list[str], rows: list[str], separator: str | None) -> tuple[list[str], list[str]]:
    """Drop the separator that some recorders write after the last cell of each line."""
    if separator is None or not all(row.endswith(separator) for row in rows):
        return names, rows
    # the header may have a name for the empty last cell, or none
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
        if k == 0 and width == 1:
            hint = "Begin the lines of a title with #."
        elif separator == "," and count > width:
            hint = "If commas are decimal marks, separate the columns with ';'."
        fields = "1 field" if count == 1 else f"{count} fields"
        raise InputError(f"{source}: line {numbers[k]} has {fields} where {width} are expected. {hint}")


def _check_distinct(names: list[str], source: str) -> list[str]:
    names = [name or str(k) for k, name in enumerate(names)]
    first_index: dict[str, int] = {}
    for k, name in enumerate(names):
        if first_index.setdefault(name, k) < k:
            raise InputError(
                f"{source}: columns {first_index[name] + 1} and {k + 1} are both named {name!r}; "
                "give each column a name of its own, in one line."
            )
    return names


def _split_cells(rows: list[str], separator: str | None) -> pl.Series:
    """Return the cells as texts, row after row."""
    import polars as pl

    if separator is None:
        separator, rows = " ", [" ".join(row.split()) for row in rows]
    return pl.Series([separator.join(rows)]).str.split(separator).explode().str.strip_chars()


def _parse_cells(
    cells: pl.Series, names: list[str], numbers: list[int], source: str
) -> tuple[dict[str, Array], dict[str, str], tuple[str, ...]]:
    """Return the numbers of each column (NaN for empty cells), faults of other columns, and stamp columns."""
    import polars as pl

    values = cells.cast(pl.Float64, strict=False)
    if not values.null_count():  # all are plain numbers
        table = values.to_numpy().reshape(-1, len(names))
        return {name: table[:, k].copy() for k, name in enumerate(names)}, {}, ()
    comma, point = (rf"^[-+]?\d*[{mark}]\d+([eE][-+]?\d+)?$" for mark in ",.")
    decimal_comma = cells.str.contains(comma).any()
    # a thousands separator cannot be told from a decimal mark where both occur
    if decimal_comma and cells.str.contains(point).any():
        raise InputError(
            f"{source}: some numbers have a decimal comma and others a decimal point; "
            "write all with one of them and no thousands separators."
        )
    plain = cells.str.replace(",", ".", literal=True) if decimal_comma else cells
    values = plain.cast(pl.Float64, strict=False)
    bad = (values.is_null() & ~cells.str.to_lowercase().is_in(_MISSING)).to_numpy().reshape(-1, len(names))
    table = values.fill_null(np.nan).to_numpy().reshape(-1, len(names))
    columns, faults, stamps = {}, {}, []
    is_faulty = np.atleast_1d(bad.any(axis=0))
    for k, name in enumerate(names):
        if is_faulty[k] and (times := _stamp_column(cells.gather_every(len(names), k))) is not None:
            columns[name] = times
            stamps.append(name)
        elif is_faulty[k]:
            row = int(np.argmax(bad[:, k]))
            text, line = cells[row * len(names) + k], numbers[row]
            faults[name] = f"has {text!r} at line {line}, which is not a number; correct or empty the cell."
        else:
            columns[name] = table[:, k].copy()
    return columns, faults, tuple(stamps)


def _gather_keys(
    columns: Mapping[str, Array], texts: Mapping[str, Any], faults: Mapping[str, str]
) -> tuple[dict[str, Array], dict[str, str], int]:
    """Return columns ``key.name`` with a row for each time where rows are of one key each, such as a joint.

    A column of texts or numbers repeats the keys in a fixed order, while a column of stamps stays the same. Beside the
    columns these are the faults under their new names, and the number of keys, 1 where the table stays as it is.
    """
    for key_name, values in {**texts, **columns}.items():
        n = 1 + int(np.argmax(values[1:] == values[0])) if len(values) > 1 else 1
        # more times than keys: stamps repeat, too, in runs of one length
        if (
            n == 1
            or len(values) % n
            or len(values) < n * n
            or (values[n:] != values[:-n]).any()
            or len(set(values[:n])) < n
        ):
            continue
        blocks = {name: column.reshape(-1, n) for name, column in columns.items() if name != key_name}
        alike = {name for name, block in blocks.items() if (block == block[:, :1]).all()}
        if any((blocks[name][1:, 0] > blocks[name][:-1, 0]).all() for name in alike):
            keys = [key if isinstance(key, str) else f"{key:g}" for key in values[:n]]
            by_key = {
                f"{key}.{x}": blocks[x][:, k].copy() for k, key in enumerate(keys) for x in blocks if x not in alike
            }
            key_faults = {f"{key}.{x}": fault for x, fault in faults.items() if x != key_name for key in keys}
            return {x: blocks[x][:, 0].copy() for x in blocks if x in alike} | by_key, key_faults, n
    return dict(columns), dict(faults), 1


def _stamp_column(cells: pl.Series) -> Array | None:
    """Return the seconds of a column of dates with times; None where it is not one."""
    import polars as pl

    empty = cells.str.to_lowercase().is_in(_MISSING)
    return parse_stamps(pl.select(pl.when(~empty).then(cells)).to_series())


def call_polars(read: Callable[[], T]) -> T:
    """Call polars; a panic of its readers, which is not an ``Exception``, becomes ValueError without a trace."""
    import polars as pl

    try:
        with _STDERR_LOCK, _silence_stderr():
            return read()
    except pl.exceptions.PanicException as error:
        raise ValueError(str(error)) from error


@contextmanager
def _silence_stderr() -> Iterator[None]:
    """Send file descriptor 2 to the null device.

    Rust writes the trace of a panic there, before Python can catch it.
    """
    try:
        saved = os.dup(2)
    except OSError:  # there is no standard error
        yield
        return
    try:
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), 2)
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
