"""Output of the commands: the console, and the progress on standard error, only in a terminal."""

from __future__ import annotations

import platform
import re
import sys
import time
import unicodedata
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from datetime import datetime
from io import StringIO
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import click
from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.text import Text

from dynident._version import __version__
from dynident.runtime import Step, progress_to, shorten_names

if TYPE_CHECKING:
    from rich.progress import Task

    from dynident.report.note_words import Line
    from dynident.report.page import PageTable

REPEAT_INTERVAL = 30.0  # s after which it is said again how much of a step is done
LOG_HEAD = "# Log of dynident."  # the first words of every log file: no other file is appended to

_COMMAND_LOG: ContextVar[CommandLog | None] = ContextVar("voice", default=None)

PIPE = 150  # columns where standard output is no terminal
BAR_DELAY = 2.0  # s after which a bar and the time left are shown
MIN_STEPS_FOR_RATE = 100  # steps, of which the rate is shown
BAR_CELLS = 5, 20  # of a bar, from narrow to wide terminals

ASCII_DRAWING = str.maketrans({"─": "-", "…": "~"})  # what tables draw, where the output's encoding may not have it


def escape_controls(text: str) -> str:
    r"""Return a text with escapes for all that could act on a terminal, except line breaks.

    These are the control characters (ESC, BEL, backspace, C1), those that change the direction of writing or are
    invisible, and halves of surrogate pairs, by which Python represents the bytes of names that are no text.
    """
    if text.isprintable():
        return text
    return "".join(
        character if character == "\n" or _is_printable(character) else character.encode("unicode_escape").decode()
        for character in text
    )


def one_line(text: str) -> str:
    r"""Return a message with controls escaped as by ``escape_controls``; only an indented line stands alone.

    Other line breaks, those of names, are escaped: no name can pass for a message.
    """
    return re.sub(r"\n(?!  )", r"\\n", escape_controls(text).rstrip("\n"))


def _is_printable(character: str) -> bool:
    return character.isprintable() or unicodedata.category(character) == "Zs"


@dataclass
class CommandLog:
    """How much a command prints; ``file`` takes all of it, and ``began`` (s) is when the run began.

    ``last_words`` are those of the last step, and ``last_time`` (s) when it was printed, counted from the start.
    """

    verbose: bool = False
    quiet: bool = False
    path: Path | None = None
    file: IO[str] | None = None
    began: float = field(default_factory=time.monotonic)
    last_words: str = ""
    last_time: float = 0.0

    @property
    def elapsed_seconds(self) -> float:
        """Seconds since the command began."""
        return time.monotonic() - self.began

    def keep(self, text: str) -> None:
        """Write a text to the log file, each line with the time; where that fails, as on a full disk, warn and go
        on."""
        if self.file is None:
            return
        now = datetime.now().astimezone().isoformat(sep=" ", timespec="milliseconds")
        try:
            self.file.writelines(f"{now}  {line.rstrip()}\n" for line in escape_controls(text).splitlines() or [""])
        except OSError as error:
            self._close_file()
            name = one_line(str(self.path))
            click.echo(f"Warning: {name}: the log ends here, it cannot be written: {error.strerror}.", err=True)

    def step(self, step: Step) -> str:
        """Write a new step, or each half minute its progress, to the log file; return the line to print of it, if
        any."""
        is_repeated, now = step.words == self.last_words, self.elapsed_seconds
        if is_repeated and (now - self.last_time < REPEAT_INTERVAL or step == step.words):
            return ""
        self.last_words, self.last_time, text = step.words, now, str(step) if is_repeated else step.words
        self.keep(text)
        return f"{now:7.1f} s  {text}" if self.verbose else ""

    def open(self) -> None:
        """Open the log file, if one is requested; raises InputError where the file is another one, or cannot be
        written."""
        if self.path is None or self.file is not None:
            return
        from dynident.files.results import append_log

        self.file = append_log(self.path, LOG_HEAD)
        self.keep(f"dynident {__version__}, Python {platform.python_version()}, {platform.platform()}")
        self.keep(f"in {Path.cwd()}: {' '.join(map(repr, sys.argv))}")

    def close(self, code: object) -> None:
        """Close the log file with the exit code."""
        if self.file is not None:
            self.keep(f"ended with exit code {code} after {self.elapsed_seconds:.1f} s")
            self._close_file()

    def _close_file(self) -> None:
        log, self.file = self.file, None
        if log is not None:
            with suppress(OSError):  # of what could not be written, which has been said
                log.close()


def command_log() -> CommandLog:
    """Return the log of this run; outside of one, a new one."""
    return _COMMAND_LOG.get() or CommandLog()


@contextmanager
def begin_command_log() -> Iterator[CommandLog]:
    """Give a run its log, and close the log at the end."""
    token = _COMMAND_LOG.set(log := CommandLog())
    try:
        yield log
    except SystemExit as end:
        log.close(end.code or 0)
        raise
    finally:
        log.close("unknown")
        _COMMAND_LOG.reset(token)


def print_error(text: str) -> None:
    """Print an error or a warning on standard error."""
    click.echo(text, err=True)
    command_log().keep(text)


def print_path(screen: Screen, label: str, path: Path) -> None:
    """Print where a file was written."""
    screen.say(f"{label}: {path.resolve()}", no_wrap=True)


