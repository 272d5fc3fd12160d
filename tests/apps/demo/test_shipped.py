"""The demo's files: whole, small, and never in the place of others."""

from __future__ import annotations

from pathlib import Path
from unittest.mock import Mock

import pytest

from dynident.apps.demo import demo_files
from dynident.apps.demo.arm import BASE, LINKS, controller, urdf
from dynident.runtime import InputError


def contents(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_the_files_are_those_of_the_description_and_small(tmp_path: Path) -> None:
    there = contents(demo_files(tmp_path / "an arm"))
    assert there["arm.urdf"].decode() == urdf()
    assert there["controller.yaml"].decode() == controller()
    for link in (BASE, *LINKS):
        assert there[f"meshes/{link.name}.stl"][80:] == link.shape.stl()[80:]
    assert {"monday.parquet", "tuesday.parquet"} < set(there)
    assert len(there) == 4 + 1 + len(LINKS)
    assert sum(map(len, there.values())) < 500_000


def test_a_second_time_changes_nothing_and_adds_what_is_missing(tmp_path: Path) -> None:
    first = contents(demo_files(tmp_path))
    (tmp_path / "meshes" / "hand.stl").unlink()
    (tmp_path / "mine.txt").write_text("kept")
    assert contents(demo_files(tmp_path)) == first | {"mine.txt": b"kept"}


def test_files_of_the_user_stay(tmp_path: Path) -> None:
    (tmp_path / "tuesday.parquet").write_bytes(b"my own")
    with pytest.raises(InputError, match=r"tuesday\.parquet: exists already"):
        demo_files(tmp_path)
    assert contents(tmp_path) == {"tuesday.parquet": b"my own"}


def test_nothing_is_written_where_not_all_can_be(tmp_path: Path) -> None:
    (tmp_path / "meshes").write_text("a file")
    with pytest.raises(InputError, match="meshes: nothing can be written here"):
        demo_files(tmp_path)
    assert contents(tmp_path) == {"meshes": b"a file"}


def test_a_link_that_leads_nowhere_is_left(tmp_path: Path) -> None:
    (tmp_path / "arm.urdf").symlink_to(tmp_path / "elsewhere" / "mine.urdf")
    with pytest.raises(InputError, match=r"arm\.urdf: exists already"):
        demo_files(tmp_path)
    assert (tmp_path / "arm.urdf").is_symlink()


def test_what_cannot_be_read_is_another_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    demo_files(tmp_path)
    for error in (PermissionError(13, "Permission denied"), OSError(5, "Input/output error")):
        monkeypatch.setattr(Path, "is_file", Mock(side_effect=error))
        with pytest.raises(InputError, match="exists already"):
            demo_files(tmp_path)
