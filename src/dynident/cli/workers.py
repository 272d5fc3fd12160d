"""Options of commands that spread their work, and the executor that these ask for."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import wraps
from typing import TYPE_CHECKING, Any

import click

from dynident.cli.options import Range

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from dynident.jobs import Limits

__all__ = ["Spread", "spread"]

POSITIVE = Range(0, min_open=True)


@dataclass(frozen=True)
class Spread:
    """Where the work of a command runs, and what limits one job of it: ``seconds``, and ``memory`` (GB)."""

    workers: int
    cluster: str | None = None
    seconds: float | None = None
    memory: float | None = None

    @property
    def limits(self) -> Limits:
        """The limits of one job."""
        from dynident.jobs import Limits

        return Limits(self.seconds, self.memory)

    @property
    def alone(self) -> bool:
        """Whether this process does the work itself: there is one worker, and nothing that would have to end it."""
        return self.cluster is None and self.workers == 1 and self.seconds is None and self.memory is None

    @contextmanager
    def executor(self, *preload: str) -> Iterator[Executor | None]:
        """Give the executor, None where this process does the work alone; ``preload`` are modules that workers import.

        Raises InputError where the cluster cannot be used.
        """
        if self.alone:
            yield None
            return
        if self.cluster is None:
            from dynident.jobs import local_workers

            workers = local_workers(self.workers, preload)
        else:
            from dynident.jobs.cluster import cluster_workers

            workers = cluster_workers(self.cluster, preload)
        with workers as executor:
            yield executor


def cores() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def spread(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options ``--workers``, ``--cluster``, ``--time-limit`` and ``--worker-memory``, passed as ``spread``."""

    @click.option("--workers", type=click.IntRange(1), help="Worker processes.  [default: one for each core]")
    @click.option(
        "--cluster", metavar="ADDRESS", help="Work on the cluster of this Dask scheduler, such as tcp://HOST:8786."
    )
    @click.option("--time-limit", type=POSITIVE, metavar="S", help="Most seconds that one job may take.")
    @click.option("--worker-memory", type=POSITIVE, metavar="GB", help="Most memory that one worker may take (GB).")
    @wraps(command)
    def spread_command(
        workers: int | None, cluster: str | None, time_limit: float | None, worker_memory: float | None, **rest: Any
    ) -> Any:
        if workers is not None and cluster is not None:
            raise click.UsageError("--workers are processes of this machine, --cluster has its own; give one of them.")
        return command(spread=Spread(workers or cores(), cluster, time_limit, worker_memory), **rest)

    return spread_command
