"""Real processes of Dask on loopback, which end with the test."""

import json
import os
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

import distributed
from distributed.versions import VersionMismatchWarning

from tests.runtime.jobs.work import HANGS

ROOT = Path(__file__).parents[3]
HERE = ("--host", "127.0.0.1", "--dashboard-address", "127.0.0.1:0")


@dataclass
class DaskCluster:
    """A scheduler, and what has been started of it: ``workers`` are in the order of their start."""

    folder: Path
    address: str = field(init=False, default="")
    scheduler: subprocess.Popen[bytes] = field(init=False)
    workers: list[subprocess.Popen[bytes]] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        file = self.folder / "scheduler.json"
        self.scheduler = self._start("scheduler", "--port", "0", "--no-show", "--scheduler-file", str(file), *HERE)

    def require_scheduler(self) -> None:
        """Wait until it says its address."""
        file, deadline = self.folder / "scheduler.json", time.monotonic() + HANGS
        while not self.address and time.monotonic() < deadline:
            with suppress(OSError, ValueError):  # not there, or not whole
                self.address = json.loads(file.read_text())["address"]
            time.sleep(0.02)

    def start_worker(self, *options: str, **environment: str) -> subprocess.Popen[bytes]:
        place = ("--local-directory", str(self.folder / f"{len(self.workers)}"))
        options = (self.address, "--nthreads", "1", *HERE, *place, *options)
        self.workers.append(self._start("worker", *options, **environment))
        return self.workers[-1]

    def require_workers(self, count: int) -> list[str]:
        """Wait until there are so many, and no more; return their addresses."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", VersionMismatchWarning)  # of a worker that was killed, and is still listed
            client = distributed.Client(self.address, set_as_default=False)
        with client:
            deadline = time.monotonic() + HANGS
            while len(result := list(client.nthreads())) != count and time.monotonic() < deadline:
                time.sleep(0.02)
            assert len(result) == count, (self.folder / "log").read_text()
            return result

    def _start(self, *words: str, **environment: str) -> subprocess.Popen[bytes]:
        paths = {"PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])}
        with (self.folder / "log").open("ab") as log:
            return subprocess.Popen(
                [sys.executable, "-m", "dask", *words], env={**self._environment(), **paths, **environment},
                stdout=log, stderr=log, start_new_session=True,
            )  # fmt: skip

    @staticmethod
    def _environment() -> Mapping[str, str]:
        """What says how many threads of BLAS there are is Dask's and dynident's own affair."""
        return {name: value for name, value in os.environ.items() if not name.endswith("_THREADS")}

    def end(self) -> None:
        for case in (*self.workers, self.scheduler):
            with suppress(ProcessLookupError):
                os.killpg(case.pid, signal.SIGKILL)  # with the processes that a nanny has
            case.wait()


@contextmanager
def dask_scheduler(folder: Path) -> Iterator[DaskCluster]:
    """Give a scheduler without workers."""
    cluster = DaskCluster(folder)
    try:
        cluster.require_scheduler()
        yield cluster
    finally:
        cluster.end()
