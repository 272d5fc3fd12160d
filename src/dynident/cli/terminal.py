"""Output of the commands: the console, a progress bar, a status line; the last two only in a terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dynident.io.opener import set_memory

if TYPE_CHECKING:
    from rich.console import Console

    from dynident.report.wording import Line

__all__ = ["ALLOW_CODE", "DIRECTORY", "FILE", "LOG", "MEMORY_OPTION", "bar", "console", "say_line", "status", "tell"]


class _Path(click.Path):
    """A path, which click would ask the system for before it is known to be one."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if "\0" in str(value):
            self.fail(f"{str(value)!r} is no name of a file.", param, ctx)
        return super().convert(value, param, ctx)


DIRECTORY = _Path(file_okay=False, path_type=Path)
FILE = _Path(dir_okay=False, path_type=Path)
LOG = _Path(path_type=Path)  # a ROS 2 bag is a folder
ALLOW_CODE = click.option(
    "--allow-code", is_flag=True, help="Run the Python files that RESULT names; only if you trust them."
)


def _set_memory(ctx: click.Context, option: click.Parameter, value: float | None) -> None:  # noqa: ARG001
    set_memory(value)


MEMORY_OPTION = click.option(
    "--memory", type=click.FloatRange(0, min_open=True), metavar="GB", expose_value=False, callback=_set_memory,
    help="Most memory that reading one file may take (GB); else DYNIDENT_MEMORY, else 4.",
)  # fmt: skip


def tell(console: Console, what: str, path: Path) -> None:
    """Print where a file was written."""
    console.print(f"{what}: {path.resolve()}", soft_wrap=True, highlight=False, markup=False)


def say_line(screen: Console, line: Line) -> None:
    """Print a line, in yellow where it is a warning."""
    from dynident.errors import Severity

    style = "yellow" if line.severity is Severity.WARNING else None
    screen.print(line.text, style=style, soft_wrap=True, highlight=False, markup=False)


def console() -> Console:
    """Return the console of standard output; wide enough for the tables where it is no terminal."""
    from rich.console import Console

    return Console() if sys.stdout.isatty() else Console(width=150)


@contextmanager
def bar(title: str) -> Iterator[Callable[[int, int], None]]:
    """Show a progress bar on standard error; silent where that is no terminal."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True, disable=not sys.stderr.isatty()) as bar:
        task = bar.add_task(title, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


@contextmanager
def status() -> Iterator[Callable[[str], None]]:
    """Show what is being done on standard error; silent where that is no terminal."""
    from rich.console import Console

    if not sys.stderr.isatty():
        yield lambda _: None
        return
    with Console(stderr=True).status("starting") as status:
        yield lambda step: status.update(step)
