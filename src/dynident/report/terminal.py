"""Tables in a terminal: whatever its width, no number is cut, and long names are shortened in the middle."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from itertools import groupby
from textwrap import wrap
from typing import TYPE_CHECKING

import numpy as np
from rich.cells import cell_len, set_cell_size
from rich.text import Text

from dynident.report.check import check_summary, check_tables
from dynident.report.identification.figures import error_figure, motion_figure, run_figure, torque_figure
from dynident.report.identification.head import error_lines
from dynident.report.identification.parameters import parameter_figure, terminal_parameters
from dynident.report.identification.report import verdict_text
from dynident.report.identification.validation import error_table
from dynident.report.page import Column, PageTable
from dynident.runtime import InputError, Noun, Use, choices, escape_acting, join_names, number, shorten_names

if TYPE_CHECKING:
    import plotly.graph_objects as go
    from rich.console import Console, ConsoleOptions

    from dynident.checks import CheckResult
    from dynident.identification import Identification
    from dynident.models import Joint
    from dynident.validation import LogValidation

COLUMN_GAPS = 2, 1  # spaces between columns: as a rule, and where all fit beside each other only then
MIN_NAME_WIDTHS = 14, 24  # least width of a column of names: where all columns fit beside each other, and where not
MIN_PROSE_WIDTH = 24  # least width of a column of sentences
NAME_DIVISOR = 3  # names beside sentences take up to 1 / SHARE of the width
MAX_LISTED = 3  # parameters, logs and findings of a summary
MAX_SENTENCE_LENGTH = 100  # letters of a sentence there


@dataclass(frozen=True)
class TerminalTable:
    """A table that rich prints: where its columns do not fit beside each other, in parts one below the other."""

    table: PageTable

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Text]:
        if self.table.caption:
            yield Text(self.table.caption, "italic")
        width = options.max_width
        gap = next((gap for gap in COLUMN_GAPS if len(_table_parts(self.table, width, gap)) == 1), COLUMN_GAPS[0])
        for part in _table_parts(self.table, width, gap):
            yield from _part_lines(self.table, part, width, gap)
            yield Text()


def _table_parts(table: PageTable, width: int, gap: int) -> list[list[int]]:
    """Return the columns of each part; there is one part where short enough names allow that."""
    parts = _split_columns(table, width, gap, MIN_NAME_WIDTHS[0])
    if len(parts) == 1:
        return parts
    return _split_columns(table, width, gap, min(MIN_NAME_WIDTHS[1], width // NAME_DIVISOR))


def _split_columns(table: PageTable, width: int, gap: int, name: int) -> list[list[int]]:
    """Return the columns of each part; every part begins with the names, and groups stay together where they can."""
    names = [k for k, column in enumerate(table.columns[:2]) if not column.numeric and not column.prose]
    names = names if names == list(range(len(names))) else names[:1]
    names_width = sum(_min_width(table, k, name) + gap for k in names)
    data_columns = [k for k in range(len(table.columns)) if k not in names]
    # Two columns of names leave no room for others: keep the first, and treat the second as any other
    if len(names) > 1 and names_width + max((_min_width(table, k) for k in data_columns), default=0) > width:
        names, data_columns = names[:1], [*names[1:], *data_columns]
        names_width = _min_width(table, names[0], name) + gap
    parts, room = [list(names)], width - names_width
    for _, run in groupby(data_columns, key=lambda k: table.columns[k].group or k):
        columns = list(run)
        total = sum(_min_width(table, k) + gap for k in columns) - gap
        # The columns of a group stay together unless the group is wider than a part
        groups = [columns] if total <= width - names_width else [[k] for k in columns]
        for group in groups:
            needed = sum(_min_width(table, k) + gap for k in group)
            if needed - gap > room and len(parts[-1]) > len(names):
                parts, room = [*parts, list(names)], width - names_width
            parts[-1] += group
            room -= needed
    return parts


def _min_width(table: PageTable, k: int, name: int = MIN_NAME_WIDTHS[0]) -> int:
    """Return the least width of a column: its numbers and the longest word of its title, or ``name`` for names."""
    column, cells = table.columns[k], max((cell_len(row[k]) for row in table.rows), default=0)
    title = max(map(cell_len, column.title.split()), default=1)
    return max(title, cells if column.numeric else min(cells, MIN_PROSE_WIDTH if column.prose else name))


def _column_widths(table: PageTable, part: Sequence[int], width: int, gap: int) -> dict[int, int]:
    """Return the widths of a part's columns: the least ones, widened by what is left for names, sentences, titles."""
    widths = {k: _min_width(table, k, min(MIN_NAME_WIDTHS[0], width // NAME_DIVISOR)) for k in part}
    cells = {k: max((cell_len(row[k]) for row in table.rows), default=0) for k in part}
    prose = [k for k in part if table.columns[k].prose]
    spare = width - sum(widths.values()) - gap * (len(part) - 1)
    # Widen the last column of a group until the group's heading fits
    for name, run in groupby(part, key=lambda k: table.columns[k].group):
        columns = list(run)
        extra = max(0, min(cell_len(name) - sum(widths[k] + gap for k in columns) + gap, spare))
        widths[columns[-1]], spare = widths[columns[-1]] + extra, spare - extra
    # Names, then sentences, then titles take what width is left
    texts = [k for k in part if not table.columns[k].numeric and k not in prose]
    max_text = width // NAME_DIVISOR if prose else width
    targets = [(k, min(cells[k], max_text)) for k in texts] + [(k, cells[k]) for k in prose]
    targets += [(k, cell_len(table.columns[k].title)) for k in part]
    for k, size in targets:
        extra = max(0, min(size - widths[k], spare))
        widths[k], spare = widths[k] + extra, spare - extra
    return widths


def _part_lines(table: PageTable, part: Sequence[int], width: int, gap: int) -> Iterator[Text]:
    """Yield the lines of a part: the groups' headings, the titles, a rule, the rows."""
    widths = _column_widths(table, part, width, gap)
    columns = [table.columns[k] for k in part]
    if any(column.group for column in columns):
        yield _heading_line(table, part, widths, gap)
    if any(column.title for column in columns):
        titles = [wrap(column.title, widths[k]) or [""] for k, column in zip(part, columns, strict=True)]
        # Titles of one line stand at the bottom, next to their column
        deepest = max(map(len, titles))
        titles = [[""] * (deepest - len(title)) + title for title in titles]
        yield from _row_lines(titles, columns, [*widths.values()], gap, "bold")
        yield Text("─" * (sum(widths.values()) + gap * (len(part) - 1)))
    lines = any(table.columns[k].prose for k in part)
    cells = [_cell_lines([row[k] for row in table.rows], table.columns[k], widths[k], lines) for k in part]
    for row in zip(*cells, strict=True):
        yield from _row_lines(row, columns, [*widths.values()], gap)


def _heading_line(table: PageTable, part: Sequence[int], widths: dict[int, int], gap: int) -> Text:
    """Return the line with the groups' names, each across its columns."""
    line = Text()
    for name, run in groupby(part, key=lambda k: table.columns[k].group):
        columns = list(run)
        span = sum(widths[k] for k in columns) + gap * (len(columns) - 1)
        line.append(_pad(shorten_names([name], span)[0], span, right=True), "bold").append(" " * gap)
    line.rstrip()
    return line


def _cell_lines(texts: Sequence[str], column: Column, width: int, lines: bool) -> list[list[str]]:
    """Return the lines of each cell of a column; ``lines``: a cell may have several."""
    texts = [text.replace("∞", "inf") for text in texts]
    if column.numeric:
        return [[text] for text in texts]
    if not lines:
        return [[text] for text in shorten_names(texts, width)]
    words = list(dict.fromkeys(word for text in texts for word in text.split(" ")))
    short = dict(zip(words, shorten_names(words, width), strict=True))
    return [_wrap_sentence(" ".join(short[word] for word in text.split(" ")), width) for text in texts]


def _wrap_sentence(text: str, width: int) -> list[str]:
    """Return the lines of a sentence; none begins with %."""
    lines = wrap(text.replace(" %", "\u00a0%"), width, break_on_hyphens=False) or [""]
    return [line.replace("\u00a0%", " %") for line in lines]


def _row_lines(
    row: Sequence[Sequence[str]], columns: Sequence[Column], widths: Sequence[int], gap: int, style: str = ""
) -> Iterator[Text]:
    """Yield the lines of a row of cells, each of which has one or several."""
    for depth in range(max(map(len, row), default=0)):
        line = Text(overflow="fold")  # in too narrow a terminal, of which nothing is cut either
        for cell, column, width in zip(row, columns, widths, strict=True):
            text = cell[depth] if depth < len(cell) else ""
            line.append(_pad(text, width, column.numeric), style or ("dim" if column.muted else ""))
            line.append(" " * gap)
        line.rstrip()
        yield line


def _pad(text: str, width: int, right: bool) -> str:
    if cell_len(text) > width:
        return text if right else set_cell_size(text, width)
    space = " " * (width - cell_len(text))
    return space + text if right else text + space


def summary(identification: Identification) -> str:
    """Return a few lines: what the model is fit for, the torque errors, and the first parameters."""
    return "\n".join(_summary_lines(identification))


def _summary_lines(identification: Identification) -> Iterator[str]:
    verdict = identification.verdict
    yield f"<Identification of {identification.model.name!r}" + (f": {verdict.use.value}" if verdict else "")
    if verdict and verdict.use is Use.DO_NOT_USE:
        yield f"  {_shorten(str(verdict.reasons[0]))}"
    yield from (f"  {line}" for line in error_lines(identification))
    estimate = identification.estimate
    rows = zip(estimate.names, estimate.value, identification.errors.std, estimate.units, strict=True)
    ordered = sorted(rows, key=lambda row: not np.isfinite(row[2]))  # what the data determine first
    estimates = (f"{name} = {number(value)} +- {number(std, 2)} {unit}" for name, value, std, unit in ordered)
    yield f"  {join_names(estimates, MAX_LISTED)}>"


def check_lines(check: CheckResult) -> str:
    """Return a few lines: how many errors and warnings there are, and the most severe of them."""
    worst = [row for table in check_tables(check)[: len(check.findings) and 1] for row in table.rows][:MAX_LISTED]
    lines = [f"<CheckResult: {check_summary(check)}", *(_shorten(f"  {': '.join(filter(None, row))}") for row in worst)]
    return "\n".join(lines) + ">"


def check_html(check: CheckResult) -> str:
    """Return the findings and the facts behind them as HTML for a notebook; all texts are escaped."""
    summary, tables = escape(check_summary(check)), "".join(map(_table_html, check_tables(check)))
    return escape_acting(f"<div><p><b>{summary}</b></p>{tables}</div>")


def _shorten(text: str) -> str:
    return text if len(text) <= MAX_SENTENCE_LENGTH else f"{text[:MAX_SENTENCE_LENGTH]}..."


def summary_html(identification: Identification) -> str:
    """Return the verdict, the errors and the parameters as HTML for a notebook; all texts are escaped."""
    table, notes = terminal_parameters(identification)
    verdict = "A result of an older version; its verdict is in its report."
    if identification.verdict is not None:
        verdict = verdict_text(identification, None)
    parts = [f"<h4>{escape(identification.model.name)}</h4>", f"<p><b>{escape(verdict)}</b></p>"]
    parts += [*map(_table_html, (error_table(identification), table)), *(f"<p>{escape(note)}</p>" for note in notes)]
    return escape_acting(f"<div>{''.join(parts)}</div>")


def _table_html(table: PageTable) -> str:
    sides = ["right" if column.numeric else "left" for column in table.columns]
    heads = "".join(
        f'<th style="text-align: {side}">{escape(column.group)}{"<br>" * bool(column.group)}{escape(column.title)}</th>'
        for side, column in zip(sides, table.columns, strict=True)
    )
    rows = (
        "".join(f'<td style="text-align: {side}">{escape(cell)}</td>' for side, cell in zip(sides, row, strict=True))
        for row in table.rows
    )
    body = "".join(f"<tr>{row}</tr>" for row in rows)
    return f"<table><caption>{escape(table.caption)}</caption><tr>{heads}</tr>{body}</table>"


class Plot(Noun):
    """The figures of a report, drawn by plotly; a notebook shows each that a cell returns, ``write_html`` writes it.

    ``log`` and ``joint`` are names; by default the first log that was held out, and the joint with its largest error.
    Raises InputError for unknown names, and for signals of a result that was loaded from a file.
    """

    identification: Identification

    def __repr__(self) -> str:
        calls = ("torque(log, joint)", "smoothing(log, joint)", "free_run(log, joint)", "errors()", "parameters()")
        return f"<Plot of {self.identification.model.name!r}: {', '.join(calls)}; each has write_html(file)>"

    def torque(self, log: str | None = None, joint: str | None = None) -> go.Figure:
        """Draw measured and predicted torque of one joint, and their difference."""
        validation, axis = self._select(log, joint)
        return torque_figure(validation, axis.name, axis.effort).figure()

    def smoothing(self, log: str | None = None, joint: str | None = None) -> go.Figure:
        """Draw position, velocity and acceleration of one joint, and what the smoothing took away."""
        validation, axis = self._select(log, joint)
        return motion_figure(validation.motion, axis.name, axis.unit, recorded=validation.recorded_log).figure()

    def free_run(self, log: str | None = None, joint: str | None = None) -> go.Figure:
        """Draw measured and simulated position of one joint; InputError where there is no free simulation."""
        validation, axis = self._select(log, joint)
        if validation.free_run is None:
            words = "there is no free simulation; ask for one by the field `restart` of a recipe."
            raise InputError(f"{validation.name}: {words}")
        return run_figure(validation.free_run, axis.name, axis.unit).figure()

    def errors(self) -> go.Figure:
        """Draw the torque error of each joint on all logs."""
        joints = [joint.name for joint in self.identification.model.joints]
        return error_figure(self.identification.validations, joints).figure()

    def parameters(self) -> go.Figure:
        """Draw the 95 % interval of each parameter, in % of its value."""
        rows = list(range(len(self.identification.estimate.names)))
        return parameter_figure(self.identification, rows).figure.figure()

    def _select(self, log: str | None, joint: str | None) -> tuple[LogValidation, Joint]:
        logs = {validation.name: validation for validation in self.identification.validations}
        if log is None:
            log = next(iter(self.identification.of_role("validation")), next(iter(logs.values()))).name
        if log not in list(logs):
            raise InputError(f"there is no log {log!r}; {choices(log, logs)}")
        joints = {axis.name: axis for axis in self.identification.model.joints}
        if joint is None:
            joint = max(joints, key=lambda name: logs[log].errors.per_joint.get(name, 0.0))
        if joint not in list(joints):
            raise InputError(f"there is no joint {joint!r}; {choices(joint, joints)}")
        return logs[log], joints[joint]
