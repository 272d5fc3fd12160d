"""Whatever stops a run, a folder holds all files of one run, and no others than its user's."""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from dynident.files import folder as module
from dynident.files.folder import result_folder, settle, write_whole
from dynident.runtime import InputError

OLD = {"result.json": "old", "report.html": "old page", "arm.urdf": "old arm"}
NEW = {"result.json": "new", "report.html": "new page", "model.py": "new model"}
posix = pytest.mark.skipif(os.name == "nt", reason="POSIX signals and forks")


def content(folder: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in folder.iterdir()}


def failing(number: int, words: str) -> Callable[..., None]:
    """Stand in for a function of the system that fails."""

    def fail(*_: object) -> None:
        raise OSError(number, words)

    return fail


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """A folder with the result of an earlier run beside a file of the user's."""
    (tmp_path / "out").mkdir()
    for name, text in {**OLD, "thesis.tex": "mine"}.items():
        (tmp_path / "out" / name).write_text(text)
    return tmp_path / "out"


def write_new(folder: Path) -> None:
    with result_folder(folder) as held:
        held.replace(NEW, removed=["arm.urdf"])


@pytest.mark.parametrize("name", ["a\0b", "x" * 300])
def test_a_name_that_no_folder_can_have(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match=r"nothing can be written here|is no name of a file"):
        write_new(tmp_path / name)


# Ends a process at its k-th change of the file system, for every k, as kill -9 would: no `finally` is run.
KILLED = """
import os, shutil, sys
from pathlib import Path
from dynident.files import folder as module
from dynident.files.folder import result_folder, settle, write_whole

def changes(names):
    for name in names:
        real = getattr(os, name)
        def counted(*given, real=real, **more):
            global left
            left -= 1
            if left < 0:
                os._exit(9)
            return real(*given, **more)
        setattr(os, name, counted)

def content(folder):
    return {path.name: path.read_text() for path in folder.iterdir()}

OLD, NEW, action = eval(sys.argv[2]), eval(sys.argv[3]), sys.argv[4]
out, ends, k = Path(sys.argv[1]), [], 0
while True:
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir()
    for name, text in OLD.items():
        (out / name).write_text(text)
    child = os.fork()
    if not child:
        left = k
        changes(["open", "mkdir", "rename", "replace", "unlink", "rmdir", "fsync"])
        if action == "folder":
            with result_folder(out) as held:
                held.replace(NEW, removed=["arm.urdf"])
        else:
            write_whole(out / "result.json", b"new")
        os._exit(0)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    settle(out)
    seen = {name: text for name, text in content(out).items() if not name.startswith(".")}
    with result_folder(out):
        pass
    assert content(out) == seen, (k, content(out))
    ends.append("old" if seen == OLD else "new" if seen == NEW else "mixed")
    if code == 0:
        break
    assert code == 9, code
    k += 1
print(*ends)
"""


@posix
@pytest.mark.parametrize("action", ["folder", "file"])
def test_a_kill_at_any_moment_leaves_the_old_files_or_the_new(tmp_path: Path, action: str) -> None:
    new = NEW if action == "folder" else {**OLD, "result.json": "new"}
    words = [sys.executable, "-c", KILLED, str(tmp_path / "out"), repr(OLD), repr(new), action]
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    ends = done.stdout.split()
    assert len(ends) > (30 if action == "folder" else 3)
    assert ends == sorted(ends, reverse=True)  # old up to one moment, new from there
    assert set(ends) == {"old", "new"}


@pytest.mark.parametrize("change", ["fsync", "mkdir", "rename"])
def test_a_full_disk_changes_nothing(out: Path, monkeypatch: pytest.MonkeyPatch, change: str) -> None:
    words = r"out: .* cannot be written: No space left on device; .* as they were"
    with result_folder(out) as held, monkeypatch.context() as patch:
        patch.setattr(os, change, failing(28, "No space left on device"))
        for _ in range(2):
            with pytest.raises(InputError, match=words):
                held.replace(NEW, removed=["arm.urdf"])
    assert content(out) == {**OLD, "thesis.tex": "mine"}


@pytest.mark.parametrize("at", range(4))
def test_an_interrupt_while_files_move_lets_them_arrive(out: Path, monkeypatch: pytest.MonkeyPatch, at: int) -> None:
    real, count = os.replace, iter(range(100))

    def interrupted(*given: Path) -> None:
        if next(count) == at:
            raise KeyboardInterrupt
        real(*given)

    monkeypatch.setattr(os, "replace", interrupted)
    if at < len(NEW):
        with pytest.raises(KeyboardInterrupt) as stop:
            write_new(out)
        assert stop.value.__notes__ == [f"{out}: the new files are in place."]
    else:
        write_new(out)
    assert content(out) == {**NEW, "thesis.tex": "mine"}


def test_an_interrupt_before_leaves_the_old_files(out: Path) -> None:
    with pytest.raises(KeyboardInterrupt) as stop, result_folder(out):
        raise KeyboardInterrupt
    assert stop.value.__notes__ == [f"{out}: the files here are as they were; run the same command again."]
    assert content(out) == {**OLD, "thesis.tex": "mine"}


