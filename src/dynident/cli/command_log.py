"""What a command says, on the terminal and in its log file: escaped, so that no name acts on a terminal."""

from __future__ import annotations

import platform
import re
import shutil
import sys
import time
import unicodedata
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import IO

import click

from dynident._version import __version__
from dynident.runtime import Step

REPEAT_INTERVAL = 30.0  # s after which it is said again how much of a step is done
LOG_HEAD = "# Log of dynident."  # the first words of every log file: no other file is appended to
PIPE = 150  # columns where standard output is no terminal

_COMMAND_LOG: ContextVar[CommandLog | None] = ContextVar("command_log", default=None)


def escape_controls(text: str) -> str:
    r"""Return a text with escapes for all that could act on a terminal, except line breaks.

    These are the control characters (ESC, BEL, backspace, C1), those that change the direction of writing or are
    invisible, and halves of surrogate pairs, by which Python represents the bytes of names that are no text.
    """
    if text.isprintable():
        return text
    is_shown = (x.isprintable() or x == "\n" or unicodedata.category(x) == "Zs" for x in text)
    return "".join(x if shown else x.encode("unicode_escape").decode() for x, shown in zip(text, is_shown, strict=True))


def one_line(text: str) -> str:
    r"""Return a message with controls escaped as by ``escape_controls``; only an indented line stands alone.

    Other line breaks, those of names, are escaped: no name can pass for a message.
    """
    return re.sub(r"\n(?!  )", r"\\n", escape_controls(text).rstrip("\n"))


def escape_step(step: str) -> Step:
    """Return a step whose words cannot act on a terminal."""
    parsed = Step.of(step)
    return Step(one_line(parsed.words), parsed.completed, parsed.total)


@dataclass
class CommandLog:
    """How much a command prints; ``file`` takes all of it, and ``began`` (s) is when the run began.

    ``last_words`` are those of the last step, and ``last_time`` (s) when it was printed, counted from the start;
    ``announcement`` is what the terminal shows until something else is printed.
    """

    verbose: bool = False
    quiet: bool = False
    path: Path | None = None
    file: IO[str] | None = None
    began: float = field(default_factory=time.monotonic)
    last_words: str = ""
    last_time: float = 0.0
    announcement: str = ""

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


def clear_announcement() -> str:
    """Take what a command has announced from the terminal, and return it; "" where there is nothing."""
    log = command_log()
    words, log.announcement = log.announcement, ""
    if words:
        click.echo(f"{' ' * (shutil.get_terminal_size().columns - 1)}\r", err=True, nl=False)
    return words


def print_error(text: str) -> None:
    """Print an error or a warning on standard error."""
    clear_announcement()
    click.echo(text, err=True)
    command_log().keep(text)
