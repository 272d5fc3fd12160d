"""Only regular files and files of stores are read, within a budget of memory; nothing else ends in a traceback."""

import ast
import builtins
import os
import socket
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import fsspec
import pytest

import dynident as dy
from dynident.files.opener import (
    content,
    file_stamp,
    local_file,
    matching_files,
    open_input,
    read_text,
    refuse_inputs,
    set_memory,
    strip_scheme,
    watch_inputs,
)
from dynident.files.results import read_table, write_text
from dynident.files.tables import read_columns
from dynident.project.config import read_config, robot_text
from dynident.project.saved import load
from dynident.runtime import MEMORY_VARIABLE, DynidentError, InputError, memory_budget

READERS = {
    "yaml": read_config,
    "urdf": lambda path: robot_text(Path(path)),
    "json": load,
    **dict.fromkeys(("csv", "parquet", "npz", "mat", "h5", "bag", "db3", "mcap"), read_columns),
    "py": lambda path: dy.identify(f"{path}:arm", ()),
}


def odd(folder: Path, kind: str) -> dict[str, str]:
    """Return paths by what is wrong with them."""
    os.mkfifo(folder / f"pipe.{kind}")
    (folder / f"loop.{kind}").symlink_to(f"loop.{kind}")
    (folder / f"zero.{kind}").symlink_to("/dev/zero")
    with socket.socket(socket.AF_UNIX) as case:
        case.bind(str(folder / "s"))
    (folder / f"socket.{kind}").symlink_to("s")
    names = {name: str(folder / f"{name}.{kind}") for name in ("pipe", "loop", "zero", "socket", "missing")}
    (folder / "file").write_text("")
    return names | {
        "long": str(folder / ("y" * 5000 + f".{kind}")),
        "deep": str(folder / ("y/" * 2500 + f"x.{kind}")),
        "nul": str(folder / f"a\0b.{kind}"),
        "below a file": str(folder / "file" / f"a.{kind}"),
    }


OPENING = {"open", "read_bytes", "read_text", "fdopen", "loadmat", "genfromtxt", "fromfile"}
ALLOWED = {
    ("files/opener.py", "fdopen"),
    ("files/opener.py", "open"),
    ("files/folder.py", "open"),  # to write
    ("files/folder.py", "fdopen"),
    ("files/folder.py", "read_bytes"),  # the note of who holds a folder
    ("runtime/jobs/cluster.py", "read_bytes"),  # the sources of the package itself
    ("files/arrays.py", "open"),  # members of an archive that is open
    ("files/text.py", "open"),  # the null device
    ("cli/failures.py", "open"),  # the same
    ("cli/options.py", "open"),  # a method, of the log that is written
    ("files/results.py", "open"),  # to add to a log
    ("cli/options.py", "read_text"),  # files of the package itself
    ("apps/demo/files.py", "read_bytes"),
    ("apps/demo/arm.py", "read_text"),
    ("apps/excitation/players.py", "read_text"),  # files of the package itself
    ("project/arms.py", "read_text"),
    ("apps/excitation/player.py", "open"),  # a program that runs beside a robot, without this package
    ("runtime/kernel/__init__.py", "read_bytes"),
    ("runtime/kernel/__init__.py", "read_text"),
    ("runtime/kernel/build.py", "read_bytes"),
    ("runtime/kernel/build.py", "open"),  # to write
    ("files/ros.py", "open"),  # a compressed stream of a file that is open
}


def test_files_are_opened_in_one_place() -> None:
    root = Path(dy.__file__).parent
    result = set()
    for path in root.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(text)) if any(f"{name}(" in text for name in OPENING) else ():
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") != "read_text":  # that of the opener
                name = getattr(node.func, "attr", getattr(node.func, "id", ""))
                result |= {(path.relative_to(root).as_posix(), name)} if name in OPENING else set()
    assert result <= ALLOWED, result - ALLOWED


