"""Jobs that go to a worker together, and what a worker of any executor does with them."""

from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from multiprocessing import parent_process
from typing import Any, NamedTuple

from dynident.errors import InputError
from dynident.jobs.attempt import Ended, attempt
from dynident.jobs.job import Limits
from dynident.jobs.packed import unpacked
from dynident.jobs.workers import runner_of_thread

__all__ = ["Batch", "Report", "run_batch"]

KEPT = 4  # functions that a process remembers


class Batch(NamedTuple):
    """Pickled jobs for a worker, with their function: by digest, and whole where the worker may not know it.

    ``run`` and ``number`` tell a batch from all others, also for executors that run equal ones once.
    """

    run: str
    number: int
    digest: bytes
    function: bytes | None
    jobs: Sequence[bytes]
    limits: Limits


class Report(NamedTuple):
    """What became of the jobs of a batch; ``lost``: seconds since the one before, of this run, in which no job ran."""

    worker: tuple[str, int, int]
    ended: Sequence[Ended]
    lost: float | None


@dataclass(frozen=True)
class _Function:
    """A function as it came, and itself where it is called here."""

    packed: bytes

    @cached_property
    def itself(self) -> Callable[[Any], Any]:
        """The function, loaded when it is first called; InputError where that fails."""
        try:
            function: Callable[[Any], Any] = unpacked(self.packed)
        except Exception as error:
            raise InputError(
                f"a worker cannot load the function of the jobs: {type(error).__name__}: {error}; define it in a "
                "module that can be imported there."
            ) from error
        if parent_process() is not None:  # a worker: others use the other cores
            _one_thread()
        return function


@cache
def _one_thread() -> None:
    import scipy.linalg  # noqa: F401  # SciPy's own BLAS must be loaded to be found
    from threadpoolctl import threadpool_limits

    threadpool_limits(1)


_FUNCTIONS: dict[bytes, _Function] = {}
_LAST = threading.local()  # ``run`` of the batch before, and when this worker had ``ended`` it


def run_batch(batch: Batch) -> Report | None:
    """Run jobs in this thread, or in the process that it has for them; None where the function is not known here."""
    if (function := _function(batch)) is None:
        return None
    if runner := runner_of_thread(batch.limits):
        ended = runner.run(function.packed, batch.jobs, batch.limits)
    else:
        ended = [attempt(function.itself, job) for job in batch.jobs]
    before, now = _LAST.ended if getattr(_LAST, "run", None) == batch.run else None, time.monotonic()
    _LAST.run, _LAST.ended = batch.run, now
    lost = None if before is None else max(now - before - sum(one.seconds for one in ended), 0.0)
    return Report((socket.gethostname(), os.getpid(), threading.get_ident()), ended, lost)


def _function(batch: Batch) -> _Function | None:
    if (known := _FUNCTIONS.get(batch.digest)) is not None:
        return known
    if batch.function is None:
        return None
    for old in list(_FUNCTIONS)[: 1 - KEPT]:
        _FUNCTIONS.pop(old, None)
    return _FUNCTIONS.setdefault(batch.digest, _Function(batch.function))
