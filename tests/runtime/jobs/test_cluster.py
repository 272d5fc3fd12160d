"""Jobs on real processes of Dask: results are those of any other executor, and what cannot be used is said."""

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator
from concurrent.futures import CancelledError
from pathlib import Path

import distributed
import numpy as np
import polars as pl
import pytest

import dynident
from dynident.apps.article import LEVELS, METHODS, SCENARIOS, run_study
from dynident.runtime import InputError
from dynident.runtime.jobs import Status, cluster, run_jobs
from dynident.runtime.jobs.cluster import cluster_workers, software_differences
from tests.cli.commands import succeed
from tests.runtime.jobs.dask_cluster import DaskCluster, dask_scheduler
from tests.runtime.jobs.work import HANGS, Noise, by_job, sleeps, slow_process, threads

pytestmark = pytest.mark.skipif(os.name == "nt", reason="ends groups of processes by POSIX signals")


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DaskCluster]:
    """A worker alone, and one with a nanny, which starts it again when it dies."""
    with dask_scheduler(tmp_path_factory.mktemp("dask")) as result:
        result.start_worker("--no-nanny")
        result.start_worker()
        result.require_workers(2)
        yield result


def refused(address: str) -> str:
    """Return why the workers there cannot be used."""
    with pytest.raises(InputError) as error, cluster_workers(address):
        pass
    return str(error.value)


class TestWorkers:
    def test_results_are_those_of_any_executor(self, running: DaskCluster) -> None:
        noise = Noise(np.random.default_rng(5).standard_normal((300, 300)))
        with cluster_workers(running.address) as executor:
            done = by_job(list(run_jobs(noise, range(50), executor)))
        assert {job: x.value for job, x in done.items()} == {job: noise(job) for job in range(50)}
        with distributed.Client(running.address, set_as_default=False) as client:  # Dask's own executor
            own = by_job(list(run_jobs(noise, range(50), client.get_executor())))
        assert {job: x.value for job, x in own.items()} == {job: x.value for job, x in done.items()}

    def test_each_has_a_process_for_its_jobs_with_one_thread(self, running: DaskCluster) -> None:
        with cluster_workers(running.address) as executor:
            assert executor._max_workers == 2  # type: ignore[attr-defined]
            theirs = {executor.submit(os.getpid).result() for _ in range(20)}
            own = {outcome.value for outcome in run_jobs(slow_process, range(20), executor)}
            assert {outcome.value for outcome in run_jobs(threads, range(20), executor)} == {("1", "1")}
        assert not own & {os.getpid(), *theirs}
        assert len(own) == 2

    def test_a_worker_that_is_killed_loses_nothing(self, running: DaskCluster) -> None:
        with cluster_workers(running.address) as executor:
            with_nanny = {executor.submit(os.getpid).result() for _ in range(20)} - {running.workers[0].pid}
            done = []
            for case in run_jobs(sleeps, [0.02 + 1e-6 * number for number in range(100)], executor):
                done.append(case)
                if len(done) == 30:
                    os.kill(with_nanny.pop(), signal.SIGKILL)
        assert len(by_job(done)) == 100
        assert all(x.status is Status.OK and x.value == x.job for x in done)
        running.require_workers(2)

    def test_what_is_given_up_is_cancelled(self, running: DaskCluster) -> None:
        with cluster_workers(running.address) as executor:
            given = [executor.submit(time.sleep, 0.1) for _ in range(20)]
            assert given[-1].cancel()
            with pytest.raises(CancelledError):
                given[-1].result()
            assert given[0].result() is None
            executor.shutdown(cancel_futures=True)

    def test_much_is_sent_without_a_warning(self, running: DaskCluster) -> None:
        with cluster_workers(running.address) as executor:
            assert executor.submit(len, bytes(12_000_000)).result() == 12_000_000
            error = executor.submit(divmod, 1, 0).exception()
        assert isinstance(error, ZeroDivisionError)

    def test_a_study_has_the_same_table(self, running: DaskCluster, tmp_path: Path) -> None:
        succeed("reproduce", "--runs", 1, "--methods", "spline,raw", "--cluster", running.address, "--out", tmp_path)
        own = run_study([SCENARIOS["tabulated"]], [METHODS["spline"], METHODS["raw"]], LEVELS, 1, 0)
        tables = pl.read_parquet(tmp_path / "study.parquet"), own
        first, second = (table.drop("seconds").sort("method", "level", "run") for table in tables)
        assert len(first) == 6
        assert first.equals(second)

    def test_dask_is_silent(self, running: DaskCluster) -> None:
        use = f"with cluster_workers({running.address!r}) as executor: executor.submit(int).result()"
        words = [sys.executable, "-c", f"from dynident.runtime.jobs.cluster import cluster_workers\n{use}"]
        done = subprocess.run(words, capture_output=True, text=True, timeout=HANGS, check=False)
        assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


