"""A worker process that runs jobs one by one, and another one where that has died."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection, wait

from dynident.errors import InputError
from dynident.jobs.attempt import Ended
from dynident.jobs.child import Order
from dynident.jobs.job import Limits, Status
from dynident.jobs.processes import Child, Starter

__all__ = ["Runner"]

TRIES = 2  # of a job whose process dies: it may have been killed for want of memory of all


class Runner:
    """A worker process for jobs of one thread.

    It is started when it is needed, and anew after it died, was killed at the limit of time, or ran out of memory; the
    job that it was at is the only one that is lost.
    """

    def __init__(self, starter: Starter) -> None:
        self._starter = starter
        self._child: Child | None = None
        self._function = b""  # that the process has

    def run(self, function: bytes, jobs: Sequence[bytes], limits: Limits) -> list[Ended]:
        """Return what becomes of each job; InputError where the process cannot run any."""
        ended: list[Ended] = []
        tries = 0
        while len(ended) < len(jobs):
            try:
                for one in self._answers(function, jobs[len(ended) :], limits):
                    ended.append(one)
                    tries = 0
            except TimeoutError:
                self.close()
                seconds = limits.seconds or 0.0
                ended.append(Ended(Status.TIMED_OUT, seconds, reason=f"longer than the limit of {seconds:g} s"))
            except (EOFError, OSError):
                tries += 1
                code = self.close()
                if tries == TRIES:
                    ended.append(Ended(Status.DIED, 0.0, reason=_death(code)))
                    tries = 0
        return ended

    def _answers(self, function: bytes, jobs: Sequence[bytes], limits: Limits) -> Iterator[Ended]:
        connection = self._ordered(function, jobs, limits)
        for _ in jobs:
            if limits.seconds is not None and not (wait([connection], limits.seconds) or wait([connection], 0)):
                raise TimeoutError
            one = Ended(*connection.recv())
            yield one
            if one.status is Status.OUT_OF_MEMORY:
                self.close()
                return

    def _ordered(self, function: bytes, jobs: Sequence[bytes], limits: Limits) -> Connection:
        """Send an order to the process; return its connection when it is at the first job."""
        for _ in range(TRIES):
            child = self._child = self._child or self._starter.start()
            given = None if function == self._function else function
            try:
                child.connection.send(tuple(Order(given, limits.memory, jobs)))
                refused = child.connection.recv()
            except (EOFError, OSError):
                code = self.close()
                continue
            if refused:
                raise InputError(refused)
            self._function = function
            return child.connection
        raise InputError(f"a worker process ends before it runs any job: {_death(code)}.")

    def close(self) -> int:
        """End the process; return its exit code."""
        child, self._child, self._function = self._child, None, b""
        if child is None:
            return 0
        child.connection.close()
        return child.end()

    def __del__(self) -> None:
        if self._child is not None:  # the process ends by that; more might wait for what this thread itself holds
            self._child.connection.close()


def _death(code: int) -> str:
    if code >= 0:
        return f"its process has ended with exit code {code}"
    return f"its process was killed by signal {-code}, perhaps for want of memory"
