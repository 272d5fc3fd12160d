"""The console of the commands, on which texts are only shown: no markup, no control sequences."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.text import Text

from dynident.cli.terminal import one_line, visible
from dynident.report.page import PageTable
from dynident.report.terminal import terminal

__all__ = ["Screen"]


class Screen(Console):
    """A console that shows every text as it is."""

    def __init__(self, **how: Any) -> None:
        super().__init__(markup=False, emoji=False, highlight=False, **how)

    def say(self, text: str, style: str | None = None) -> None:
        """Print a message, which a terminal may wrap."""
        self.print(Text(one_line(text), style or ""), soft_wrap=True)

    def show(self, table: PageTable) -> None:
        """Print a table."""
        columns = tuple(replace(one, title=one_line(one.title), group=one_line(one.group)) for one in table.columns)
        rows = tuple(tuple(map(one_line, row)) for row in table.rows)
        self.print(terminal(PageTable(columns, rows, one_line(table.caption))))

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Render, with escapes in the text of every segment: whatever is printed, nothing of it acts."""
        for one in super().render(renderable, options):
            yield one if one.control else Segment(visible(one.text), one.style)
