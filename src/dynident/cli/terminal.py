"""Where commands print: the console, and the progress on standard error, only in a terminal."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dynident.cli.command_log import PIPE, clear_announcement, command_log, escape_step, one_line
from dynident.runtime import Severity, progress_to, shorten_names

if TYPE_CHECKING:
    from dynident.cli.screen import Screen
    from dynident.report.words import Line


def print_path(screen: Screen, label: str, path: Path) -> None:
    """Print where a file was written."""
    screen.say(f"{label}: {path.resolve()}", no_wrap=True)


def say_line(screen: Screen, line: Line, detail: bool = False) -> None:
    """Print a line besides the results, in yellow where it is a warning; a ``detail`` only with ``--verbose``."""
    screen.remark(line.text, "yellow" if line.severity is Severity.WARNING else None, detail=detail)


def print_files(screen: Screen, paths: Sequence[Path]) -> None:
    """Print the files that were written into one folder, in one line."""
    if paths:
        screen.say(f"Files in {paths[0].parent.resolve()}: {', '.join(path.name for path in paths)}", no_wrap=True)


def console() -> Screen:
    """Return the console of standard output; wide enough for the tables where it is no terminal."""
    from dynident.cli.screen import Screen

    return Screen() if sys.stdout.isatty() else Screen(width=PIPE)


def announce() -> None:
    """Say on a terminal what a command reads first, before packages are imported; the next output takes its place."""
    log, context = command_log(), click.get_current_context()
    arguments = [param for param in context.command.params if isinstance(param, click.Argument)]
    is_file = arguments and not isinstance(arguments[0].type, click.Choice)
    if log.quiet or not sys.stderr.isatty() or (arguments and not is_file):
        return
    value = context.params[str(arguments[0].name)] if arguments else None
    name = value[0] if isinstance(value, tuple) else value
    log.announcement = "starting" if name is None else one_line(f"reading {name}")
    width = shutil.get_terminal_size().columns - 1  # a line that is full would break
    click.echo(f"{shorten_names([log.announcement], width)[0]}\r", err=True, nl=False)


@contextmanager
def status() -> Iterator[None]:
    """Show the steps of the work within on standard error, with the time left where it is known.

    Where that is no terminal nothing is shown, except for each step with ``--verbose``.
    """
    log = command_log()
    if log.quiet or not sys.stderr.isatty():
        with progress_to(lambda step: _print_line(log.step(escape_step(step)))):
            yield
        return
    from dynident.cli.screen import progress_bar

    with progress_bar(clear_announcement() or "starting"):
        yield


def _print_line(line: str) -> None:
    if line:
        click.echo(line, err=True)
