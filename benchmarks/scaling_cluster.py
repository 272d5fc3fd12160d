"""A Dask scheduler and its workers on this machine, in processes of their own, for benchmarks/scaling.py."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from tempfile import TemporaryDirectory

import psutil

from dynident.runtime.jobs.cluster import cluster_workers

START = 60.0  # s for all to answer


@dataclass(frozen=True)
class Cluster:
    """Where a scheduler listens, and the processes."""

    address: str
    scheduler: subprocess.Popen[bytes]
    workers: subprocess.Popen[bytes]

    def executor(self, preload: tuple[str, ...] = ()) -> AbstractContextManager[Executor]:
        return cluster_workers(self.address, preload)

    @contextmanager
    def in_threads(self, slots: int) -> Iterator[Executor]:
        """Dask's own executor: jobs run in threads of its workers, that have no process of their own."""
        import distributed

        with distributed.Client(self.address, set_as_default=False) as client:
            executor = client.get_executor(pure=False)
            executor._max_workers = slots
            yield executor

    def scheduler_cpu(self) -> float:
        """CPU time (s) of the scheduler."""
        return cpu_of(self.scheduler.pid)


def cpu_of(process: int, *, children: bool = False) -> float:
    """Return the CPU time (s) of a process, or of those that it started and that live."""
    of = psutil.Process(process)
    some = of.children(recursive=True) if children else [of]
    return sum(sum(x.cpu_times()[:2]) for x in some)


@contextmanager
def cluster(workers: int, threads: int) -> Iterator[Cluster]:
    """Start a scheduler on the loopback interface with worker processes of some threads each; end them."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    variables = os.environ | {
        "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
        "DASK_DISTRIBUTED__LOGGING__DISTRIBUTED": "error",
    }
    common = ("--host", "127.0.0.1", "--no-dashboard")
    with TemporaryDirectory() as place:
        started = []
        try:
            for words in (
                ("dask_scheduler", "--port", str(port), *common),
                ("dask_worker", address, "--nworkers", str(workers), "--nthreads", str(threads), *common,
                 "--local-directory", place),
            ):  # fmt: skip
                command = [sys.executable, "-m", f"distributed.cli.{words[0]}", *words[1:]]
                started.append(subprocess.Popen(command, env=variables, cwd=place, stderr=subprocess.DEVNULL))
            wait_for(address, workers)
            yield Cluster(address, *started)
        finally:
            for process in reversed(started):
                process.terminate()
            for process in reversed(started):
                process.wait()


def wait_for(address: str, workers: int) -> None:
    """Wait until all workers are there."""
    import distributed

    end = time.monotonic() + START
    while True:
        try:
            with distributed.Client(address, timeout=5, set_as_default=False) as client:
                client.wait_for_workers(workers, timeout=max(end - time.monotonic(), 1.0))
                return
        except OSError:
            if time.monotonic() > end:
                raise
            time.sleep(0.3)