@pytest.mark.parametrize("place", ["../other", "folder", "{absolute}", ""])
def test_only_files_of_the_folder_are_written(out: Path, place: str) -> None:
    name = place.format(absolute=out.parent / "other")
    (out / "folder").mkdir()
    with result_folder(out) as held:
        with pytest.raises(InputError, match="it is a folder, or in another one"):
            held.replace({"result.json": "new", name: "x"})
        with pytest.raises(InputError, match="it is a folder, or in another one"):
            held.replace({"result.json": "new"}, removed=[name])
    (out / "folder").rmdir()
    assert content(out) == {**OLD, "thesis.tex": "mine"}


class TestLock:
    def test_the_second_run_is_told_who_holds_the_folder(self, out: Path) -> None:
        with result_folder(out):
            with pytest.raises(InputError, match=rf"another run writes here \(process {os.getpid()} on .* since 2"):
                write_new(out)
            write_whole(out / "study.parquet", b"rows")  # as the run that holds it does
        assert (out / "study.parquet").exists()
        write_new(out)  # and it is free again

    def test_it_ends_with_its_process(self, out: Path) -> None:
        script = (
            "import sys, time\nfrom dynident.files.folder import result_folder\n"
            "with result_folder(sys.argv[1]):\n    print('held', flush=True)\n    time.sleep(60)\n"
        )
        words = [sys.executable, "-c", script, str(out)]
        with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout.readline() == "held\n"
            with pytest.raises(InputError, match=rf"process {process.pid} on"):
                write_new(out)
            process.kill()
        assert (out / module.LOCK_NAME).exists()
        write_new(out)
        assert content(out) == {**NEW, "thesis.tex": "mine"}

    def test_a_file_system_without_locks_will_do(self, out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        fcntl = pytest.importorskip("fcntl", reason="Windows has other locks")
        monkeypatch.setattr(fcntl, "flock", failing(38, "Function not implemented"))
        (other := out / f".dynident-{'0' * 32}.tmp").write_text("of a run that may live")
        write_new(out)
        assert content(out) == {**NEW, "thesis.tex": "mine", other.name: "of a run that may live"}

    @posix
    def test_a_link_in_its_place_is_not_followed(self, out: Path) -> None:
        (out / module.LOCK_NAME).symlink_to("thesis.tex")
        with pytest.raises(InputError, match="nothing can be written here"):
            write_new(out)
        assert (out / "thesis.tex").read_text() == "mine"


@pytest.fixture
def half_done(out: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A folder in which a run was killed when it had moved one file of three."""
    with monkeypatch.context() as patch:
        patch.setattr(module, "_finish", lambda folder: None)
        write_new(out)
    os.replace(out / module.READY_NAME / module.NEW_FILES / "model.py", out / "model.py")
    return out


class TestSettle:
    def test_whoever_reads_next_moves_the_rest_also_of_a_copy(self, half_done: Path, tmp_path: Path) -> None:
        for folder in (shutil.copytree(half_done, tmp_path / "copy"), half_done):
            settle(folder)
            assert content(folder) == {**NEW, "thesis.tex": "mine"}

    def test_where_it_cannot_be_done_that_is_said(self, half_done: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(os, "open", failing(30, "Read-only file system"))
        with pytest.raises(
            InputError, match=r"files of two runs lie here.*Read-only file system.*run the same command"
        ):
            settle(half_done)

    def test_a_folder_that_is_only_read_needs_no_rights(self, out: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        (out / module.LOCK_NAME).write_text("process 1")  # left by a run that wrote nothing
        monkeypatch.setattr(os, "open", failing(30, "Read-only file system"))
        settle(out)

    def test_files_that_are_being_moved_are_waited_for(self, half_done: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(module, "PATIENCE", 0.1)
        lock = module._lock_folder(half_done)
        with pytest.raises(InputError, match="another run writes here"):
            settle(half_done)
        module._release(lock, half_done / module.LOCK_NAME)
        settle(half_done)
        assert content(half_done) == {**NEW, "thesis.tex": "mine"}

    @posix
    def test_a_link_to_another_folder_moves_nothing(self, out: Path, tmp_path: Path) -> None:
        (tmp_path / "other" / module.NEW_FILES).mkdir(parents=True)
        (tmp_path / "other" / module.NEW_FILES / "thesis.tex").write_text("another")
        (out / module.READY_NAME).symlink_to(tmp_path / "other")
        with pytest.raises(InputError, match="cannot be moved"):
            settle(out)
        assert (out / "thesis.tex").read_text() == "mine"


def test_temporary_files_of_dead_runs_are_removed_and_those_of_living_ones_kept(tmp_path: Path) -> None:
    dead, alive, mine = (
        tmp_path / name for name in (f".dynident-{'0' * 32}.tmp", f".dynident-{'1' * 32}.tmp", "a.tmp")
    )
    dead.write_text("x")
    mine.write_text("x")
    file = module._open_locked(alive)
    write_whole(tmp_path / "r.txt", b"x")
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([alive.name, "a.tmp", "r.txt"])
    file.close()
    write_new(tmp_path)
    assert not alive.exists()


def test_a_temporary_file_that_another_run_sweeps_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    swept, lock = [BlockingIOError], module._lock

    def busy(descriptor: int) -> bool:
        if swept:
            raise swept.pop()
        return lock(descriptor)

    monkeypatch.setattr(module, "_lock", busy)
    write_whole(tmp_path / "a.txt", b"all of it")
    assert not swept
    assert (tmp_path / "a.txt").read_bytes() == b"all of it"
