"""Tests lie in the folder of their room: those of ``src/dynident/models/friction`` in ``tests/models/friction``."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).parents[2]
TESTS, SOURCE = ROOT / "tests", ROOT / "src" / "dynident"
FREE = ("browser", "laws", "meta")  # of pages in a browser, of whole families, and of the project


def has_room(path: Path) -> bool:
    """Whether the folder of a test is one of the package; ``test_dynident.py`` tests the package itself."""
    folder = path.parent.relative_to(TESTS)
    return (SOURCE / folder).is_dir() and (folder.parts != () or path.name == "test_dynident.py")


def rooms(folder: Path) -> set[str]:
    """The rooms of the package below a folder of tests."""
    return {path.name for path in folder.iterdir() if path.is_dir() and path.name[0].isalpha()} - {"data", *FREE}


def test_every_test_lies_in_the_folder_of_its_room() -> None:
    paths = [path for path in TESTS.rglob("test_*.py") if path.relative_to(TESTS).parts[0] not in FREE]
    assert len(paths) > 50
    assert [str(path) for path in sorted(paths) if not has_room(path)] == []
    assert not has_room(TESTS / "io" / "test_nothing.py")
    assert not has_room(TESTS / "test_nothing.py")


def test_every_room_and_application_has_tests() -> None:
    """``dynident.testing`` is tested by its use in ``tests/laws``."""
    assert rooms(TESTS) == rooms(SOURCE) - {"testing"}
    single = {path.stem for path in (SOURCE / "apps").glob("*.py")} - {"__init__"}
    tested = {path.stem.removeprefix("test_") for path in (TESTS / "apps").glob("test_*.py")}
    assert rooms(TESTS / "apps") == rooms(SOURCE / "apps")
    assert tested == single


def test_the_top_of_the_package_has_few_names() -> None:
    assert len(rooms(SOURCE)) <= 14
    assert {path.name for path in SOURCE.glob("*.py")} == {"__init__.py", "__main__.py", "_version.py"}