class TestChanges:
    def test_other_software_is_refused(self, running: DaskCluster, tmp_path: Path) -> None:
        shutil.copytree(Path(dynident.__file__).parent, tmp_path / "src" / "dynident")
        with (tmp_path / "src" / "dynident" / "log.py").open("a") as file:
            file.write("# another\n")
        (tmp_path / "src" / "numpy-0.0.1.dist-info").mkdir()  # Dask warns of it
        (tmp_path / "src" / "numpy-0.0.1.dist-info" / "METADATA").write_text("Name: numpy\nVersion: 0.0.1\n")
        with cluster_workers(running.address) as executor:
            other = running.start_worker("--no-nanny", PYTHONPATH=str(tmp_path / "src"))
            running.require_workers(3)
            with pytest.raises(InputError, match=f"the code of dynident is .* on {socket.gethostname()}"):  # late
                deque(run_jobs(abs, iter(int, 1), executor), 0)
        told = refused(running.address)
        code, numpy = told.split("; ")
        assert re.search(r"the same: the code of dynident is \w+ here, \w+ on tcp://127.0.0.1:\d+$", code)
        assert re.match(rf"numpy is {re.escape(np.__version__)} here, 0.0.1 on tcp://127.0.0.1:\d+. Install", numpy)
        os.killpg(other.pid, signal.SIGKILL)
        running.require_workers(2)

    def test_no_worker_and_then_no_scheduler(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        with dask_scheduler(tmp_path) as alone:
            with monkeypatch.context() as context:
                context.setattr(cluster, "ANSWER_SECONDS", 0.5)
                assert f"has no worker; start some: dask worker {alone.address}" in refused(alone.address)
            (tmp_path / "src" / "dynident").mkdir(parents=True)
            (tmp_path / "src" / "dynident" / "__init__.py").touch()
            alone.start_worker("--no-nanny", PYTHONPATH=str(tmp_path / "src"))
            alone.require_workers(1)
            assert "cannot load this dynident (ModuleNotFoundError(\"No module named 'dynident.runtime'\"))" in refused(
                alone.address
            )
            alone.start_worker("--no-nanny")
            alone.require_workers(2)  # before the other one ends: one alone could be either
            alone.workers[0].kill()
            alone.require_workers(1)
            with cluster_workers(alone.address) as executor:
                done = run_jobs(sleeps, [0.1] * 10_000, executor)
                assert next(done).status is Status.OK
                os.killpg(alone.scheduler.pid, signal.SIGKILL)
                with pytest.raises(InputError, match=f"scheduler at {alone.address} has gone"):
                    deque(done, 0)


class TestAddress:
    def test_the_extra_is_named(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setitem(sys.modules, "distributed", None)
        assert re.search("package distributed; install it by: .*install.* distributed", refused("tcp://127.0.0.1:8786"))

    @pytest.mark.parametrize("address", ["cluster", "", "127.0.0.1", "http://127.0.0.1:8787", "tcp://127.0.0.1:a"])
    def test_one_that_cannot_be_read(self, address: str) -> None:
        told = refused(address)
        assert told.startswith(f"{address!r} is no address of a Dask scheduler: ")
        assert told.endswith("; give tcp://HOST:PORT.")

    def test_one_without_its_certificates(self) -> None:
        told = refused("tls://127.0.0.1:8786")
        assert told.startswith("'tls://127.0.0.1:8786' cannot be used: ")
        assert told.endswith("at distributed.comm.tls.")

    def test_one_that_nobody_answers(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(cluster, "ANSWER_SECONDS", 0.3)
        before = set(threading.enumerate())
        with socket.create_server(("127.0.0.1", 0)) as silent:  # accepts, and never says anything
            address = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
            assert f"no Dask scheduler answers at {address} within 0.3 s" in refused(address)
        assert f"no Dask scheduler answers at {address} within 0.3 s" in refused(address)  # nobody listens
        assert set(threading.enumerate()) <= before

    def test_that_of_a_worker(self, running: DaskCluster) -> None:
        worker = running.require_workers(2)[0]
        assert refused(worker) == f"at {worker} is no Dask scheduler but a Worker; its scheduler is {running.address}."


def test_each_difference_is_said_with_its_places() -> None:
    here = {"Python": "3.11", "numpy": "2.4.6", "dynident": "0.1.0"}
    many = {f"tcp://10.0.0.{number}:4000": {**here, "numpy": "2.4.5"} for number in range(9)}
    odd = {"tcp://10.0.1.1:4000": {**here, "numpy": "missing"}, "the scheduler": {"Python": "3.12"}}
    few = "tcp://10.0.0.0:4000, tcp://10.0.0.1:4000, tcp://10.0.0.2:4000 and 6 more"
    assert software_differences(here, many | odd) == [
        "Python is 3.11 here, 3.12 on the scheduler",
        f"numpy is 2.4.6 here, 2.4.5 on {few}, missing on tcp://10.0.1.1:4000",
    ]
