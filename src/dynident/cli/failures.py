"""The end of a command that fails: one message and an exit code in every case; the traceback on request."""

from __future__ import annotations

import errno
import io
import os
import platform
import shlex
import shutil
import signal
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import wraps
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn

import click

from dynident._version import __version__
from dynident.cli.command_log import (
    begin_command_log,
    clear_announcement,
    command_log,
    escape_controls,
    one_line,
    print_error,
)
from dynident.cli.terminal import announce
from dynident.files.opener import watch_inputs
from dynident.runtime import DynidentError

SIGNALS = [number for name in ("SIGTERM", "SIGHUP") if (number := getattr(signal, name, None)) is not None]
COMMAND = "DYNIDENT_COMMAND"  # the environment variable with what the user typed in place of ``dynident``

UNEXPECTED_EXIT_CODE = 70  # EX_SOFTWARE of sysexits.h
FULL_DISK_ERRORS = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
INTERRUPTED_EXIT_CODE = 130  # 128 + SIGINT, as shells have it
MIN_ADDRESS_SPACE = 2_000_000_000  # bytes of address space; a small project takes 1.2 GB
PROGRAM = "dynident"


class StopSignal(KeyboardInterrupt):
    """A signal other than that of Ctrl-C, which ends a command in the same way: open files are closed first."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number


@contextmanager
def interruptible() -> Iterator[None]:
    """Turn signals to stop, and Ctrl-C, into one line and an exit code."""
    previous_handlers = {}
    try:
        for number in SIGNALS if threading.current_thread() is threading.main_thread() else ():
            if signal.getsignal(number) is signal.SIG_DFL:  # nohup, or a caller, may have other wishes
                previous_handlers[number] = signal.signal(number, _raise_stop)
        yield
    except KeyboardInterrupt as stop:
        notes = getattr(stop, "__notes__", ["each file is as it was or complete; run the same command again."])
        print_error(one_line(f"Interrupted: {' '.join(notes)}"))
        # interrupted within ``exec``, as when a dataclass is made, ``python -m`` would end by the signal itself
        exec("")  # noqa: S102 -- CPython forgets the interrupt
        raise SystemExit(128 + getattr(stop, "number", signal.SIGINT)) from None
    finally:
        for number, handler in previous_handlers.items():
            signal.signal(number, handler)


def _raise_stop(number: int, frame: FrameType | None) -> NoReturn:  # noqa: ARG001 -- so are handlers called
    raise StopSignal(number)


def launcher() -> str:
    """Return the words with which the user started dynident."""
    if typed := os.environ.get(COMMAND):
        return typed
    started = Path(sys.argv[0] if sys.argv else "")
    if started.name == "__main__.py" and started.parent.name == "dynident":
        return f"{_program_name(sys.executable)} -m dynident"
    return _program_name(str(started)) if started.stem == "dynident" else "dynident"


def command(*words: object) -> str:
    """Return a command to paste: the launcher and words, quoted for the shell.

    A ``Path`` is never taken for an option.

    >>> command("check", "my robot.yaml").removeprefix(launcher())
    " check 'my robot.yaml'"
    """
    is_option_like = (isinstance(word, Path) and str(word).startswith("-") for word in words)
    texts = [f".{os.sep}{word}" if alike else str(word) for word, alike in zip(words, is_option_like, strict=True)]
    return f"{launcher()} {_quote_words(texts)}"


def _program_name(path: str) -> str:
    """Return the name of a program if the shell finds it by that name, else its path."""
    name = Path(path).name if os.name != "nt" else Path(path).stem
    resolved = shutil.which(name)
    folders = {os.path.realpath(os.path.dirname(file)) for file in (resolved or "", path)}
    return name if resolved is not None and len(folders) == 1 else _quote_words([path])


def _quote_words(words: list[str]) -> str:
    return subprocess.list2cmdline(words) if os.name == "nt" else shlex.join(words)


PACKAGE = str(Path(__file__).parents[1])


class UnexpectedError(click.ClickException):
    """The message for an unexpected error."""

    exit_code = UNEXPECTED_EXIT_CODE


class Commands(click.Group):
    """Commands that end with one message: exit code 1 for what the user can correct, 70 for a fault of dynident."""

    def main(self, args: Sequence[str] | None = None, **how: Any) -> Any:  # type: ignore[override]  # its overloads
        """Run, and end the process, as ``click.Command.main``; names in messages are shown as text."""
        with begin_command_log():
            if not how.pop("standalone_mode", True):
                return super().main(args, standalone_mode=False, **how)
            return self._run_standalone(args, **how)

    def _run_standalone(self, args: Sequence[str] | None, **how: Any) -> NoReturn:
        """Run, and end the process."""
        # streams may be closed, or lack characters: no output may fail before the command has run
        for stream in (sys.stdin, sys.stdout, sys.stderr):
            if stream is None:  # no file that is opened may get its number
                os.open(os.devnull, os.O_RDWR)
        for name in ("stdout", "stderr"):
            if getattr(sys, name) is None:  # closed by who started us
                setattr(sys, name, io.StringIO())
            if isinstance(stream := getattr(sys, name), io.TextIOWrapper):  # not every encoding has every name
                stream.reconfigure(errors="backslashreplace")
        try:
            completed = f"_{PROGRAM.upper()}_COMPLETE"  # a shell's completion uses its own name
            names = {"prog_name": PROGRAM if completed in os.environ else launcher(), "complete_var": completed}
            code: object = super().main(args, **(names | how), standalone_mode=False)
        except click.ClickException as error:
            _show_error(error)
            sys.exit(error.exit_code)
        except click.Abort:
            print_error("Interrupted.")
            sys.exit(INTERRUPTED_EXIT_CODE)
        except OSError as error:  # of --help; all else is in ``invoke``
            click_error = _as_click_error(error)
            _show_error(click_error)
            sys.exit(click_error.exit_code)
        sys.exit(code if isinstance(code, int) else 0)

    def add_command(self, cmd: click.Command, name: str | None = None) -> None:
        """Add a command, whose work requires address space: its help, the version and completion need little."""
        if cmd.callback is not None:
            cmd.callback = _with_address_space(cmd.callback)
        super().add_command(cmd, name)

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the arguments before the command; without any, print the help."""
        if not args and not ctx.resilient_parsing:
            click.echo(ctx.get_help(), err=True)
            ctx.exit(2)
        return super().parse_args(ctx, args)

    def invoke(self, ctx: click.Context) -> Any:
        """Run the command; what it raises becomes an exception that ``main`` shows."""
        with interruptible(), watch_inputs():
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
                print_error(escape_controls("".join(traceback.format_exception(error))))
            raise _as_click_error(error) from error


