"""Arguments and options that commands share; a shell completes files by their kind."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click
from click.shell_completion import CompletionItem

from dynident.cli.voice import voice
from dynident.io.opener import keep, set_memory

__all__ = [
    "ALLOW_CODE",
    "CONFIG",
    "DESIGNED",
    "DIRECTORY",
    "FILE",
    "LOG",
    "LOGS",
    "RESULT",
    "ROBOT",
    "ROBOTS",
    "Range",
    "common",
    "noise_given",
]

CONFIGS = (".yaml", ".yml")
ROBOTS = (".urdf", ".xml", ".mjcf", ".xacro")
LOGS = (
    ".csv", ".txt", ".tsv", ".dat", ".log", ".parquet", ".npz", ".npy", ".mat", ".h5", ".hdf5", ".bag", ".db3", ".mcap",
)  # fmt: skip
Decorated = TypeVar("Decorated", bound=Callable[..., Any] | click.Command)


class _Path(click.Path):
    """A path without ``..``: what is written into a/../b would make a, too. ``kinds`` are the suffixes to complete."""

    def __init__(self, kinds: tuple[str, ...] = (), **how: Any) -> None:
        super().__init__(path_type=Path, **how)
        self.kinds = kinds

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if not str(value) or "\0" in str(value):
            self.fail(f"{str(value)!r} is no name of a file or folder.", param, ctx)
        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        return path.resolve() if ".." in path.parts else path

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        return complete(incomplete, self.kinds) or super().shell_complete(ctx, param, incomplete)


class Range(click.FloatRange):
    """A range of numbers, in which "nan" is not: it is neither below nor above any limit."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the number; a click.BadParameter, as for one out of the range, where it is not finite."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value!r} is no finite number.", param, ctx)
        return number


class _Name(click.ParamType):  # type: ignore[type-arg,unused-ignore]  # generic in newer versions
    """A text that usually names a file, such as a log or several joined by a plus sign."""

    name = "text"

    def __init__(self, kinds: tuple[str, ...]) -> None:
        self.kinds = kinds

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:  # noqa: ARG002
        return str(value)

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:  # noqa: ARG002
        return complete(incomplete, self.kinds) or [CompletionItem(incomplete, type="file")]


def complete(incomplete: str, kinds: tuple[str, ...]) -> list[CompletionItem]:
    """Return the files of these kinds whose name begins so, and folders; nothing where the shell should list all."""
    folder, start = os.path.split(incomplete)
    try:
        inside = sorted(os.scandir(os.path.expanduser(folder) or "."), key=lambda one: one.name)
    except OSError:
        return []
    inside = [one for one in inside if one.name.startswith(start) and (start or not one.name.startswith("."))]
    files = [one.name for one in inside if one.is_file() and one.name.lower().endswith(kinds)] if kinds else []
    folders = [f"{one.name}/" for one in inside if one.is_dir()] if files else []
    if not files:  # the shell completes folders better: it adds no space
        return [CompletionItem(incomplete, type="dir")] if kinds and any(one.is_dir() for one in inside) else []
    return [CompletionItem(os.path.join(folder, name)) for name in (*files, *folders)]


DIRECTORY = _Path(file_okay=False)
FILE = _Path(dir_okay=False)
LOG = _Path(LOGS)  # a ROS 2 bag is a folder
CONFIG = _Path(CONFIGS, dir_okay=False)
CHECKED = _Path((*CONFIGS, *ROBOTS), dir_okay=False)
DESIGNED = _Path((*CONFIGS, *ROBOTS, ".json"), dir_okay=False)
RESULT = _Path((".json",), dir_okay=False)
ROBOT, LOG_NAME = _Name(ROBOTS), _Name(LOGS)
ALLOW_CODE = click.option(
    "--allow-code", is_flag=True, help="Run the Python files that RESULT names; only if you trust them."
)


def _set_memory(ctx: click.Context, option: click.Parameter, value: float | None) -> None:  # noqa: ARG001
    set_memory(value)


_MEMORY = click.option(
    "--memory", type=Range(0, min_open=True), metavar="GB", expose_value=False, callback=_set_memory,
    help="Most memory that reading one file may take (GB); else DYNIDENT_MEMORY, else 4.",
)  # fmt: skip


def _set_verbose(ctx: click.Context, option: click.Parameter, value: bool) -> None:  # noqa: ARG001
    voice().verbose |= value


def _set_quiet(ctx: click.Context, option: click.Parameter, value: bool) -> None:  # noqa: ARG001
    voice().quiet |= value


def _set_log(ctx: click.Context, option: click.Parameter, value: Path | None) -> None:  # noqa: ARG001
    voice().path = value or voice().path


def _open_log(ctx: click.Context, option: click.Parameter, value: Path | None) -> None:
    _set_log(ctx, option, value)
    if not ctx.resilient_parsing and (path := voice().path):
        voice().open()
        keep(path)


_VERBOSE = click.option(
    "-v", "--verbose", is_flag=True, expose_value=False, callback=_set_verbose,
    help="Print each step with the time since the start, on standard error.",
)  # fmt: skip
_QUIET = click.option(
    "-q", "--quiet", is_flag=True, expose_value=False, callback=_set_quiet,
    help="Print only results, what was written, and errors: no notes, warnings, next steps or progress.",
)  # fmt: skip
_LOG_HELP = "File to which all that is said is added, with the time, the version and the command line."


def said(group: Decorated) -> Decorated:
    """Add the options on what is said to the group, where they stand before a command's name."""
    log = click.option("--log-file", type=FILE, expose_value=False, callback=_set_log, help=_LOG_HELP)
    return _VERBOSE(_QUIET(log(group)))


def common(command: Decorated) -> Decorated:
    """Add the options that every command has."""
    log = click.option("--log-file", type=FILE, expose_value=False, callback=_open_log, help=_LOG_HELP)
    return log(_QUIET(_VERBOSE(_MEMORY(command))))


def noise_given(option: str, words: tuple[str, ...]) -> dict[str, float] | float | None:
    """Return the value of an option: one number, numbers by joint, or None."""
    from dynident.errors import ConfigError

    by_joint: dict[str, float] = {}
    for word in words:
        joint, _, text = word.rpartition("=")
        try:
            by_joint[joint] = float(text)
        except ValueError as error:
            raise ConfigError(f"{option} {word}: give a number in SI units, or joint=number.") from error
    if "" not in by_joint:
        return by_joint or None
    if len(words) > 1:
        raise ConfigError(f"{option} is given {len(words)} times; give one number for all, or one joint=number each.")
    return by_joint[""]
