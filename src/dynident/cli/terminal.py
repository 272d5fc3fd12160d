"""Output of the commands: the console, a progress bar, a status line; the last two only in a terminal.

What files, columns and joints are called is shown as text: no character of a name acts on the terminal.
"""

from __future__ import annotations

import os
import re
import sys
import unicodedata
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dynident.io.opener import set_memory

if TYPE_CHECKING:
    from dynident.cli.screen import Screen
    from dynident.report.wording import Line

__all__ = [
    "ALLOW_CODE", "DIRECTORY", "FILE", "LOG", "MEMORY_OPTION", "bar", "console", "one_line", "say_line", "status",
    "tell", "visible",
]  # fmt: skip


class _Path(click.Path):
    """A path without ``..``: what is written into a/../b would make a, too."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if not str(value) or "\0" in str(value):
            self.fail(f"{str(value)!r} is no name of a file or folder.", param, ctx)
        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        return path.resolve() if ".." in path.parts else path


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


def visible(text: str) -> str:
    r"""Return a text with escapes, such as ``\x1b``, for all that could act on a terminal, except line breaks.

    These are the control characters (ESC, BEL, backspace, C1), those that turn the direction of writing or are not
    seen, and halves of surrogate pairs, by which Python holds the bytes of names that are no text.
    """
    if text.isprintable():
        return text
    return "".join(one if one == "\n" or _is_shown(one) else one.encode("unicode_escape").decode() for one in text)


def one_line(text: str) -> str:
    r"""Return a message as ``visible`` does; only a line that is indented stands alone.

    Other line breaks, those of names, become ``\n``: no name can pass for a message.
    """
    return re.sub(r"\n(?!  )", r"\\n", visible(text).rstrip("\n"))


def _is_shown(one: str) -> bool:
    return one.isprintable() or unicodedata.category(one) == "Zs"


def tell(screen: Screen, what: str, path: Path) -> None:
    """Print where a file was written."""
    screen.say(f"{what}: {path.resolve()}")


def say_line(screen: Screen, line: Line) -> None:
    """Print a line, in yellow where it is a warning."""
    from dynident.errors import Severity

    screen.say(line.text, "yellow" if line.severity is Severity.WARNING else None)


def console() -> Screen:
    """Return the console of standard output; wide enough for the tables where it is no terminal."""
    from dynident.cli.screen import Screen

    return Screen() if sys.stdout.isatty() else Screen(width=150)


@contextmanager
def bar(title: str) -> Iterator[Callable[[int, int], None]]:
    """Show a progress bar on standard error; silent where that is no terminal."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from dynident.cli.screen import Screen

    text = TextColumn("{task.description}", markup=False)
    columns = (text, BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=Screen(stderr=True), transient=True, disable=not sys.stderr.isatty()) as bar:
        task = bar.add_task(one_line(title), total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)


@contextmanager
def status() -> Iterator[Callable[[str], None]]:
    """Show what is being done on standard error; silent where that is no terminal."""
    from rich.text import Text

    from dynident.cli.screen import Screen

    if not sys.stderr.isatty():
        yield lambda _: None
        return
    with Screen(stderr=True).status("starting") as status:
        yield lambda step: status.update(Text(one_line(step)))
