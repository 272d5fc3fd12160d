"""What a command says, how much of it, and the log file in which all of it is kept.

A voice belongs to one run of the command: ``-v``, ``--quiet`` and ``--log-file`` set it, before or after its name.
"""

from __future__ import annotations

import platform
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import IO

import click

from dynident import __version__
from dynident.cli.escapes import one_line, visible
from dynident.errors import Step

__all__ = ["LOG_HEAD", "Voice", "complain", "speaking", "voice"]

EVERY = 30.0  # s after which it is said again how much of a step is done
LOG_HEAD = "# Log of dynident."  # the first words of every log file: no other file is appended to


@dataclass
class Voice:
    """How much a command says; ``log`` takes all of it, and ``began`` (s) is when the run did.

    ``last`` are the words of the last step, and ``said`` (s) when that was said, counted from the begin.
    """

    verbose: bool = False
    quiet: bool = False
    path: Path | None = None
    log: IO[str] | None = None
    began: float = field(default_factory=time.monotonic)
    last: str = ""
    said: float = 0.0

    @property
    def elapsed(self) -> float:
        """Seconds since the command began."""
        return time.monotonic() - self.began

    def keep(self, text: str) -> None:
        """Write a text to the log, each line with the time; where that fails, as on a full disk, say so and go on."""
        if self.log is None:
            return
        now = datetime.now().astimezone().isoformat(sep=" ", timespec="milliseconds")
        try:
            self.log.writelines(f"{now}  {line.rstrip()}\n" for line in visible(text).splitlines() or [""])
        except OSError as error:
            self._shut()
            name = one_line(str(self.path))
            click.echo(f"Warning: {name}: the log ends here, it cannot be written: {error.strerror}.", err=True)

    def step(self, step: Step) -> str:
        """Write a step that is new, or each half minute how much of it is done, to the log; return the line to print
        of it, if any."""
        known, now = step.words == self.last, self.elapsed
        if known and (now - self.said < EVERY or step == step.words):
            return ""
        self.last, self.said, text = step.words, now, str(step) if known else step.words
        self.keep(text)
        return f"{now:7.1f} s  {text}" if self.verbose else ""

    def open(self) -> None:
        """Begin the log, if one is wanted; InputError where its file is another's, or cannot be written."""
        if self.path is None or self.log is not None:
            return
        from dynident.io.results import append_log

        self.log = append_log(self.path, LOG_HEAD)
        self.keep(f"dynident {__version__}, Python {platform.python_version()}, {platform.platform()}")
        self.keep(f"in {Path.cwd()}: {' '.join(map(repr, sys.argv))}")

    def close(self, code: object) -> None:
        """End the log with the exit code."""
        if self.log is not None:
            self.keep(f"ended with exit code {code} after {self.elapsed:.1f} s")
            self._shut()

    def _shut(self) -> None:
        log, self.log = self.log, None
        if log is not None:
            with suppress(OSError):  # of what could not be written, which has been said
                log.close()


_VOICE: ContextVar[Voice | None] = ContextVar("voice", default=None)


def voice() -> Voice:
    """Return the voice of this run; outside of one, a new one."""
    return _VOICE.get() or Voice()


@contextmanager
def speaking() -> Iterator[Voice]:
    """Give a run its voice, and end its log."""
    token = _VOICE.set(own := Voice())
    try:
        yield own
    except SystemExit as end:
        own.close(end.code or 0)
        raise
    finally:
        own.close("unknown")
        _VOICE.reset(token)


def complain(text: str) -> None:
    """Print an error or a warning on standard error."""
    click.echo(text, err=True)
    voice().keep(text)
