"""Files by path and by address."""

from __future__ import annotations

import builtins
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import fsspec
import pytest

from dynident.files.opener import file_stamp, is_address, local_file, matching_files, strip_scheme
from dynident.runtime import InputError


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
    found, _ = matching_files("memory://fleet/*/*.csv", tmp_path)
    assert [one.name for one in found] == ["memory:///fleet/a/one.csv", "memory:///fleet/b/two.csv"]
    assert [one.match_name for one in found] == ["/fleet/a/one.csv", "/fleet/b/two.csv"]
    assert strip_scheme("memory://fleet/{robot}/{date}.csv") == "/fleet/{robot}/{date}.csv"
    assert file_stamp(found[1].name, tmp_path) == found[1].stamp
    with local_file(found[1].name, tmp_path) as path:
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


def test_local_files_are_listed_from_a_folder(tmp_path: Path) -> None:
    for name in ("a/1.csv", "a/2.csv", "b/1.txt"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    assert [one.name for one in matching_files("*/*.csv", tmp_path)[0]] == ["a/1.csv", "a/2.csv"]


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