@pytest.mark.parametrize("kind", READERS)
def test_what_is_no_regular_file_is_refused_at_once(tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # the name of a socket must be short
    for what, path in odd(Path(), kind).items():
        start = time.process_time()
        with pytest.raises(DynidentError) as raised:
            READERS[kind](path)
        assert time.process_time() - start < 5, what
        assert len(str(raised.value)) < 1000, what
        assert "\0" not in str(raised.value)
        assert Path(path).stem[:50].replace("\0", "\\x00") in str(raised.value), what


def test_the_budget_is_that_of_the_run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv(MEMORY_VARIABLE, raising=False)
    assert memory_budget() == 4 * 10**9
    with watch_inputs():
        set_memory(2)
        with watch_inputs():
            assert memory_budget() == 2 * 10**9
    assert memory_budget() == 4 * 10**9
    (tmp_path / "text").write_bytes(bytes(700_000))
    with watch_inputs():
        set_memory(1e-3)  # a byte takes a byte, unless the caller says more
        assert len(read_text(tmp_path / "text")) == len(content(tmp_path / "text")) == 700_000
        with pytest.raises(InputError, match="--memory"):
            read_text(tmp_path / "text", weight=2)


def test_a_file_beyond_the_budget_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    with path.open("wb") as file:
        file.truncate(10**12)  # takes no room on the disk
    start = time.process_time()
    for read in (read_columns, content):
        with pytest.raises(InputError, match=r"more than the 4 GB that a file may take; raise this by --memory or DYN"):
            read(path)
    assert time.process_time() - start < 2
    with pytest.raises(InputError, match="--memory"), open_input(path):
        pass


def test_a_compressed_table_is_none(tmp_path: Path) -> None:
    import gzip

    (tmp_path / "t.csv").write_bytes(gzip.compress(b"1,2\n" * 1000))
    with pytest.raises(InputError, match="is not a readable table"):
        read_table(tmp_path / "t.csv")
    with pytest.raises(InputError, match="is not a text but a binary file"):
        read_columns(tmp_path / "t.csv")


def test_a_device_is_not_written_over(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", Path("/dev/null")):
        with pytest.raises(InputError, match=r"is a (named pipe|device), and no file that can be replaced"):
            write_text(path, "x")
        with pytest.raises(InputError):
            refuse_inputs(path)
    assert Path("/dev/null").is_char_device()


@pytest.fixture
def store() -> Iterator[Any]:
    """Files in memory, as in an object store."""
    result = fsspec.filesystem("memory")
    result.pipe({"/fleet/a/one.csv": b"t,q\n", "/fleet/b/two.csv": b"t,q\n1,2\n", "/fleet/b/c/three.csv": b""})
    yield result
    result.rm("/fleet", recursive=True)


@pytest.mark.usefixtures("store")
def test_files_of_a_store_are_listed_and_fetched(tmp_path: Path) -> None:
    result, _ = matching_files("memory://fleet/*/*.csv", tmp_path)
    assert [x.name for x in result] == ["memory:///fleet/a/one.csv", "memory:///fleet/b/two.csv"]
    assert [x.match_name for x in result] == ["/fleet/a/one.csv", "/fleet/b/two.csv"]
    assert strip_scheme("memory://fleet/{robot}/{date}.csv") == "/fleet/{robot}/{date}.csv"
    assert file_stamp(result[1].name, tmp_path) == result[1].stamp
    with local_file(result[1].name, tmp_path) as path:
        assert (path.name, path.read_bytes()) == ("two.csv", b"t,q\n1,2\n")
    assert not path.exists()


def test_a_stamp_changes_with_the_file(store: Any, tmp_path: Path) -> None:
    before = file_stamp("memory://fleet/a/one.csv", tmp_path)
    store.pipe("/fleet/a/one.csv", b"t,tau\n")
    assert file_stamp("memory://fleet/a/one.csv", tmp_path) != before
    (tmp_path / "a.csv").write_text("1")
    local = file_stamp("a.csv", tmp_path)
    (tmp_path / "a.csv").write_text("12")
    assert file_stamp("a.csv", tmp_path) != local


@pytest.mark.usefixtures("store")
def test_what_is_not_there_has_no_stamp_and_cannot_be_fetched(tmp_path: Path) -> None:
    assert file_stamp("none.csv", tmp_path) == file_stamp("memory://fleet/none.csv", tmp_path) == ""
    with pytest.raises(InputError, match="there is no such file"), local_file("memory://fleet/none.csv", tmp_path):
        pass


@pytest.mark.parametrize("address", ["nosuch://a/b.csv", "s3://bucket/{robot}.csv"])
def test_an_unknown_scheme_and_a_missing_package_are_named(
    address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import_module = builtins.__import__

    def without_s3(name: str, *given: Any, **how: Any) -> Any:
        if name.partition(".")[0] == "s3fs":
            raise ImportError(name)
        return import_module(name, *given, **how)

    monkeypatch.setattr(builtins, "__import__", without_s3)
    with pytest.raises(InputError, match=r"cannot be opened: .*(nosuch|s3fs)"):
        matching_files(address, tmp_path)


def test_a_store_that_does_not_answer_is_named(store: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object, **__: object) -> None:
        raise ConnectionError("refused")

    monkeypatch.setattr(type(store), "glob", refused)
    with pytest.raises(InputError, match=r"memory://fleet/.*: the store does not answer: ConnectionError: refused"):
        matching_files("memory://fleet/*", tmp_path)


def test_without_fsspec_what_to_install_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "fsspec.core", None)
    with pytest.raises(InputError, match=r"needs fsspec: .*install fsspec"):
        file_stamp("s3://bucket/a.csv", tmp_path)
