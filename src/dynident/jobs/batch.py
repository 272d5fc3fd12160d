"""Jobs that go to a worker together, and what a worker of any executor does with them."""

from __future__ import annotations

import os
import pickle
import socket
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

from dynident.errors import InputError
from dynident.jobs.attempt import Ended, attempt
from dynident.jobs.job import Limits
from dynident.jobs.workers import runner_of_thread

__all__ = ["Batch", "Report", "run_batch"]

KEPT = 4  # functions that a process remembers


class Batch(NamedTuple):
    """Pickled jobs for a worker, with their function: by digest, and whole where the worker may not know it.

    ``name`` tells a batch from all others, also for executors that run equal ones once.
    """

    name: str
    digest: bytes
    function: bytes | None
    jobs: Sequence[bytes]
    limits: Limits


class Report(NamedTuple):
    """What became of the jobs of a batch; ``lost``: seconds, since the batch before, in which no job ran."""

    worker: tuple[str, int, int]
    ended: Sequence[Ended]
    lost: float | None


@dataclass(frozen=True)
class _Function:
    """A function as it came, and itself where it is called here."""

    packed: bytes

    @cached_property
    def itself(self) -> Callable[[Any], Any]:
        try:
            return pickle.loads(self.packed)  # type: ignore[no-any-return]  # noqa: S301 -- from who asks us to run it
        except Exception as error:
            raise InputError(
                f"a worker cannot load the function of the jobs: {type(error).__name__}: {error}; define it in a "
                "module that can be imported there."
            ) from error


_FUNCTIONS: dict[bytes, _Function] = {}
_LAST = threading.local()  # ``ended``: when this worker was done with the batch before


def run_batch(batch: Batch) -> Report | None:
    """Run jobs in this thread, or in the process that it has for them; None where the function is not known here."""
    if (function := _function(batch)) is None:
        return None
    if runner := runner_of_thread(batch.limits):
        ended = runner.run(function.packed, batch.jobs, batch.limits)
    else:
        ended = [attempt(function.itself, job) for job in batch.jobs]
    before, now = getattr(_LAST, "ended", None), time.monotonic()
    _LAST.ended = now
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
