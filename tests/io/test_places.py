"""Files by path and by address."""

from __future__ import annotations

import builtins
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import fsspec
import pytest

from dynident.errors import InputError
from dynident.io.places import is_address, local_file, matching, placed, stamp_of


@pytest.fixture
def store() -> Iterator[Any]:
    """Files in memory, as in an object store."""
    found = fsspec.filesystem("memory")
    found.pipe({"/fleet/a/one.csv": b"t,q\n", "/fleet/b/two.csv": b"t,q\n1,2\n", "/fleet/b/c/three.csv": b""})
    yield found
    found.rm("/fleet", recursive=True)


def test_addresses_are_told_from_paths() -> None:
    assert [is_address(one) for one in ("s3://b/k", "memory://a", "logs/a.csv", "C:\\logs", "a:b/c")] == [
        True, True, False, False, False
    ]  # fmt: skip


@pytest.mark.usefixtures("store")
def test_files_of_a_store_are_listed_and_fetched(tmp_path: Path) -> None:
    found = matching("memory://fleet/*/*.csv", tmp_path)
    assert [one.name for one in found] == ["memory:///fleet/a/one.csv", "memory:///fleet/b/two.csv"]
    assert [one.matched for one in found] == ["/fleet/a/one.csv", "/fleet/b/two.csv"]
    assert placed("memory://fleet/{robot}/{date}.csv") == "/fleet/{robot}/{date}.csv"
    assert stamp_of(found[1].name, tmp_path) == found[1].stamp
    with local_file(found[1].name, tmp_path) as path:
        assert (path.name, path.read_bytes()) == ("two.csv", b"t,q\n1,2\n")
    assert not path.exists()


def test_a_stamp_changes_with_the_file(store: Any, tmp_path: Path) -> None:
    before = stamp_of("memory://fleet/a/one.csv", tmp_path)
    store.pipe("/fleet/a/one.csv", b"t,tau\n")
    assert stamp_of("memory://fleet/a/one.csv", tmp_path) != before
    (tmp_path / "a.csv").write_text("1")
    local = stamp_of("a.csv", tmp_path)
    (tmp_path / "a.csv").write_text("12")
    assert stamp_of("a.csv", tmp_path) != local


@pytest.mark.usefixtures("store")
def test_what_is_not_there_has_no_stamp_and_cannot_be_fetched(tmp_path: Path) -> None:
    assert stamp_of("none.csv", tmp_path) == stamp_of("memory://fleet/none.csv", tmp_path) == ""
    with pytest.raises(InputError, match="there is no such file"), local_file("memory://fleet/none.csv", tmp_path):
        pass


def test_local_files_are_listed_from_a_folder(tmp_path: Path) -> None:
    for name in ("a/1.csv", "a/2.csv", "b/1.txt"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    assert [one.name for one in matching("*/*.csv", tmp_path)] == ["a/1.csv", "a/2.csv"]


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
        matching(address, tmp_path)


def test_a_store_that_does_not_answer_is_named(store: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object, **__: object) -> None:
        raise ConnectionError("refused")

    monkeypatch.setattr(type(store), "glob", refused)
    with pytest.raises(InputError, match=r"memory://fleet/.*: the store does not answer: ConnectionError: refused"):
        matching("memory://fleet/*", tmp_path)


def test_without_fsspec_what_to_install_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "fsspec.core", None)
    with pytest.raises(InputError, match=r"needs fsspec: .*install fsspec"):
        stamp_of("s3://bucket/a.csv", tmp_path)
