"""Signals to stop: one line, an exit code, and nothing left of them."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from dynident.cli import failures as interrupt
from tests.cli.commands import configure, run, write_log

pytestmark = pytest.mark.skipif(os.name == "nt", reason="sends POSIX signals")


@pytest.fixture
def signals() -> Iterator[None]:
    """Signals as in a terminal: a shell in the background has SIGINT ignored."""
    usual = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL, signal.SIGHUP: signal.SIG_DFL}
    before = {number: signal.signal(number, handler) for number, handler in usual.items()}
    yield
    assert {number: signal.getsignal(number) for number in usual} == usual
    for number, handler in before.items():
        signal.signal(number, handler)


@pytest.mark.parametrize(("name", "code"), [("SIGINT", 130), ("SIGTERM", 143), ("SIGHUP", 129)])
@pytest.mark.usefixtures("signals")
def test_a_signal_is_said_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, code: int) -> None:
    monkeypatch.setattr(
        "dynident.project.project.identify", lambda *_, **__: os.kill(os.getpid(), getattr(signal, name))
    )
    write_log(tmp_path)
    done = run("identify", configure(tmp_path), "--out", tmp_path / "out")
    assert done.exit_code == code
    kept = f"Interrupted: {tmp_path / 'out'}: the files here are as they were; run the same command again.\n"
    assert done.output == kept
    assert not (tmp_path / "out").exists()
    done = run("identify", configure(tmp_path))
    assert done.output == "Interrupted: each file is as it was or complete; run the same command again.\n"


def test_a_signal_that_is_ignored_stays_so() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)  # as nohup does
    try:
        with interrupt.interruptible():
            os.kill(os.getpid(), signal.SIGHUP)
    finally:
        signal.signal(signal.SIGHUP, before)


@pytest.mark.parametrize(("name", "code"), [("SIGTERM", 143), ("SIGHUP", 129)])
@pytest.mark.usefixtures("signals")
def test_a_signal_that_would_kill_closes_what_is_open(name: str, code: int) -> None:
    closed, number = [], getattr(signal, name)

    def work() -> None:
        try:
            assert signal.getsignal(number) is not signal.SIG_DFL
            os.kill(os.getpid(), number)
        finally:
            closed.append(name)

    with pytest.raises(SystemExit) as stopped, interrupt.interruptible():
        work()
    assert (stopped.value.code, closed) == (code, [name])
