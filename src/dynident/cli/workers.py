"""Options of commands that spread their work, and the executor that these ask for."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import wraps
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from dynident.jobs import Limits

__all__ = ["Spread", "spread"]


@dataclass(frozen=True)
class Spread:
    """Where the work of a command runs, and what limits one job of it."""

    workers: int
    cluster: str | None = None
    seconds: float | None = None
    memory: float | None = None

    @property
    def limits(self) -> Limits:
        """The limits of one job."""
        from dynident.jobs import Limits

        return Limits(self.seconds, self.memory)

    @contextmanager
    def executor(self) -> Iterator[Executor | None]:
        """Give the executor, None where this process does the work alone."""
        yield None


def spread(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options ``--workers``, ``--cluster``, ``--time-limit`` and ``--worker-memory``, passed as ``spread``."""

    @click.option("--workers", type=click.IntRange(1), help="Worker processes; by default one for each core.")
    @click.option("--cluster", metavar="ADDRESS", help="Address of a Dask scheduler to work on: tcp://HOST:8786.")
    @click.option("--time-limit", type=click.FloatRange(0, min_open=True), metavar="S", help="Most seconds of one job.")
    @click.option(
        "--worker-memory", type=click.FloatRange(0, min_open=True), metavar="GB", help="Most memory of one worker (GB)."
    )
    @wraps(command)
    def spread_command(
        workers: int | None, cluster: str | None, time_limit: float | None, worker_memory: float | None, **rest: Any
    ) -> Any:
        where = Spread(workers or os.cpu_count() or 1, cluster, time_limit, worker_memory)
        return command(spread=where, **rest)

    return spread_command
