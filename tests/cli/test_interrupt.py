"""Signals to stop: one line, an exit code, and nothing left of them."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

from dynident.cli import interrupt
from tests.cli.commands import configure, run, write_log

pytestmark = pytest.mark.skipif(os.name == "nt", reason="sends POSIX signals")


@pytest.mark.parametrize(("name", "code"), [("SIGINT", 130), ("SIGTERM", 143), ("SIGHUP", 129)])
def test_a_signal_is_said_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, code: int) -> None:
    number, before = getattr(signal, name), signal.getsignal(getattr(signal, name))
    monkeypatch.setattr("dynident.io.project.run", lambda *_, **__: os.kill(os.getpid(), number))
    write_log(tmp_path)
    done = run("identify", configure(tmp_path), "--out", tmp_path / "out")
    assert done.exit_code == code
    kept = f"Interrupted: {tmp_path / 'out'}: the files here are as they were. Run the same command again.\n"
    assert done.output == kept
    assert not (tmp_path / "out").exists()
    done = run("identify", configure(tmp_path))
    assert done.output == "Interrupted: each file is as it was or complete. Run the same command again.\n"
    assert signal.getsignal(number) is before


def test_a_signal_that_is_ignored_stays_so() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)  # as nohup does
    try:
        with interrupt.interruptible():
            os.kill(os.getpid(), signal.SIGHUP)
    finally:
        signal.signal(signal.SIGHUP, before)
