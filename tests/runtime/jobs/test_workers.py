"""Processes of this machine: one thread each, an end with the one that started them, and trouble of a job."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import pytest

from dynident.runtime import InputError
from dynident.runtime.jobs import Limits, Status, local_workers, run_jobs, workers
from tests.runtime.jobs.work import (
    HANGS,
    Trouble,
    blas_threads,
    by_job,
    chance_to_be_killed,
    loaded,
    parent,
    process,
    threads,
)

posix = pytest.mark.skipif(os.name == "nt", reason="sends POSIX signals")
forks = pytest.mark.skipif(sys.platform != "linux", reason="workers are not forked on this system")
ROOT = Path(__file__).parents[3]


def test_each_worker_is_a_process_with_one_thread() -> None:
    with local_workers(2) as executor:
        result = {outcome.value for outcome in run_jobs(process, range(200), executor)}
        assert len(result) == 2
        assert os.getpid() not in result
        assert {outcome.value for outcome in run_jobs(threads, range(4), executor)} == {("1", "1")}
        assert {outcome.value for outcome in run_jobs(process, range(200), executor)} == result


def test_a_worker_has_its_settings_its_modules_and_ends_first_where_memory_runs_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It keeps its memory between jobs: in a worker of Dask it would give it back each time, as its nanny asks for."""
    monkeypatch.setenv("MALLOC_TRIM_THRESHOLD_", "65536")
    with local_workers(1, ["colorsys"]) as executor:
        assert [outcome.value for outcome in run_jobs(os.getenv, ["MALLOC_TRIM_THRESHOLD_"], executor)] == [None]
        if sys.platform == "linux":  # elsewhere workers are not forked
            assert [outcome.value for outcome in run_jobs(loaded, ["colorsys", "tabnanny"], executor)] == [True, False]
            assert [outcome.value for outcome in run_jobs(chance_to_be_killed, [0], executor)] == [500]
            assert chance_to_be_killed(0) < 500


def test_a_process_of_a_pool_has_one_thread() -> None:
    with ProcessPoolExecutor(1, get_context("spawn")) as executor:
        assert [outcome.value for outcome in run_jobs(blas_threads, [0], executor)] == [{1}]


@forks
def test_a_server_that_is_killed_is_started_again() -> None:
    with local_workers(1) as executor:
        (server,) = {outcome.value for outcome in run_jobs(parent, range(3), executor)}
        assert server != os.getpid()
        os.kill(server, signal.SIGKILL)
        time.sleep(0.5)
        assert server not in {outcome.value for outcome in run_jobs(parent, range(3), executor)}


@pytest.mark.parametrize("pool", [ThreadPoolExecutor, ProcessPoolExecutor])
def test_limits_on_an_executor_of_the_user(tmp_path: Path, pool: Callable[..., ThreadPoolExecutor]) -> None:
    jobs = [("hangs", 0), ("ends", 1), ("crashes_once", 2), *(("fine", number) for number in range(3, 9))]
    how = (get_context("fork"),) if pool is ProcessPoolExecutor and sys.platform == "linux" else ()
    with pool(2, *how) as executor:
        done = by_job(list(run_jobs(Trouble(tmp_path), jobs, executor, limits=Limits(seconds=0.5))))
    assert [done[job].status for job in jobs] == [Status.TIMED_OUT, Status.DIED] + 7 * [Status.OK]


def test_limits_without_an_executor(tmp_path: Path) -> None:
    done = by_job(list(run_jobs(Trouble(tmp_path), [("hangs", 0), ("fine", 1)], limits=Limits(seconds=0.5))))
    assert [done[job].status for job in done] == [Status.TIMED_OUT, Status.OK]


@pytest.mark.skipif(sys.platform != "linux", reason="this system does not limit the memory of a process")
def test_a_limit_below_what_a_worker_takes_is_said() -> None:
    with pytest.raises(InputError, match=r"a worker takes more than the limit of 0\.05 GB before it runs any job"):
        list(run_jobs(process, range(3), limits=Limits(memory=0.05)))


