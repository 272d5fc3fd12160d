"""Arguments and options that commands share; a shell completes files by their kind."""

from __future__ import annotations

import math
import os
import platform
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click
from click.shell_completion import CompletionItem

from dynident._version import __version__, package_version
from dynident.cli.command_log import command_log
from dynident.files.opener import remember_inputs, set_memory
from dynident.runtime.kernel import kernel

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from dynident.runtime.jobs import Limits

Decorated = TypeVar("Decorated", bound=Callable[..., Any] | click.Command)
ALLOW_CODE = click.option(
    "--allow-code", is_flag=True, help="Run the Python files that RESULT names. Use this only if you trust them."
)

_LOG_HELP = "File to which all output is appended, with the time, the version and the command line."

PACKAGES = ("numpy", "scipy", "polars", "click")


class _FilePath(click.Path):
    """A path without ``..``, as what is written into a/../b would create a, too."""

    def __init__(self, **how: Any) -> None:
        super().__init__(path_type=Path, **how)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if not str(value) or "\0" in str(value):
            self.fail(f"{str(value)!r} is no name of a file or folder.", param, ctx)
        path = Path(os.fsdecode(super().convert(value, param, ctx)))
        return path.resolve() if ".." in path.parts else path


class FiniteRange(click.FloatRange):
    """A range of finite numbers; "nan" would be neither below nor above any limit."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the number; raises click.BadParameter, as for one out of the range, where it is not finite."""
        number = super().convert(value, param, ctx)
        if not math.isfinite(number):
            self.fail(f"{value!r} is no finite number.", param, ctx)
        return number


class _FileNameText(click.ParamType):  # type: ignore[type-arg,unused-ignore]  # generic in newer versions
    """A text that usually names a file, such as a log or several joined by a plus sign."""

    name = "text"

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:  # noqa: ARG002
        return [CompletionItem(incomplete, type="file")]


DIRECTORY, FILE = _FilePath(file_okay=False), _FilePath(dir_okay=False)
LOG = _FilePath()  # a ROS 2 bag is a folder
LOG_NAME = _FileNameText()
JSON_FILE = click.option("--json", "json_file", type=FILE, help="JSON file for all numbers.")


_MEMORY = click.option(
    "--memory", type=FiniteRange(0, min_open=True), metavar="GB", expose_value=False,
    callback=lambda *call: set_memory(call[-1]),
    help="Memory limit for reading one file (GB). [default: DYNIDENT_MEMORY, or 4]",
)  # fmt: skip


def _keep_option(ctx: click.Context, option: click.Parameter, value: Any) -> None:  # noqa: ARG001
    """Set the field of the log that is named as the option; it may be given before the command, and after it."""
    name = str(option.name)
    setattr(command_log(), name, value or getattr(command_log(), name))


def _open_log(ctx: click.Context, option: click.Parameter, value: Path | None) -> None:
    _keep_option(ctx, option, value)
    if not ctx.resilient_parsing and (path := command_log().path):
        command_log().open()
        remember_inputs(path)


_VERBOSE = click.option(
    "-v", "--verbose", is_flag=True, expose_value=False, callback=_keep_option,
    help="Print all tables and notes, and each step with its time (on standard error).",
)  # fmt: skip
_QUIET = click.option(
    "-q", "--quiet", is_flag=True, expose_value=False, callback=_keep_option,
    help="Print only results, written files and errors: no notes, warnings, next steps or progress.",
)  # fmt: skip


def add_output_options(group: Decorated) -> Decorated:
    """Add the options on output to the group, where they come before the name of a command."""
    log = click.option("--log-file", "path", type=FILE, expose_value=False, callback=_keep_option, help=_LOG_HELP)
    return _VERBOSE(_QUIET(log(group)))


def add_common_options(command: Decorated) -> Decorated:
    """Add the options that every command has."""
    log = click.option("--log-file", "path", type=FILE, expose_value=False, callback=_open_log, help=_LOG_HELP)
    return log(_QUIET(_VERBOSE(_MEMORY(command))))


def parse_noise(option: str, words: tuple[str, ...]) -> dict[str, float] | float | None:
    """Return the value of an option: one number, numbers by joint, or None."""
    from dynident.runtime import ConfigError

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


POSITIVE = FiniteRange(0, min_open=True)


@dataclass(frozen=True)
class WorkerOptions:
    """Where the work of a command runs, and the limits of one job of it: ``seconds``, and ``memory`` (GB)."""

    workers: int
    cluster: str | None = None
    seconds: float | None = None
    memory: float | None = None

    @property
    def limits(self) -> Limits:
        """The limits of one job."""
        from dynident.runtime.jobs import Limits

        return Limits(self.seconds, self.memory)

    @contextmanager
    def executor(self, *preload: str) -> Iterator[Executor | None]:
        """Yield the executor, None where this process does the work itself; ``preload`` are modules that workers
        import.

        Raises InputError where the cluster cannot be used.
        """
        # one worker without a limit that would have to end it
        if self == WorkerOptions(1):
            yield None
            return
        if self.cluster is None:
            from dynident.runtime.jobs import local_workers

            workers = local_workers(self.workers, preload)
        else:
            from dynident.runtime.jobs.cluster import cluster_workers

            workers = cluster_workers(self.cluster, preload)
        with workers as executor:
            yield executor


def available_cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def add_worker_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add ``--workers``, ``--cluster``, ``--time-limit`` and ``--worker-memory``, passed together as ``spread``."""

    @click.option("--workers", type=click.IntRange(1), help="Worker processes.  [default: one for each core]")
    @click.option(
        "--cluster", metavar="ADDRESS", help="Use the Dask cluster of this scheduler, such as tcp://HOST:8786."
    )
    @click.option("--time-limit", type=POSITIVE, metavar="S", help="Time limit of one job.")
    @click.option("--worker-memory", type=POSITIVE, metavar="GB", help="Memory limit of one worker (GB).")
    @wraps(command)
    def spread_command(
        workers: int | None, cluster: str | None, time_limit: float | None, worker_memory: float | None, **options: Any
    ) -> Any:
        if workers is not None and cluster is not None:
            raise click.UsageError("--workers are processes of this machine, --cluster has its own; give one of them.")
        spread = WorkerOptions(workers or available_cores(), cluster, time_limit, worker_memory)
        return command(spread=spread, **options)

    return spread_command


def version_text() -> str:
    """Return the versions of dynident, Python and the libraries that results depend on most, and what computes.

    Raises ConfigError, as ``kernel``.
    """
    dynident_version = f"dynident {__version__}" + (f", commit {revision}" if (revision := commit()) else "")
    python = f"{platform.python_implementation()} {platform.python_version()}, {platform.platform()}"
    packages = ", ".join(f"{name} {package_version(name)}" for name in PACKAGES)
    return "\n".join((dynident_version, python, packages, f"kernel: {kernel()}"))


def commit() -> str | None:
    """Return the commit of the clone from which dynident runs, or was built (`hatch_build.py`), with "-dirty" where
    files differed from it; None where it is not known.
    """
    root, built = Path(__file__).parents[3], Path(__file__).parents[1] / "commit.txt"
    if built.is_file():
        return built.read_text().strip()
    if not (root / ".git").exists() or not (root / "src" / "dynident").is_dir():
        return None
    arguments = ["git", "-C", str(root), "describe", "--always", "--dirty", "--exclude=*"]
    try:
        return subprocess.run(arguments, capture_output=True, text=True, timeout=5, check=True).stdout.strip()  # noqa: S603
    except (OSError, subprocess.SubprocessError):  # there is no git, or it does not trust the folder
        return None
