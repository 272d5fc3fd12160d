"""What goes wrong in a job is said of that job; the others are done, once."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from concurrent.futures import Executor
from pathlib import Path

import pytest

from dynident.runtime.jobs import Limits, Status, local_workers, run_jobs
from tests.runtime.jobs.work import Trouble, by_job

needs_limits = pytest.mark.skipif(sys.platform != "linux", reason="this system does not limit the memory of a process")
TROUBLES = {
    "raises": (Status.FAILED, "ValueError: no 3"),
    "leaves": (Status.FAILED, "SystemExit: 3"),
    "unpicklable": (Status.FAILED, "TypeError: stays here"),
    "silent": (Status.FAILED, "_SilentError"),
    "hangs": (Status.TIMED_OUT, "longer than the limit of 1 s"),
    "ends": (Status.DIED, "its process has ended with exit code 7"),
    "crashes": (Status.DIED, "its process was killed by signal 9, perhaps for want of memory"),
}


@pytest.fixture(scope="module")
def executor() -> Iterator[Executor]:
    with local_workers(1) as worker:
        yield worker


@pytest.mark.parametrize("trouble", [*TROUBLES, pytest.param("eats", marks=needs_limits)])
def test_trouble_of_a_job_is_its_own(executor: Executor, tmp_path: Path, trouble: str) -> None:
    work = Trouble(tmp_path)
    jobs = [(trouble if number == 3 else "fine", number) for number in range(8)]
    limits = Limits(seconds=1.0 if trouble == "hangs" else None, memory=0.3 if trouble == "eats" else None)
    done = by_job(list(run_jobs(work, jobs, executor, limits=limits)))
    status, reason = TROUBLES.get(trouble, (Status.OUT_OF_MEMORY, "MemoryError: "))
    assert set(done) == set(jobs)
    for (_, number), one in done.items():
        if number == 3:
            assert (one.status, one.reason, one.value) == (status, reason, None)
        else:
            assert (one.status, one.value) == (Status.OK, number**2)
        assert work.calls(number) == (2 if number == 3 and status is Status.DIED else 1)


def test_a_job_whose_process_dies_is_tried_once_more(executor: Executor, tmp_path: Path) -> None:
    jobs = [("crashes_once", 0), ("fine", 1), ("crashes_once", 2)]
    done = by_job(list(run_jobs(Trouble(tmp_path), jobs, executor)))
    assert [done[job].value for job in jobs] == [0, 1, 2]
