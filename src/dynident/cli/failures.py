"""The end of a command that fails: one message and an exit code, whatever went wrong; the traceback on request."""

from __future__ import annotations

import errno
import io
import os
import platform
import sys
import traceback
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import wraps
from pathlib import Path
from typing import Any, NoReturn

import click

from dynident import __version__
from dynident.cli.escapes import one_line, visible
from dynident.cli.interrupt import interruptible
from dynident.cli.launcher import launcher
from dynident.cli.voice import complain, speaking, voice
from dynident.errors import DynidentError
from dynident.io.opener import watched

__all__ = ["FAULT", "Commands"]

FAULT = 70  # EX_SOFTWARE of sysexits.h
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
INTERRUPTED = 130  # 128 + SIGINT, as shells have it
LEAST_ROOM = 2_000_000_000  # bytes of address space; a small project takes 1.2 GB
PROGRAM = "dynident"
PACKAGE = str(Path(__file__).parents[1])


class Fault(click.ClickException):
    """The message for an error that nobody foresaw."""

    exit_code = FAULT


class Commands(click.Group):
    """Commands that end with one message: exit code 1 for what the user can correct, 70 for a fault of dynident."""

    def main(self, args: Sequence[str] | None = None, **how: Any) -> Any:  # type: ignore[override]  # its overloads
        """Run, and end the process, as ``click.Command.main``; names in messages are shown as text."""
        with speaking():
            if not how.pop("standalone_mode", True):
                return super().main(args, standalone_mode=False, **how)
            return self._alone(args, **how)

    def _alone(self, args: Sequence[str] | None, **how: Any) -> NoReturn:
        """Run, and end the process."""
        for name in ("stdout", "stderr"):
            if getattr(sys, name) is None:  # closed by who started us
                setattr(sys, name, io.StringIO())
            if isinstance(stream := getattr(sys, name), io.TextIOWrapper):  # not every encoding has every name
                stream.reconfigure(errors="backslashreplace")
        try:
            code: object = super().main(args, **(_named() | how), standalone_mode=False)
        except click.ClickException as error:
            _show(error)
            sys.exit(error.exit_code)
        except click.Abort:
            complain("Interrupted.")
            sys.exit(INTERRUPTED)
        except OSError as error:  # of --help; all else is in ``invoke``
            ended = _ended(error)
            _show(ended)
            sys.exit(ended.exit_code)
        sys.exit(code if isinstance(code, int) else 0)

    def add_command(self, cmd: click.Command, name: str | None = None) -> None:
        """Add a command, whose work asks for room: its help, the version and completion need little."""
        if cmd.callback is not None:
            cmd.callback = _in_room(cmd.callback)
        super().add_command(cmd, name)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse what stands before the command; without any word, print the help."""
        if not args and not ctx.resilient_parsing:
            click.echo(ctx.get_help(), err=True)
            ctx.exit(2)
        return super().parse_args(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; what it raises becomes an exception that ``main`` shows."""
        with interruptible(), watched():
            return self._invoke(ctx)

    def _invoke(self, ctx: click.Context) -> Any:
        try:
            return super().invoke(ctx)
        except (click.ClickException, click.exceptions.Exit, click.Abort, KeyboardInterrupt, SystemExit):
            raise
        except BrokenPipeError:  # the reader has seen enough
            _close_output()
            sys.exit(1)
        except BaseException as error:  # such as a panic of a library written in Rust
            if ctx.params.get("debug"):
                complain(visible("".join(traceback.format_exception(error))))
            raise _ended(error) from error


def _in_room(work: Callable[..., Any]) -> Callable[..., Any]:
    @wraps(work)
    def run(*given: Any, **named: Any) -> Any:
        from dynident.kernel import kernel  # what it loads, the help does not need

        _require_room()
        voice().keep(f"kernel: {kernel()}")  # and a wrong DYNIDENT_KERNEL is said before long work
        return work(*given, **named)

    return run


def _named() -> dict[str, str]:
    """Return how messages call the program; a shell's completion knows it by its own name."""
    completed = f"_{PROGRAM.upper()}_COMPLETE"
    return {"prog_name": PROGRAM if completed in os.environ else launcher(), "complete_var": completed}


def _require_room() -> None:
    """Refuse an address space (``ulimit -v``) in which OpenBLAS would try for ever to get its buffers."""
    try:
        import resource
    except ImportError:  # Windows has no such limit
        return
    kind = getattr(resource, "RLIMIT_AS", None)
    if kind is None:  # nor does OpenBSD
        return
    limit, _ = resource.getrlimit(kind)
    if limit != resource.RLIM_INFINITY and limit < LEAST_ROOM:
        raise click.ClickException(
            f"the address space is limited to {limit / 1e9:.2g} GB (`ulimit -v`); dynident and its libraries need "
            f"{LEAST_ROOM / 1e9:.2g} GB of it. Raise the limit, or bound the reading of files by --memory instead."
        )


def _ended(error: BaseException) -> click.ClickException:
    """Return the message and exit code for an error of a command."""
    if isinstance(error, DynidentError):
        return click.ClickException(str(error))
    if isinstance(error, OSError) and error.errno in FULL:  # files that are written say so by themselves
        _close_output()
        return click.ClickException(f"the output cannot be written: {error.strerror}.")
    if isinstance(error, MemoryError):
        reason = f" ({error})" if str(error) else ""
        return click.ClickException(
            f"there is not enough memory{reason}; use a shorter `window`, fewer recordings, or `filter: decimate`."
        )
    return Fault(_fault(error))


def _fault(error: BaseException) -> str:
    """Return the message for an error that nobody foresaw, in one line."""
    what = " ".join(f"{type(error).__name__}: {error}".split())[:300].rstrip(": ")
    command = " ".join(["dynident", *map(repr, sys.argv[1:])])
    return (
        f"dynident failed with {what}{_place(error)}. This is a fault of dynident, not of your input. Please report "
        f"this line with the input, and what `dynident --debug ...` prints: dynident {__version__}, "
        f"Python {platform.python_version()}, {platform.system()} {platform.machine()}; {command}"
    )


def _place(error: BaseException) -> str:
    """Return the last line of dynident that the error went through."""
    frames = [one for one in traceback.extract_tb(error.__traceback__) if one.filename.startswith(PACKAGE)]
    return f" at {os.path.relpath(frames[-1].filename, PACKAGE)}:{frames[-1].lineno}" if frames else ""


def _show(error: click.ClickException) -> None:
    """Print the message of an error, with the usage where an option or argument is wrong."""
    text = one_line(error.format_message())
    if isinstance(error, click.UsageError):
        click.UsageError(text, error.ctx).show()
        voice().keep(f"Error: {text}")
    else:
        complain(f"Error: {text}")


def _close_output() -> None:
    """Send what is still to be printed to nowhere; Python would fail when it ends."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    with suppress(OSError, ValueError):  # a stream without a file
        os.dup2(nowhere, sys.stdout.fileno())
