"""Whatever runs the jobs, results are the same and each job ends once; the sizes of batches, and classes of files."""

import itertools
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest

from dynident.project.python_file import load_from_file
from dynident.runtime import ConfigError, InputError, budget_scope, set_budget
from dynident.runtime.jobs import Limits, Status, local_workers, run_jobs
from dynident.runtime.jobs import engine as batch
from dynident.runtime.jobs import engine as pace
from dynident.runtime.jobs.engine import Batch, BatchReport, Pace, run_batch
from dynident.runtime.jobs.job import pack, unpack
from tests.runtime.jobs.work import Noise, Stranger, Trouble, budget, by_job

EXECUTORS: dict[str, Callable[[], AbstractContextManager[Executor | None]]] = {
    "alone": nullcontext,
    "local workers": lambda: local_workers(2),
    "threads": lambda: ThreadPoolExecutor(2),
    "processes": lambda: ProcessPoolExecutor(2, get_context("spawn")),
}


@pytest.fixture(scope="module", params=EXECUTORS)
def executor(request: pytest.FixtureRequest) -> Iterator[Executor | None]:
    with EXECUTORS[request.param]() as result:
        yield result


@pytest.fixture(scope="module")
def noise() -> Noise:
    return Noise(np.random.default_rng(5).standard_normal((300, 300)))


@pytest.mark.parametrize("limits", [Limits(), Limits(seconds=600.0)])
def test_results_do_not_depend_on_the_executor(noise: Noise, executor: Executor | None, limits: Limits) -> None:
    done = by_job(list(run_jobs(noise, range(50), executor, limits=limits)))
    assert {job: x.value for job, x in done.items()} == {job: noise(job) for job in range(50)}


@pytest.mark.parametrize("limits", [Limits(), Limits(seconds=600.0)])
def test_jobs_have_the_memory_of_the_run(executor: Executor | None, limits: Limits) -> None:
    with budget_scope():
        set_budget(2.5)
        done = list(run_jobs(budget, range(3), executor, limits=limits))
    assert [x.value for x in done] == 3 * [2_500_000_000]


def test_an_error_is_a_result(tmp_path: Path, executor: Executor | None) -> None:
    done = by_job(list(run_jobs(Trouble(tmp_path), [("raises", 1), ("leaves", 2), ("fine", 3)], executor)))
    assert [(x.status, x.reason, x.value) for _, x in sorted(done.items(), key=lambda item: item[0][1])] == [
        (Status.FAILED, "ValueError: no 1", None),
        (Status.FAILED, "SystemExit: 2", None),
        (Status.OK, "", 9),
    ]


def test_jobs_are_taken_as_they_are_needed(executor: Executor | None) -> None:
    taken = itertools.count()
    done = run_jobs(abs, (next(taken) for _ in itertools.repeat(None)), executor)
    assert len(list(itertools.islice(done, 100))) == 100
    done.close()  # type: ignore[attr-defined]
    assert next(taken) < 100 + 4 * 1000 + 1  # batches that are under way


class Direct(Executor):
    """Runs what is submitted at once; ``spoil`` may raise first. It gathers the batches."""

    def __init__(self, spoil: Callable[[Batch], None] = lambda batch: None) -> None:
        self.spoil, self.batches = spoil, list[Batch]()

    def submit(self, fn, /, *args, **kwargs):
        assert fn is run_batch
        future: Future[BatchReport | None] = Future()
        self.batches.append(args[0])
        try:
            self.spoil(args[0])
            future.set_result(fn(*args))
        except Exception as error:
            future.set_exception(error)
        return future


def test_the_function_goes_with_the_first_batches_and_to_who_lacks_it(noise: Noise) -> None:
    def forget(given: Batch) -> None:
        if given.number == 9:
            batch._FUNCTIONS.clear()

    executor = Direct(forget)
    executor._max_workers = 2  # type: ignore[attr-defined]
    done = by_job(list(run_jobs(noise, range(200), executor)))
    assert {job: x.value for job, x in done.items()} == {job: noise(job) for job in range(200)}
    assert len(executor.batches) > 10
    full = [x.number for x in executor.batches if x.function]
    assert full == [0, 1, 13, 14, 15, 16]  # those under way before an answer, and before that of number 9
    assert [executor.batches[number].jobs for number in full[2:]] == [x.jobs for x in executor.batches[9:13]]


def test_a_batch_that_the_executor_loses_is_tried_job_by_job() -> None:
    """As Dask does where three workers have died of it."""

    def kill(given: Batch) -> None:
        if pack(77) in given.jobs:
            raise RuntimeError("three workers have died")

    executor = Direct(kill)
    done = by_job(list(run_jobs(abs, range(200), executor)))
    assert done[77].status is Status.DIED
    assert done[77].reason == "RuntimeError: three workers have died"
    assert [x.value for job, x in sorted(done.items()) if job != 77] == [job for job in range(200) if job != 77]


