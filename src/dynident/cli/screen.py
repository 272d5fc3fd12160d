"""The console of the commands and their progress, as rich draws them; imported when something is printed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from io import StringIO
from typing import TYPE_CHECKING, Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.progress import Progress, ProgressColumn, SpinnerColumn, Task
from rich.segment import Segment
from rich.text import Text

from dynident.cli.command_log import PIPE, clear_announcement, command_log, escape_controls, escape_step, one_line
from dynident.runtime import progress_to, shorten_names

if TYPE_CHECKING:
    from dynident.report.page import PageTable

ASCII_DRAWING = str.maketrans({"─": "-", "…": "~"})  # what tables draw, where the output's encoding may not have it


class Screen(Console):
    """A console that shows every text as it is."""

    def __init__(self, **how: Any) -> None:
        super().__init__(markup=False, emoji=False, highlight=False, **how)

    def say(self, text: str, style: str | None = None, no_wrap: bool = False) -> None:
        """Print a result or what was written; ``no_wrap``: in one line, from which a path or command can be copied."""
        self.print_and_log(Text(one_line(text), style or ""), no_wrap)

    def remark(self, text: str, style: str | None = None, no_wrap: bool = False, detail: bool = False) -> None:
        """Print what is said besides the results: notes, warnings, next steps; not with ``--quiet``.

        A ``detail`` is printed only with ``--verbose``.
        """
        log = command_log()
        self.print_and_log(Text(one_line(text), style or ""), no_wrap, log.quiet or (detail and not log.verbose))

    def show(self, table: PageTable, detail: bool = False) -> None:
        """Print a table; a ``detail`` only with ``--verbose``."""
        from dynident.report.terminal import TerminalTable

        columns = tuple(
            replace(column, title=one_line(column.title), group=one_line(column.group)) for column in table.columns
        )
        rows = tuple(tuple(map(one_line, row)) for row in table.rows)
        shown = TerminalTable(replace(table, columns=columns, rows=rows, caption=one_line(table.caption)))
        self.print_and_log(shown, silent=detail and not command_log().verbose)

    def print_and_log(self, content: RenderableType, no_wrap: bool = False, silent: bool = False) -> None:
        """Print what rich can print, and keep it in the log; sentences are wrapped at words, only in a terminal."""
        if not silent:
            clear_announcement()
            self.print(content, soft_wrap=no_wrap or (isinstance(content, Text) and not self.is_terminal))
        if command_log().file is not None:
            # the log gets the text as it would be in a pipe, without colours and wrapping
            plain = Screen(file=StringIO(), width=PIPE, color_system=None, force_terminal=False)
            plain.print(content, soft_wrap=isinstance(content, Text))
            command_log().keep(plain.file.getvalue().rstrip("\n"))  # type: ignore[attr-defined]

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """Render with escapes in the text of every segment, so that nothing that is printed acts on the terminal."""
        drawn = {} if self.encoding.startswith("utf") else ASCII_DRAWING
        for segment in super().render(renderable, options):
            yield segment if segment.control else Segment(escape_controls(segment.text).translate(drawn), segment.style)


class _StepColumn(ProgressColumn):
    """The current step in one line of the width that the spinner leaves."""

    def __init__(self, screen: Screen) -> None:
        super().__init__()
        self.screen = screen

    def render(self, task: Task) -> Text:
        return _task_text(task, self.screen.width - 3)


@contextmanager
def progress_bar(words: str) -> Iterator[None]:
    """Show the steps of the work within on standard error, with the time left where it is known.

    ``words`` are shown before the first step.
    """
    log = command_log()
    screen = Screen(stderr=True)
    with Progress(
        SpinnerColumn(), _StepColumn(screen), console=screen, transient=True, refresh_per_second=5
    ) as progress:
        task = progress.add_task(words, total=None)

        def show_step(step: str) -> None:
            current_step, task_state = escape_step(step), progress.tasks[0]
            if line := log.step(current_step):
                progress.console.print(line, soft_wrap=True, markup=False, highlight=False)
            # the time left is that of this step, of which an earlier run may have done a part
            if task_state.description != current_step.words:
                progress.reset(task, description=current_step.words, completed=current_step.completed)
            task_state.total = current_step.total  # to ``update`` and ``reset``, None is no change
            progress.update(task, completed=current_step.completed)

        with progress_to(show_step):
            yield


def _task_text(task: Task, width: int) -> Text:
    """Return the current step in one line: its progress, and the time left where it is known, else the time."""
    completed, total, seconds_left = task.completed, task.total, task.time_remaining
    count = f"{completed:.0f} of {total:.0f}" if total else f"{completed:.0f}" if completed else ""
    time = _format_time(task.elapsed or 0.0) if seconds_left is None else f"about {_format_time(seconds_left)} left"
    tail = "".join(f"  {part}" for part in (count, time) if part)
    return Text(shorten_names([task.description], max(width - len(tail), 10))[0] + tail, no_wrap=True, overflow="crop")


def _format_time(seconds: float) -> str:
    minutes, rest_seconds = divmod(round(seconds), 60)
    return f"{minutes} min {rest_seconds} s" if minutes else f"{rest_seconds} s"
