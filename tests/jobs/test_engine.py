"""Whatever runs the jobs, the results are the same, and each job ends once."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest

from dynident.jobs import Limits, Status, local_workers, run_jobs
from tests.jobs.work import Noise, Trouble, by_job

EXECUTORS: dict[str, Callable[[], AbstractContextManager[Executor | None]]] = {
    "alone": nullcontext,
    "local workers": lambda: local_workers(2),
    "threads": lambda: ThreadPoolExecutor(2),
    "processes": lambda: ProcessPoolExecutor(2, get_context("spawn")),
}
SPREAD = [name for name in EXECUTORS if name != "alone"]


@pytest.fixture(scope="module")
def noise() -> Noise:
    return Noise(np.random.default_rng(5).standard_normal((300, 300)))


@pytest.mark.parametrize("limits", [Limits(), Limits(seconds=600.0)])
@pytest.mark.parametrize("kind", EXECUTORS)
def test_results_do_not_depend_on_the_executor(noise: Noise, kind: str, limits: Limits) -> None:
    with EXECUTORS[kind]() as executor:
        done = by_job(list(run_jobs(noise, range(50), executor, limits=limits)))
    assert {job: one.value for job, one in done.items()} == {job: noise(job) for job in range(50)}


@pytest.mark.parametrize("kind", EXECUTORS)
def test_an_error_is_a_result(tmp_path: Path, kind: str) -> None:
    with EXECUTORS[kind]() as executor:
        done = by_job(list(run_jobs(Trouble(tmp_path), [("raises", 1), ("leaves", 2), ("fine", 3)], executor)))
    assert [(one.status, one.reason, one.value) for _, one in sorted(done.items(), key=lambda item: item[0][1])] == [
        (Status.FAILED, "ValueError: no 1", None),
        (Status.FAILED, "SystemExit: 2", None),
        (Status.OK, "", 9),
    ]


@pytest.mark.parametrize("kind", EXECUTORS)
def test_jobs_are_taken_as_they_are_needed(kind: str) -> None:
    taken = itertools.count()
    with EXECUTORS[kind]() as executor:
        done = run_jobs(abs, (next(taken) for _ in itertools.repeat(None)), executor)
        assert len(list(itertools.islice(done, 100))) == 100
        done.close()  # type: ignore[attr-defined]
    assert next(taken) < 100 + 4 * 1000 + 1  # batches that are under way