def test_where_no_batch_runs_or_the_executor_gives_up_that_is_said() -> None:
    def refuse(given: Batch) -> None:
        raise ModuleNotFoundError("No module named 'dynident'")

    executor = Direct(refuse)
    with pytest.raises(InputError, match="workers cannot run jobs: ModuleNotFoundError: No module named 'dynident'"):
        list(run_jobs(abs, range(1000), executor))
    assert len(executor.batches) < 100

    def cancel(given: Batch) -> None:
        raise CancelledError

    with pytest.raises(InputError, match="the executor has given up jobs; are its workers still there"):
        list(run_jobs(abs, range(3), Direct(cancel)))


def test_a_process_pool_that_breaks(tmp_path: Path) -> None:
    with (
        ProcessPoolExecutor(1, get_context("spawn")) as executor,
        pytest.raises(InputError, match=r"a worker process has died.*Take fewer workers, or give jobs limits"),
    ):
        list(run_jobs(Trouble(tmp_path), [("fine", 1), ("ends", 2), ("fine", 3)], executor))


@pytest.mark.parametrize("executor", ["local workers", "processes"], indirect=True)
def test_a_function_that_workers_lack(executor: Executor) -> None:
    with pytest.raises(InputError, match="a worker cannot load the function of the jobs: RuntimeError: not here"):
        list(run_jobs(Stranger(), range(5), executor))


def test_what_only_this_process_knows(executor: Executor | None) -> None:
    """The extra ``cluster`` brings cloudpickle, which sends code."""
    pytest.importorskip("cloudpickle", reason="needs cloudpickle, of the extra cluster")
    factor = 3
    assert {outcome.value for outcome in run_jobs(lambda job: factor * job, range(4), executor)} == {0, 3, 6, 9}


@pytest.mark.parametrize("jobs", [2, 3])
def test_so_many_batches_may_fail_before_any_is_done(jobs: int) -> None:
    """Fewer are jobs that fail: what fails with three may be the workers."""

    def refuse(given: Batch) -> None:
        raise RuntimeError("lost")

    if jobs == batch.MAX_FIRST_FAILURES:
        with pytest.raises(InputError, match="workers cannot run jobs"):
            list(run_jobs(abs, range(jobs), Direct(refuse)))
    else:
        assert [outcome.status for outcome in run_jobs(abs, range(jobs), Direct(refuse))] == [Status.DIED] * jobs


def run(jobs: int, seconds: float, lost: float, workers: int = 2) -> list[int]:
    """The sizes of all batches of equal jobs, one after the other."""
    result, sizes = Pace(workers), []
    while jobs:
        size = result.size(jobs)
        sizes.append(size)
        jobs -= size
        result.record_batch(len(sizes) % workers, size, size * seconds, lost if len(sizes) > workers else None)
    return sizes


@pytest.mark.parametrize("seconds", [1e-3, 0.02, 0.1])
@pytest.mark.parametrize("lost", [1e-4, 0.01, 0.1, 0.4])
def test_little_is_lost(seconds: float, lost: float) -> None:
    sizes = run(100_000, seconds, lost)
    work = sum(sizes) * seconds
    expected = max(0.2, 19 * lost)
    most = max(sizes)
    assert most <= pace.MAX_BATCH_JOBS
    assert most == pace.MAX_BATCH_JOBS or most * seconds == pytest.approx(expected, abs=seconds)
    if most < pace.MAX_BATCH_JOBS:
        assert len(sizes) * lost < 0.06 * work


def test_workers_end_at_about_the_same_time() -> None:
    sizes = run(1000, 0.01, 0.5)
    assert sum(sizes) == 1000
    assert sizes[-1] == 1
    assert all(size <= 1 + sum(sizes[number:]) / 4 for number, size in enumerate(sizes))


CODE = "from dataclasses import dataclass\n\n\n@dataclass(frozen=True)\nclass Mine:\n    gain: float\n"


def mine(path: Path) -> type:
    path.write_text(CODE)
    return load_from_file(path, "Mine", "class", "here", ConfigError)


def test_a_class_of_a_file_reaches_another_process(tmp_path: Path) -> None:
    part = mine(tmp_path / "mine.py")(2.0)
    assert unpack(pack(part)) == part
    code = "import sys; from dynident.runtime.jobs.job import unpack; print(unpack(sys.stdin.buffer.read()))"
    done = subprocess.run([sys.executable, "-c", code], input=pack(part), capture_output=True, check=True)
    assert done.stdout.decode().strip() == "Mine(gain=2.0)"


def test_a_file_that_has_changed_meanwhile_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    sent = pack(mine(path)(2.0))
    path.write_text(CODE + "\n\nother = 1\n")
    with pytest.raises(ConfigError, match="has changed"):
        unpack(sent)
