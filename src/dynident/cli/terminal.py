"""Where commands print: the console, and the progress on standard error, only in a terminal."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dynident.cli.command_log import PIPE, command_log, escape_step
from dynident.runtime import Severity, progress_to

if TYPE_CHECKING:
    from dynident.cli.screen import Screen
    from dynident.report.words import Line


def print_path(screen: Screen, label: str, path: Path) -> None:
    """Print where a file was written."""
    screen.say(f"{label}: {path.resolve()}", no_wrap=True)


def print_paths(screen: Screen, labels: Iterable[str], paths: Iterable[Path]) -> None:
    """Print where files were written, each with its label; nothing where none was."""
    for label, path in zip(labels, paths, strict=False):
        print_path(screen, label, path)


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
    """Say on a terminal that a command starts, before it imports what takes longer; the first step overwrites it."""
    if sys.stderr.isatty() and not command_log().quiet:
        click.echo("starting\r", err=True, nl=False)


@contextmanager
def status() -> Iterator[None]:
    """Show the steps of the work within on standard error, with a bar and the time left where they are known.

    Where that is no terminal nothing is shown, except for each step with ``--verbose``.
    """
    log = command_log()
    if log.quiet or not sys.stderr.isatty():
        with progress_to(lambda step: _print_line(log.step(escape_step(step)))):
            yield
        return
    from dynident.cli.screen import progress_bar

    with progress_bar():
        yield


def _print_line(line: str) -> None:
    if line:
        click.echo(line, err=True)
