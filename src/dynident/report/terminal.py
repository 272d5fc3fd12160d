"""Tables in a terminal: whatever its width, no number is cut, and long names are shortened in the middle."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from textwrap import wrap
from typing import TYPE_CHECKING

from rich.cells import cell_len, set_cell_size
from rich.text import Text

from dynident.errors import shortened
from dynident.report.page import Column, PageTable

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions

__all__ = ["TerminalTable", "terminal"]

GAPS = 2, 1  # spaces between columns: as a rule, and where all fit beside each other only then
NAMES = 14, 24  # least width of a column of names: where all columns fit beside each other, and where not
PROSE = 24  # least width of a column of sentences
SHARE = 3  # names beside sentences take up to 1 / SHARE of the width


@dataclass(frozen=True)
class TerminalTable:
    """A table that rich prints: where its columns do not fit beside each other, in parts one below the other."""

    table: PageTable

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Text]:
        if self.table.caption:
            yield Text(self.table.caption, "italic")
        width = options.max_width
        gap = next((gap for gap in GAPS if len(_parts(self.table, width, gap)) == 1), GAPS[0])
        for part in _parts(self.table, width, gap):
            yield from _drawn(self.table, part, width, gap)
            yield Text()


def terminal(table: PageTable) -> TerminalTable:
    """Return the table for a terminal."""
    return TerminalTable(table)


def _parts(table: PageTable, width: int, gap: int) -> list[list[int]]:
    """Return the columns of each part, of which there is one where names that are short enough allow that."""
    parts = _split(table, width, gap, NAMES[0])
    return parts if len(parts) == 1 else _split(table, width, gap, min(NAMES[1], width // SHARE))


def _split(table: PageTable, width: int, gap: int, name: int) -> list[list[int]]:
    """Return the columns of each part; every part begins with the names, and groups stay together where they can."""
    names = [k for k, column in enumerate(table.columns[:2]) if not column.numeric and not column.prose]
    names = names if names == list(range(len(names))) else names[:1]
    taken = sum(_least(table, k, name) + gap for k in names)
    others = [k for k in range(len(table.columns)) if k not in names]
    if len(names) > 1 and taken + max((_least(table, k) for k in others), default=0) > width:
        names, others = names[:1], [*names[1:], *others]
        taken = _least(table, names[0], name) + gap
    parts, room = [list(names)], width - taken
    for _, run in groupby(others, key=lambda k: table.columns[k].group or k):
        columns = list(run)
        whole = sum(_least(table, k) + gap for k in columns) - gap
        groups = [columns] if whole <= width - taken else [[k] for k in columns]
        for group in groups:
            needed = sum(_least(table, k) + gap for k in group)
            if needed - gap > room and len(parts[-1]) > len(names):
                parts, room = [*parts, list(names)], width - taken
            parts[-1] += group
            room -= needed
    return parts


def _least(table: PageTable, k: int, name: int = NAMES[0]) -> int:
    """Return the least width of a column: of its numbers and the longest word of its title; of names it is ``name``."""
    column, cells = table.columns[k], max((cell_len(row[k]) for row in table.rows), default=0)
    title = max(map(cell_len, column.title.split()), default=1)
    return max(title, cells if column.numeric else min(cells, PROSE if column.prose else name))


def _widths(table: PageTable, part: Sequence[int], width: int, gap: int) -> dict[int, int]:
    """Return the widths of a part's columns: the least ones, then names, sentences and titles get what is left."""
    found = {k: _least(table, k, min(NAMES[0], width // SHARE)) for k in part}
    cells = {k: max((cell_len(row[k]) for row in table.rows), default=0) for k in part}
    prose = [k for k in part if table.columns[k].prose]
    left = width - sum(found.values()) - gap * (len(part) - 1)
    for name, run in groupby(part, key=lambda k: table.columns[k].group):
        columns = list(run)
        more = max(0, min(cell_len(name) - sum(found[k] + gap for k in columns) + gap, left))
        found[columns[-1]], left = found[columns[-1]] + more, left - more
    texts = [k for k in part if not table.columns[k].numeric and k not in prose]
    most = width // SHARE if prose else width
    wanted = [(k, min(cells[k], most)) for k in texts] + [(k, cells[k]) for k in prose]
    wanted += [(k, cell_len(table.columns[k].title)) for k in part]
    for k, size in wanted:
        more = max(0, min(size - found[k], left))
        found[k], left = found[k] + more, left - more
    return found


def _drawn(table: PageTable, part: Sequence[int], width: int, gap: int) -> Iterator[Text]:
    """Yield the lines of a part: the groups' headings, the titles, a rule, the rows."""
    widths = _widths(table, part, width, gap)
    columns = [table.columns[k] for k in part]
    if any(column.group for column in columns):
        yield _headings(table, part, widths, gap)
    if any(column.title for column in columns):
        titles = [wrap(column.title, widths[k]) or [""] for k, column in zip(part, columns, strict=True)]
        deepest = max(map(len, titles))
        yield from _lines([[""] * (deepest - len(one)) + one for one in titles], columns, widths, part, gap, "bold")
        yield Text("─" * (sum(widths.values()) + gap * (len(part) - 1)))
    lines = any(table.columns[k].prose for k in part)
    cells = [_cells([row[k] for row in table.rows], table.columns[k], widths[k], lines) for k in part]
    for row in zip(*cells, strict=True):
        yield from _lines(row, columns, widths, part, gap)


def _headings(table: PageTable, part: Sequence[int], widths: dict[int, int], gap: int) -> Text:
    """Return the line with the groups' names, each across its columns."""
    line = Text()
    for name, run in groupby(part, key=lambda k: table.columns[k].group):
        columns = list(run)
        span = sum(widths[k] for k in columns) + gap * (len(columns) - 1)
        line.append(_padded(shortened([name], span)[0], span, right=True), "bold").append(" " * gap)
    line.rstrip()
    return line


def _cells(texts: Sequence[str], column: Column, width: int, lines: bool) -> list[list[str]]:
    """Return the lines of each cell of a column; ``lines``: a cell may have several."""
    texts = [text.replace("∞", "inf") for text in texts]
    if column.numeric:
        return [[text] for text in texts]
    if not lines:
        return [[text] for text in shortened(texts, width)]
    words = list(dict.fromkeys(word for text in texts for word in text.split(" ")))
    short = dict(zip(words, shortened(words, width), strict=True))
    return [_wrapped(" ".join(short[word] for word in text.split(" ")), width) for text in texts]


def _wrapped(text: str, width: int) -> list[str]:
    """Return the lines of a sentence; none begins with %."""
    lines = wrap(text.replace(" %", "\u00a0%"), width, break_on_hyphens=False) or [""]
    return [line.replace("\u00a0%", " %") for line in lines]


def _lines(
    row: Sequence[Sequence[str]],
    columns: Sequence[Column],
    widths: dict[int, int],
    part: Sequence[int],
    gap: int,
    style: str = "",
) -> Iterator[Text]:
    """Yield the lines of a row of cells, each of which has one or several."""
    for depth in range(max(map(len, row), default=0)):
        line = Text(overflow="fold")  # in too narrow a terminal, of which nothing is cut either
        for cell, column, k in zip(row, columns, part, strict=True):
            text = cell[depth] if depth < len(cell) else ""
            line.append(_padded(text, widths[k], column.numeric), style or ("dim" if column.muted else ""))
            line.append(" " * gap)
        line.rstrip()
        yield line


def _padded(text: str, width: int, right: bool) -> str:
    if cell_len(text) > width:
        return text if right else set_cell_size(text, width)
    space = " " * (width - cell_len(text))
    return space + text if right else text + space