def say_line(screen: Screen, line: Line) -> None:
    """Print a line besides the results, in yellow where it is a warning."""
    from dynident.runtime import Severity

    screen.remark(line.text, "yellow" if line.severity is Severity.WARNING else None)


def console() -> Screen:
    """Return the console of standard output; wide enough for the tables where it is no terminal."""

    return Screen() if sys.stdout.isatty() else Screen(width=PIPE)


@contextmanager
def status() -> Iterator[None]:
    """Show the steps of the work within on standard error, with a bar and the time left where they are known.

    Where that is no terminal nothing is shown, except for each step with ``--verbose``.
    """
    log = command_log()
    if log.quiet or not sys.stderr.isatty():
        with progress_to(lambda step: _print_line(log.step(_escape_step(step)))):
            yield
        return
    from rich.progress import Progress, ProgressColumn, SpinnerColumn

    class Words(ProgressColumn):
        def render(self, task: Task) -> Text:
            return _task_text(task, screen.width - 3)

    screen = Screen(stderr=True)
    with Progress(SpinnerColumn(), Words(), console=screen, transient=True, refresh_per_second=5) as progress:
        task = progress.add_task("starting", total=None, first=0, at=0.0)

        def show_step(step: str) -> None:
            current_step, task_state = _escape_step(step), progress.tasks[0]
            task_state.total = current_step.total  # to ``update`` and ``reset``, None is no change
            if line := log.step(current_step):
                progress.console.print(line, soft_wrap=True, markup=False, highlight=False)
            # the description changes with each step: begin the bar anew
            if task_state.description != current_step.words:
                progress.reset(task, description=current_step.words, first=current_step.completed)
            progress.update(task, completed=current_step.completed, at=task_state.elapsed or 0.0)

        with progress_to(show_step):
            yield


def _escape_step(step: str) -> Step:
    parsed = Step.of(step)
    return Step(one_line(parsed.words), parsed.completed, parsed.total)


def _print_line(line: str) -> None:
    if line:
        click.echo(line, err=True)


def _task_text(task: Task, width: int) -> Text:
    """Return the current step in one line: its progress and the time left where they are known, else the time."""
    from rich.text import Text

    elapsed, completed, total = task.elapsed or 0.0, task.completed, task.total
    count = f"{completed:.0f} of {total:.0f}" if total else f"{completed:.0f}" if completed else ""
    if elapsed < BAR_DELAY:
        parts = [count]
    elif total and (completed_now := completed - task.fields["first"]):
        min_cells, max_cells = BAR_CELLS
        cells = min(max(width - 50, min_cells), max_cells)
        full = round(cells * min(completed / total, 1.0))
        # the time left follows from the steps since this run began, as earlier ones may have been known
        update_time = task.fields["at"]  # when so much was done
        seconds_left = max(update_time * (total - completed) / completed_now - (elapsed - update_time), 0.0)
        parts = [f"{'━' * full}{'╌' * (cells - full)} {count}", f"about {_format_time(seconds_left)} left"]
        if total >= MIN_STEPS_FOR_RATE and cells > min_cells and update_time > 0.0:
            parts.insert(1, _format_rate(completed_now / update_time))
    else:
        parts = [count, _format_time(elapsed)]
    tail = "".join(f"  {part}" for part in parts if part)
    room = max(width - len(tail), 10)
    return Text(shorten_names([task.description], room)[0] + tail, no_wrap=True, overflow="crop")


def _format_rate(rate: float) -> str:
    return f"{60.0 * rate:.2g}/min" if rate < 1.0 else f"{rate:.2g}/s" if rate < 100.0 else f"{rate:.0f}/s"


def _format_time(seconds: float) -> str:
    minutes, rest_seconds = divmod(round(seconds), 60)
    return f"{minutes} min {rest_seconds} s" if minutes else f"{rest_seconds} s"


class Screen(Console):
    """A console that shows every text as it is."""

    def __init__(self, **how: Any) -> None:
        super().__init__(markup=False, emoji=False, highlight=False, **how)

    def say(self, text: str, style: str | None = None, no_wrap: bool = False) -> None:
        """Print a result or what was written; ``no_wrap``: in one line, from which a path or command can be copied."""
        self.print_and_log(Text(one_line(text), style or ""), no_wrap)

    def remark(self, text: str, style: str | None = None, no_wrap: bool = False) -> None:
        """Print what is said besides the results: notes, warnings, next steps; not with ``--quiet``."""
        self.print_and_log(Text(one_line(text), style or ""), no_wrap, silent=command_log().quiet)

    def show(self, table: PageTable) -> None:
        """Print a table."""
        from dynident.report.terminal import terminal_table

        columns = tuple(
            replace(column, title=one_line(column.title), group=one_line(column.group)) for column in table.columns
        )
        rows = tuple(tuple(map(one_line, row)) for row in table.rows)
        self.print_and_log(terminal_table(replace(table, columns=columns, rows=rows, caption=one_line(table.caption))))

    def print_and_log(self, content: RenderableType, no_wrap: bool = False, silent: bool = False) -> None:
        """Print what rich can print, and keep it in the log; sentences are wrapped at words, only in a terminal."""
        if not silent:
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