def _with_address_space(work: Callable[..., Any]) -> Callable[..., Any]:
    @wraps(work)
    def run(*args: Any, **kwargs: Any) -> Any:
        announce()
        from dynident.runtime.kernel import kernel  # what it loads, the help does not need

        _require_address_space()
        command_log().keep(f"kernel: {kernel()}")  # and a wrong DYNIDENT_KERNEL is said before long work
        return work(*args, **kwargs)

    return run


def _require_address_space() -> None:
    """Reject an address space (``ulimit -v``) in which OpenBLAS would try for ever to get its buffers."""
    try:
        import resource
    except ImportError:  # Windows has no such limit
        return
    kind = getattr(resource, "RLIMIT_AS", None)
    if kind is None:  # nor does OpenBSD
        return
    limit, _ = resource.getrlimit(kind)
    if limit != resource.RLIM_INFINITY and limit < MIN_ADDRESS_SPACE:
        raise click.ClickException(
            f"the address space is limited to {limit / 1e9:.2g} GB (`ulimit -v`); dynident and its libraries need "
            f"{MIN_ADDRESS_SPACE / 1e9:.2g} GB of it. Raise the limit, or bound the reading of files by --memory "
            "instead."
        )


def _as_click_error(error: BaseException) -> click.ClickException:
    """Return the click exception, with message and exit code, for an error of a command."""
    if isinstance(error, DynidentError):
        return click.ClickException(str(error))
    if isinstance(error, OSError) and error.errno in FULL_DISK_ERRORS:  # files that are written say so by themselves
        _close_output()
        return click.ClickException(f"the output cannot be written: {error.strerror}.")
    if isinstance(error, MemoryError):
        reason = f" ({error})" if str(error) else ""
        return click.ClickException(
            f"there is not enough memory{reason}; use a shorter `window`, fewer recordings, or `filter: decimate`."
        )
    return UnexpectedError(_unexpected_message(error))


def _unexpected_message(error: BaseException) -> str:
    """Return the message for an unexpected error, in one line."""
    description = " ".join(f"{type(error).__name__}: {error}".split())[:300].rstrip(": ")
    command = " ".join(["dynident", *map(repr, sys.argv[1:])])
    return (
        f"dynident failed with {description}{_error_location(error)}. This is a fault of dynident, not of your input. "
        f"Please report this line with the input, and what `dynident --debug ...` prints: dynident {__version__}, "
        f"Python {platform.python_version()}, {platform.system()} {platform.machine()}; {command}"
    )


def _error_location(error: BaseException) -> str:
    """Return the last line of dynident that the error passed through."""
    frames = [frame for frame in traceback.extract_tb(error.__traceback__) if frame.filename.startswith(PACKAGE)]
    return f" at {os.path.relpath(frames[-1].filename, PACKAGE)}:{frames[-1].lineno}" if frames else ""


def _show_error(error: click.ClickException) -> None:
    """Print the message of an error, with the usage where an option or argument is wrong."""
    clear_announcement()
    text = one_line(error.format_message())
    if isinstance(error, click.UsageError):
        click.UsageError(text, error.ctx).show()
        command_log().keep(f"Error: {text}")
    else:
        print_error(f"Error: {text}")


def _close_output() -> None:
    """Redirect the remaining output to nowhere; otherwise Python would fail when it ends."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    with suppress(OSError, ValueError):  # a stream without a file
        os.dup2(nowhere, sys.stdout.fileno())
