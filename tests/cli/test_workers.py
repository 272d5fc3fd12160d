"""Options that spread the work of a command."""

from __future__ import annotations

import os
import socket

import click
import pytest
from click.testing import CliRunner

from dynident.cli.options import WorkerOptions, add_worker_options, available_cores
from dynident.runtime.jobs import Limits, cluster, run_jobs
from tests.cli.commands import run
from tests.runtime.jobs.work import process


@click.command()
@add_worker_options
@click.option("--last")
def command(spread: WorkerOptions, last: str | None) -> None:
    click.echo(repr(spread))


def asked(*words: str) -> str:
    done = CliRunner().invoke(command, words)
    assert done.exit_code == 0, done.output
    return done.output.strip()


def test_options_become_a_spread() -> None:
    assert asked() == repr(WorkerOptions(available_cores()))
    assert asked("--workers", "3", "--time-limit", "0.5") == repr(WorkerOptions(3, None, 0.5))
    assert asked("--cluster", "tcp://a:1", "--worker-memory", "2") == repr(
        WorkerOptions(available_cores(), "tcp://a:1", None, 2.0)
    )
    assert WorkerOptions(1, seconds=2.0, memory=3.0).limits == Limits(2.0, 3.0)


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="the system does not bind processes to cores")
def test_cores_are_those_that_may_be_used() -> None:
    before = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, {min(before)})
        assert available_cores() == 1
    finally:
        os.sched_setaffinity(0, before)


@pytest.mark.parametrize("words", [("--workers", "0"), ("--time-limit", "0"), ("--worker-memory", "-1")])
def test_numbers_are_positive(words: tuple[str, str]) -> None:
    done = CliRunner().invoke(command, words)
    assert done.exit_code == 2
    assert f"Invalid value for '{words[0]}'" in done.output


def test_workers_and_a_cluster_are_two_ways() -> None:
    done = CliRunner().invoke(command, ["--workers", "2", "--cluster", "tcp://a:1"])
    assert done.exit_code == 2
    assert "give one of them" in done.output


def test_one_worker_without_limits_is_this_process() -> None:
    with WorkerOptions(1).executor() as executor:
        assert executor is None
    with WorkerOptions(1, seconds=600.0).executor() as executor:
        (done,) = run_jobs(process, [0], executor)
    assert done.value not in (None, os.getpid())


def test_a_cluster_that_does_not_answer_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cluster, "ANSWER_SECONDS", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        address = f"tcp://127.0.0.1:{silent.getsockname()[1]}"
        done = run("reproduce", "--runs", 1, "--cluster", address)
    assert done.exit_code == 1
    assert f"no Dask scheduler answers at {address}" in done.output
    assert "no run is" not in done.output  # it was not begun
