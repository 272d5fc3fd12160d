"""Output of the commands: the console, and what is being done, on standard error and only in a terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dynident.cli.escapes import one_line
from dynident.cli.voice import voice
from dynident.errors import Step, shortened

if TYPE_CHECKING:
    from rich.progress import Task
    from rich.text import Text

    from dynident.cli.screen import Screen
    from dynident.report.wording import Line

__all__ = ["console", "say_line", "status", "tell"]

PIPE = 150  # columns where standard output is no terminal
SOON = 2.0  # s after which a bar and the time left are shown
MANY = 100  # steps, of which the rate is shown
CELLS = 5, 20  # of a bar, from narrow to wide terminals


def tell(screen: Screen, what: str, path: Path) -> None:
    """Print where a file was written."""
    screen.say(f"{what}: {path.resolve()}", whole=True)


def say_line(screen: Screen, line: Line) -> None:
    """Print a line besides the results, in yellow where it is a warning."""
    from dynident.errors import Severity

    screen.remark(line.text, "yellow" if line.severity is Severity.WARNING else None)


def console() -> Screen:
    """Return the console of standard output; wide enough for the tables where it is no terminal."""
    from dynident.cli.screen import Screen

    return Screen() if sys.stdout.isatty() else Screen(width=PIPE)


@contextmanager
def status() -> Iterator[Callable[[str], None]]:
    """Show on standard error what is being done, with a bar and the time left where they are known.

    Where that is no terminal nothing is shown, but each step by ``--verbose``.
    """
    own = voice()
    if own.quiet or not sys.stderr.isatty():
        yield lambda step: _print(own.step(_escaped(step)))
        return
    from rich.progress import Progress, ProgressColumn, SpinnerColumn

    from dynident.cli.screen import Screen

    class Words(ProgressColumn):
        def render(self, task: Task) -> Text:
            return _shown(task, screen.width - 3)

    screen = Screen(stderr=True)
    with Progress(SpinnerColumn(), Words(), console=screen, transient=True, refresh_per_second=5) as progress:
        task = progress.add_task("starting", total=None, first=0, at=0.0)

        def say(step: str) -> None:
            one, shown = _escaped(step), progress.tasks[0]
            shown.total = one.total  # to ``update`` and ``reset``, None is no change
            if line := own.step(one):
                progress.console.print(line, soft_wrap=True, markup=False, highlight=False)
            if shown.description != one.words:
                progress.reset(task, description=one.words, first=one.done)
            progress.update(task, completed=one.done, at=shown.elapsed or 0.0)

        yield say


def _escaped(step: str) -> Step:
    one = Step.of(step)
    return Step(one_line(one.words), one.done, one.total)


def _print(line: str) -> None:
    if line:
        click.echo(line, err=True)


def _shown(task: Task, width: int) -> Text:
    """Return what is being done, in one line: how much of it and the time left where they are known, else the time."""
    from rich.text import Text

    elapsed, done, total = task.elapsed or 0.0, task.completed, task.total
    count = f"{done:.0f} of {total:.0f}" if total else f"{done:.0f}" if done else ""
    if elapsed < SOON:
        parts = [count]
    elif total and (new := done - task.fields["first"]):
        least, most = CELLS
        cells = min(max(width - 50, least), most)
        full = round(cells * min(done / total, 1.0))
        at = task.fields["at"]  # when so much was done
        left = max(at * (total - done) / new - (elapsed - at), 0.0)
        parts = [f"{'━' * full}{'╌' * (cells - full)} {count}", f"about {_time(left)} left"]
        if total >= MANY and cells > least and at > 0.0:
            parts.insert(1, _rate(new / at))
    else:
        parts = [count, _time(elapsed)]
    tail = "".join(f"  {part}" for part in parts if part)
    room = max(width - len(tail), 10)
    return Text(shortened([task.description], room)[0] + tail, no_wrap=True, overflow="crop")


def _rate(rate: float) -> str:
    return f"{60.0 * rate:.2g}/min" if rate < 1.0 else f"{rate:.2g}/s" if rate < 100.0 else f"{rate:.0f}/s"


def _time(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"
