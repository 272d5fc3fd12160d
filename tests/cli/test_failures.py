"""How a command ends that fails or is told to stop: one message, an exit code, no traceback unless it is asked for."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner, Result

from dynident._version import __version__
from dynident.cli import failures as interrupt
from dynident.cli import main
from dynident.runtime import InputError
from tests.cli.commands import configure, run, write_log
from tests.robots import ARM

INTERRUPTED = "Interrupted: each file is as it was or complete; run the same command again.\n"


def failing(monkeypatch: pytest.MonkeyPatch, error: BaseException, *arguments: str, **env: str) -> Result:
    def fail(*_: Any, **__: Any) -> None:
        raise error

    monkeypatch.setattr("dynident.project.project.read_project", fail)
    return CliRunner().invoke(main, [*arguments, "identify", "a.yaml"], env=env)


class Panic(BaseException):
    """Like the panics of libraries written in Rust, which are no ``Exception``."""


@pytest.mark.parametrize(
    "error",
    [KeyError("x"), ValueError("a\nb"), RecursionError("deep"), Panic("rust"), AssertionError(), OSError(1, "no")],
)
def test_a_fault_is_one_line_that_says_what_to_report(monkeypatch: pytest.MonkeyPatch, error: BaseException) -> None:
    done = failing(monkeypatch, error)
    assert done.exit_code == 70
    assert done.output.startswith(f"Error: dynident failed with {type(error).__name__}")
    assert done.output.count("\n") == 1
    version = f"dynident {__version__}"
    for words in ("a fault of dynident", version, "Python 3.", "--debug", " at cli/identification.py:"):
        assert words in done.output, done.output


def test_without_a_command_the_help_is_shown() -> None:
    alone, asked = CliRunner().invoke(main, []), CliRunner().invoke(main, ["--help"])
    assert (alone.exit_code, asked.exit_code) == (2, 0)
    assert alone.output == asked.output
    assert "identify" in asked.output
    assert CliRunner().invoke(main, ["identfy"]).exit_code == 2


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no limit of the address space")
def test_too_small_an_address_space_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """OpenBLAS would try without end to get its buffers; help needs none of it."""
    import resource

    monkeypatch.setattr(resource, "getrlimit", lambda _: (1_200_000_000, resource.RLIM_INFINITY))
    done = CliRunner().invoke(main, ["check", "a.yaml"])
    assert done.exit_code == 1
    assert done.output.startswith("Error: the address space is limited to 1.2 GB (`ulimit -v`); dynident")
    assert done.output.count("\n") == 1
    for words in (["--help"], ["--version"], *([name, "--help"] for name in main.commands)):
        assert CliRunner().invoke(main, words).exit_code == 0, words
    done = CliRunner().invoke(main, [], env={"_DYNIDENT_COMPLETE": "bash_source"}, prog_name="dynident")
    assert (done.exit_code, "complete" in done.output) == (0, True)
    monkeypatch.setattr(resource, "getrlimit", lambda _: (resource.RLIM_INFINITY,) * 2)
    assert "no such file" in CliRunner().invoke(main, ["check", "a.yaml"]).output
    monkeypatch.delattr(resource, "RLIMIT_AS")  # as on OpenBSD
    assert "no such file" in CliRunner().invoke(main, ["check", "a.yaml"]).output


def test_the_traceback_is_printed_on_request(monkeypatch: pytest.MonkeyPatch) -> None:
    for done in (
        failing(monkeypatch, KeyError("\x1b[31mx"), "--debug"),
        failing(monkeypatch, KeyError("\x1b[31mx"), DYNIDENT_DEBUG="1"),
    ):
        assert done.exit_code == 70
        assert "Traceback" in done.output
        assert "identification.py" in done.output
        assert "\x1b" not in done.output
    wrong = failing(monkeypatch, InputError("no such file"), "--debug")
    assert wrong.exit_code == 1
    assert "Traceback" in wrong.output
    assert wrong.output.endswith("Error: no such file\n")


def test_memory_is_not_a_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    done = failing(monkeypatch, MemoryError("Unable to allocate 7 TiB"))
    assert done.exit_code == 1
    assert done.output.startswith(
        "Error: there is not enough memory (Unable to allocate 7 TiB); use a shorter `window`"
    )


def test_a_pipe_that_its_reader_closed_is_no_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    done = failing(monkeypatch, BrokenPipeError(32, "Broken pipe"))
    assert (done.exit_code, done.output) == (1, "")


def test_the_library_raises_as_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """For programs that call the command in their own process."""
    with pytest.raises(click.ClickException, match="cannot be read"):
        main.main(["identify", "a.yaml"], standalone_mode=False)


def command(*words: object, **how: Any) -> subprocess.Popen[str]:
    line = [sys.executable, "-m", "dynident", *map(str, words)]
    return subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **how)


def robot(folder: Path) -> Path:
    """A robot file, which a command checks with less to import than a configuration."""
    (folder / "arm.urdf").write_text(ARM)
    return folder / "arm.urdf"


def test_a_reader_that_has_seen_enough(tmp_path: Path) -> None:
    """``dynident check ... | head -1``; it closes the pipe while more is to come."""
    for words in (("check", *[robot(tmp_path)] * 4), ("--help",)):
        with command(*words) as process:
            process.stdout.readline()
            process.stdout.close()
            assert process.stderr.read() == ""
            assert process.wait() in (0, 1)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no device that is always full")
@pytest.mark.parametrize("arguments", [["--help"], ["check", "arm.urdf"]], ids=str)
def test_a_full_output_is_no_fault(tmp_path: Path, arguments: list[str]) -> None:
    robot(tmp_path)
    with open("/dev/full", "w") as full:
        command = [sys.executable, "-m", "dynident", *arguments]
        ended = subprocess.run(command, cwd=tmp_path, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert (ended.returncode, ended.stderr) == (1, "Error: the output cannot be written: No space left on device.\n")


@pytest.mark.skipif(sys.platform == "win32", reason="closes the output by a shell")
def test_a_closed_output_is_no_fault(tmp_path: Path) -> None:
    command = f"{sys.executable} -m dynident check {robot(tmp_path).name} <&- >&- 2>&-"
    assert subprocess.run(["sh", "-c", command], cwd=tmp_path, check=False).returncode == 0


@pytest.mark.skipif(sys.platform == "win32", reason="closes standard error by a shell")
def test_no_file_gets_the_number_of_a_closed_standard_error(tmp_path: Path) -> None:
    """Reading Parquet in threads opens files, and redirects standard error: it would hang."""
    (tmp_path / "opens.py").write_text(
        "import click, os\nfrom dynident.cli.failures import Commands\n"
        "opens = click.Command('opens', callback=lambda: exit(os.open('.', os.O_RDONLY)))\n"
        "Commands(commands=[opens])(['opens'])\n"
    )
    command = f"{sys.executable} opens.py 2>&-"
    assert subprocess.run(["sh", "-c", command], cwd=tmp_path, check=False).returncode > 2


def test_an_interrupt_while_a_class_is_made(tmp_path: Path) -> None:
    """``exec`` of a text, in which dataclasses are made, has ``python -m`` end by the signal itself."""
    (tmp_path / "interrupted.py").write_text(
        "import signal\nfrom dynident.cli.failures import interruptible\n"
        "with interruptible():\n    exec('signal.raise_signal(signal.SIGINT)')\n"
    )
    ended = subprocess.run([sys.executable, "-m", "interrupted"], cwd=tmp_path, capture_output=True, check=False)
    assert (ended.returncode, ended.stderr.decode()) == (130, INTERRUPTED)


def test_an_interrupt_from_outside(tmp_path: Path) -> None:
    with command("check", *[robot(tmp_path)] * 2000) as process:
        process.stdout.readline()
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate()
    assert process.returncode == 130, errors
    assert errors == INTERRUPTED


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
