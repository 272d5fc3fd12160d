"""The console of the commands, on which texts are only shown: no markup, no control sequences."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from io import StringIO
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.text import Text

from dynident.cli.escapes import one_line, visible
from dynident.cli.terminal import PIPE
from dynident.cli.voice import voice
from dynident.report.page import PageTable
from dynident.report.terminal import terminal

__all__ = ["Screen"]

PLAIN = str.maketrans({"─": "-", "…": "~"})  # what tables draw, where the output's encoding may not have it


class Screen(Console):
    """A console that shows every text as it is."""

    def __init__(self, **how: Any) -> None:
        super().__init__(markup=False, emoji=False, highlight=False, **how)

    def say(self, text: str, style: str | None = None, whole: bool = False) -> None:
        """Print a result or what was written; ``whole``: in one line, from which a path or command can be copied."""
        self.put(Text(one_line(text), style or ""), whole)

    def remark(self, text: str, style: str | None = None, whole: bool = False) -> None:
        """Print what is said besides the results: notes, warnings, next steps; not with ``--quiet``."""
        self.put(Text(one_line(text), style or ""), whole, silent=voice().quiet)

    def show(self, table: PageTable) -> None:
        """Print a table."""
        columns = tuple(replace(one, title=one_line(one.title), group=one_line(one.group)) for one in table.columns)
        rows = tuple(tuple(map(one_line, row)) for row in table.rows)
        self.put(terminal(PageTable(columns, rows, one_line(table.caption))))

    def put(self, shown: RenderableType, whole: bool = False, silent: bool = False) -> None:
        """Print what rich can print, and keep it in the log; sentences are wrapped at words, only in a terminal."""
        if not silent:
            self.print(shown, soft_wrap=whole or (isinstance(shown, Text) and not self.is_terminal))
        if voice().log is not None:
            plain = Screen(file=StringIO(), width=PIPE, color_system=None, force_terminal=False)
            plain.print(shown, soft_wrap=isinstance(shown, Text))
            voice().keep(plain.file.getvalue().rstrip("\n"))  # type: ignore[attr-defined]

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Render, with escapes in the text of every segment: whatever is printed, nothing of it acts."""
        drawn = {} if self.encoding.startswith("utf") else PLAIN
        for one in super().render(renderable, options):
            yield one if one.control else Segment(visible(one.text).translate(drawn), one.style)