def test_a_process_of_a_daemon_has_limits() -> None:
    """Such are the workers of Dask, which multiprocessing lets have no children."""
    context = get_context("spawn")
    mine, other = context.Pipe()
    daemon = context.Process(target=_report, args=(other,), daemon=True)
    daemon.start()
    assert mine.recv() == [Status.TIMED_OUT]
    daemon.join()
    mine.close()
    other.close()


def _report(connection) -> None:
    workers.PRELOADED_MODULES = ()
    connection.send([outcome.status for outcome in run_jobs(time.sleep, [HANGS], limits=Limits(seconds=0.5))])


SCRIPT = """\
import itertools, os, signal, sys, threading
from dynident.runtime.jobs import Limits, local_workers, run_jobs, workers
from tests.runtime.jobs import work
workers.PRELOADED_MODULES = ()
with local_workers(2) as executor:
    for done in run_jobs(getattr(work, sys.argv[1]), itertools.count(), executor):
        if sys.argv[2] == "raise":
            raise ValueError("what the user does with a result")
"""


@posix
@pytest.mark.parametrize(
    ("job", "way"),
    [
        *(("stuck", "SIGKILL"), ("stuck", "SIGTERM"), ("stuck", "SIGINT"), ("stuck", "group")),
        *(("told", "SIGKILL"), ("soon_stuck", "raise")),
    ],
)
def test_workers_end_with_this_process(job: str, way: str) -> None:
    """Even those whose job never lets Python run. A worker holds standard error until it ends."""
    words = [sys.executable, "-c", SCRIPT, job, way]
    pipes = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True, "start_new_session": True}
    path = os.pathsep.join([str(ROOT / "src"), str(ROOT)])
    with subprocess.Popen(words, **pipes, env={**os.environ, "PYTHONPATH": path}) as process:
        assert process.stderr.readline() == "a job\n"
        if way == "group":
            os.killpg(process.pid, signal.SIGINT)
        elif way != "raise":
            process.send_signal(getattr(signal, way))
        _, said = process.communicate(timeout=HANGS)
    # the first words may lack their start, which was read with the line before
    last = [line for line in said.splitlines() if not "a job".endswith(line)][-1:]
    expected = {"SIGINT": ["KeyboardInterrupt"], "group": ["KeyboardInterrupt"]}
    assert last == expected.get(way, ["ValueError: what the user does with a result"] if way == "raise" else [])
    assert process.returncode == {"SIGKILL": -9, "SIGTERM": -15, "raise": 1}.get(way, -2)


@posix
@pytest.mark.parametrize("wait", [0.0, 0.2])
def test_ctrl_c_while_workers_start(wait: float) -> None:
    """A terminal sends it to all processes of the group."""
    after = f"threading.Timer({wait}, os.killpg, (os.getpid(), signal.SIGINT)).start()\n"
    words = [sys.executable, "-c", SCRIPT.replace("with local", f"{after}with local"), "stuck", "wait"]
    path = os.pathsep.join([str(ROOT / "src"), str(ROOT)])
    done = subprocess.run(
        words, capture_output=True, text=True, start_new_session=True, timeout=HANGS, check=False,
        env={**os.environ, "PYTHONPATH": path},
    )  # fmt: skip
    assert done.returncode == -signal.SIGINT, done.stderr
    assert done.stderr.count("Traceback") == 1
    assert done.stderr.endswith("KeyboardInterrupt\n")


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
    for (_, number), case in done.items():
        if number == 3:
            assert (case.status, case.reason, case.value) == (status, reason, None)
        else:
            assert (case.status, case.value) == (Status.OK, number**2)
        assert work.calls(number) == (2 if number == 3 and status is Status.DIED else 1)


def test_a_job_whose_process_dies_is_tried_once_more(executor: Executor, tmp_path: Path) -> None:
    jobs = [("crashes_once", 0), ("fine", 1), ("crashes_once", 2)]
    done = by_job(list(run_jobs(Trouble(tmp_path), jobs, executor)))
    assert [done[job].value for job in jobs] == [0, 1, 2]
