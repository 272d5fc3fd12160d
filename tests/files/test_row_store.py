"""Rows of long work in a file that grows: added as they come, whole in the end, and found again after a crash."""

import errno
import os
import threading
import time
from collections.abc import Callable
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import polars as pl
import pytest

from dynident.files import row_store
from dynident.files.row_store import RowStore
from dynident.runtime import InputError
from dynident.runtime.jobs import JobOptions
from tests.files.test_folder import failing

SCHEMA = {"name": pl.String, "level": pl.Float64, "run": pl.Int64, "status": pl.String, "value": pl.List(pl.Float64)}
KEY = ("name", "level", "run")


def row(run: int, status: str = "ok", value: float = 0.1) -> dict[str, Any]:
    return {"name": "ä", "level": 1e-6, "run": run, "status": status, "value": [value * run, float("inf"), -0.0]}


def key(run: int) -> tuple[Any, ...]:
    return ("ä", 1e-6, run)


def store(path: Path | None, **options: Any) -> RowStore:
    return RowStore(path, SCHEMA, KEY, **options)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "t.parquet"


def killed(path: Path, *rows: dict[str, Any], **options: Any) -> None:
    """Add rows, each in a part of its own, and stop without an end."""
    table = store(path, **options).__enter__()
    for test_row in rows:
        table.add([test_row])
        table.save()
    table._timer.cancel()
    table._held.pop_all()  # and nobody has the lock


def runs(table: pl.DataFrame) -> list[int]:
    return table["run"].to_list()


def values(table: RowStore) -> list[tuple[int, float]]:
    return list(table.table().select("run", pl.col("value").list.first()).iter_rows())


def parts(path: Path) -> list[Path]:
    return sorted(path.with_name("t.parquet.parts").glob("*.parquet"))


@pytest.mark.parametrize("kept", [True, False])
def test_rows_come_back_as_they_were(path: Path, kept: bool) -> None:
    rows = [row(run) for run in range(5)]
    with store(path if kept else None) as table:
        table.add(rows[:2])
        table.add(rows[2:])
        assert key(4) in table
        assert key(5) not in table
        assert len(table) == 5
        assert repr(table.table().to_dicts()) == repr(rows)
    assert repr(table.table().to_dicts()) == repr(rows)
    assert list(path.parent.iterdir()) == ([path] if kept else [])
    if kept:
        assert pl.read_parquet(path).equals(table.table())
        with store(path) as again:
            assert len(again) == 5
            assert key(3) in again
        assert repr(again.table().to_dicts()) == repr(rows)


def test_a_later_row_replaces_an_earlier_one_wherever_that_is(path: Path) -> None:
    with store(path) as table:
        table.add([row(0), row(1), row(2)])
    killed(path, row(0, value=1.0), row(3))
    with store(path) as table:
        table.add([row(1, value=2.0), row(4), row(4, value=3.0)])
        table.add([row(3, value=4.0)])
        assert len(table) == 5
        result = dict(values(table))
    assert result == {0: 0.0, 1: 2.0, 2: 0.2, 3: 12.0, 4: 12.0}
    assert sorted(runs(pl.read_parquet(path))) == [0, 1, 2, 3, 4]


