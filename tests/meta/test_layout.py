"""Tests lie where their modules do."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).parents[2]
TESTS, SOURCE = ROOT / "tests", ROOT / "src" / "dynident"
FREE = ("browser", "laws", "meta")  # of pages in a browser, of whole families, and of the project


def mirrors(path: Path) -> bool:
    """``tests/io/test_logs.py`` tests ``io/logs.py``, or a folder ``io/logs``; ``tests/io/test_io.py`` the package."""
    folder, name = SOURCE / path.parent.relative_to(TESTS), path.stem.removeprefix("test_")
    return folder.is_dir() and ((folder / f"{name}.py").is_file() or (folder / name).is_dir() or name == folder.name)


def test_every_test_lies_where_its_module_does() -> None:
    paths = [path for path in TESTS.rglob("test_*.py") if path.relative_to(TESTS).parts[0] not in FREE]
    assert len(paths) > 50
    assert [str(path) for path in sorted(paths) if not mirrors(path)] == []
    assert not mirrors(TESTS / "io" / "test_nothing.py")