def test_rows_are_saved_without_a_further_call(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The next row of slow work may come in an hour."""
    monkeypatch.setattr(row_store, "SAVE_EVERY", 0.01)
    with store(path) as table:
        table.add([row(0)])
        deadline = time.monotonic() + 60
        while not parts(path) and time.monotonic() < deadline:
            time.sleep(0.01)
        assert runs(pl.read_parquet(parts(path)[0])) == [0]
        assert not path.exists()


def test_many_rows_do_not_wait(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(row_store, "MAX_UNSAVED_ROWS", 10)
    with store(path) as table:
        table.add(row(run) for run in range(25))
        assert len(parts(path)) == 2
        assert len(table._new) == 5
    assert runs(pl.read_parquet(path)) == list(range(25))


@pytest.mark.parametrize("stop", [KeyboardInterrupt, ValueError])
def test_whatever_stops_a_run_its_rows_are_kept(path: Path, stop: type[BaseException]) -> None:
    def stopped() -> None:
        with store(path) as table:
            table.add([row(0)])
            table.save()
            table.add([row(1)])
            raise stop

    with pytest.raises(stop):
        stopped()
    assert runs(pl.read_parquet(path)) == [0, 1]
    assert list(path.parent.iterdir()) == [path]
    timers = [thread for thread in threading.enumerate() if isinstance(thread, threading.Timer)]
    assert all(timer.finished.is_set() for timer in timers)  # a thread that was told to end may still be there


@pytest.mark.parametrize(
    ("rows", "kept"), [((), "No row was finished; run"), ((row(0),), "Finished rows are kept in .*")]
)
def test_what_is_kept_of_a_stopped_run_is_told(
    path: Path, monkeypatch: pytest.MonkeyPatch, rows: tuple[dict[str, Any], ...], kept: str
) -> None:
    monkeypatch.setattr(row_store, "run_jobs", lambda *_, **__: map(_refuse, "a"))
    with store(path) as table:
        table.add(rows)
        with pytest.raises(InputError, match=rf"no room\. {kept}"):
            table.fill(int, [5], key, lambda _: (), JobOptions(), "estimating")


def _refuse(_: str) -> None:
    raise InputError("no room.")


@pytest.mark.parametrize("is_written", [False, True])
def test_a_run_that_is_stopped_while_it_saves(path: Path, monkeypatch: pytest.MonkeyPatch, is_written: bool) -> None:
    """Before or after a part is written: each row once, and of those with one key the last."""
    killed(path, row(0), row(1))

    def interrupted(path: Path, frame: pl.DataFrame) -> Path:
        monkeypatch.undo()
        if is_written:
            row_store.write_table(path, frame)
        raise KeyboardInterrupt

    def stopped() -> None:
        with store(path) as table:
            table.add([row(1, value=2.0), row(2), row(0, value=3.0)])
            monkeypatch.setattr(row_store, "write_table", interrupted)
            table.save()

    with pytest.raises(KeyboardInterrupt):
        stopped()
    with store(path) as table:
        assert len(table) == 3
    assert sorted(values(table)) == [(0, 0.0), (1, 2.0), (2, 0.2)]
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize("left", range(4))
def test_a_run_that_is_killed_while_it_removes_the_parts(
    path: Path, monkeypatch: pytest.MonkeyPatch, left: int
) -> None:
    """The table is whole by then; of a key in several parts the last row counts."""
    killed(path, row(0, value=1.0), row(1), row(1, value=5.0))
    unlink, count = Path.unlink, iter(range(99))

    def stop(self: Path, missing_ok: bool = False) -> None:
        if self.suffix == ".parquet" and next(count) == left:
            raise KeyboardInterrupt
        unlink(self, missing_ok)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "unlink", stop)
        with pytest.raises(KeyboardInterrupt) if left < 3 else nullcontext(), store(path):
            pass
    assert len(parts(path)) == 3 - left
    with store(path) as table:
        assert len(table) == 2
    assert sorted(values(table)) == [(0, 0.0), (1, 5.0)]
    assert list(path.parent.iterdir()) == [path]


def test_what_failed_or_is_to_be_done_again_is_not_known(path: Path) -> None:
    with store(path) as table:
        table.add([row(0), row(1, "failed"), row(2, "died")])
        assert len(table) == 3  # of this run they are
    again = {"status": ("failed", "died")}
    with store(path, retried=again) as table:
        assert (len(table), key(0) in table, key(1) in table) == (1, True, False)
        assert sorted(runs(table.table())) == [0, 1, 2]  # what is not done again stays
        table.add([row(1)])
        assert key(1) in table
    assert sorted(zip(*pl.read_parquet(path)["run", "status"], strict=True)) == [(0, "ok"), (1, "ok"), (2, "died")]
    with store(path, rerun=True) as table:
        assert (len(table), key(0) in table) == (0, False)
        table.add([row(0, value=7.0)])
        assert (len(table), key(0) in table) == (1, True)
    assert sorted(runs(pl.read_parquet(path))) == [0, 1, 2]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda table: table.drop("status"), r"no column 'status' \(columns name, level, run, value\)"),
        (lambda table: table.with_columns(run=pl.lit(1.0)), "'run' holds Float64, not Int64"),
        (lambda table: table.with_columns(mine=pl.lit(1)), "'mine' is not known"),
        (lambda table: table.with_columns(name=pl.lit(None, pl.String)), "'name' has empty cells"),
        (lambda table: pl.concat([table, table]), "a row stands in it twice"),
    ],
)
@pytest.mark.parametrize("part", [True, False])
def test_a_file_of_something_else_is_named_and_stays(path: Path, change: Any, words: str, part: bool) -> None:
    killed(path, row(0))
    if not part:
        with store(path):
            pass
    file = parts(path)[0] if part else path
    change(pl.read_parquet(file)).write_parquet(file)
    before = file.read_bytes()
    with pytest.raises(InputError, match=f"{file.name}: holds other rows: .*{words}"), store(path):
        pass
    assert file.read_bytes() == before


@pytest.mark.parametrize("at", [0, 4, 40, -200, -20, -4])
def test_a_damaged_part_is_named_and_the_rest_goes_on_without_it(path: Path, at: int) -> None:
    killed(path, row(0), row(1), row(2))
    file = parts(path)[1]
    data = bytearray(file.read_bytes())
    data[at : at + 4 or None] = b"\xff" * 4
    file.write_bytes(data)
    try:
        with store(path) as table:
            assert len(table) == 3
    except InputError as error:
        assert f"{file}: is not a readable table" in str(error)  # noqa: PT017 -- damage may lie where nothing is read
        assert len(parts(path)) == 3
        file.unlink()
    else:
        return
    with store(path) as table:
        assert len(table) == 2


def test_files_of_others_in_the_folder_of_the_parts_stay(path: Path) -> None:
    path.with_name("t.parquet.parts").mkdir()
    mine = path.with_name("t.parquet.parts") / "mine.parquet"
    mine.write_text("mine")
    with store(path) as table:
        table.add([row(0)])
    assert mine.read_text() == "mine"
    assert runs(pl.read_parquet(path)) == [0]


def test_a_run_is_told_why_it_cannot_work_there(path: Path) -> None:
    with pytest.raises(InputError, match=r"t\.csv: rows are kept in Parquet"), store(path.with_suffix(".csv")):
        pass
    with store(path) as table:
        table.add([row(0)])
        with pytest.raises(InputError, match=f"another run writes here .process {os.getpid()} on "), store(path):
            pass
        table.add([row(1)])
    assert runs(pl.read_parquet(path)) == [0, 1]
    with store(None) as table, pytest.raises(ValueError, match=r"no columns .'mine'"):
        table.add([row(0) | {"mine": 1}])


def test_a_full_disk_stops_the_work_and_what_is_there_stays(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    killed(path, row(0))
    monkeypatch.setattr(row_store, "SAVE_EVERY", 0.01)

    def work() -> None:
        deadline = time.monotonic() + 60
        with store(path) as table:
            monkeypatch.setattr(os, "fsync", failing(errno.ENOSPC, "No space left on device"))
            while time.monotonic() < deadline:
                table.add([row(1)])
                time.sleep(0.01)

    with pytest.raises(InputError, match=r"cannot be written: No space left on device\. Make room"):
        work()
    assert len(parts(path)) == 1
    monkeypatch.undo()
    with store(path) as table:
        assert len(table) == 1
        table.add([row(1)])
    assert runs(pl.read_parquet(path)) == [0, 1]
    assert list(path.parent.iterdir()) == [path]


def test_files_that_can_no_longer_grow(path: Path) -> None:
    """The same by the operating system, for a part and, through Polars, for the table."""
    resource = pytest.importorskip("resource", reason="Windows has no such limit")
    usual = resource.getrlimit(resource.RLIMIT_FSIZE)

    def refused(write: Callable[[], None], words: str) -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (500, usual[1]))
        try:
            with pytest.raises(InputError, match=words):
                write()
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, usual)

    with store(path) as table:
        table.add([row(0)])
        refused(table.save, r"0001-\w+\.parquet: cannot be written: File too large\. Make room")
        table.save()
        refused(table._merge, r"t\.parquet: cannot be written: .*File too large.*; all rows are kept in")
        assert len(parts(path)) == 1
        assert not path.exists()
    assert runs(pl.read_parquet(path)) == [0]
