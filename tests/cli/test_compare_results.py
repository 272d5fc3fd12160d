"""``dynident compare-results`` as a gate: what it prints, writes, and ends with."""

import json
from pathlib import Path

import pytest

from tests.apps.compare_results.test_comparison import folder
from tests.cli.commands import configure, run, succeed, write_log

__all__ = ["folder"]


@pytest.fixture
def result(folder: Path) -> Path:
    return folder / "out" / "result.json"


@pytest.fixture(scope="module")
def other(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Another slider, with more friction; its result."""
    place = tmp_path_factory.mktemp("other")
    path = write_log(place, n=2000, rate=4.0)
    text = path.read_text().splitlines()
    rows = [line.split(",") for line in text[1:]]
    path.write_text("\n".join([text[0], *(f"{t},{x},{1.3 * float(f)}" for t, x, f in rows)]))
    assert run("identify", configure(place), "--out", place / "out").exit_code == 0
    return place / "out" / "result.json"


def test_a_result_agrees_with_itself(result: Path) -> None:
    done = succeed("compare-results", result, result)
    assert "no significant difference" in done.output
    assert len(done.output.splitlines()) <= 12
    assert "Base parameters, those that differ most first" in succeed("compare-results", result, result, "-v").output


def test_one_that_differs_ends_with_3_and_writes_its_numbers(result: Path, other: Path, tmp_path: Path) -> None:
    done = run("compare-results", result, other, "--json", tmp_path / "x.json", "--out", tmp_path / "out")
    assert done.exit_code == 3, done.output
    assert "the parameters differ significantly" in done.output
    assert "of other recordings" in done.output
    numbers = json.loads((tmp_path / "x.json").read_text())
    assert numbers["comparisons"][0]["differs"]
    assert numbers == json.loads((tmp_path / "out" / "comparison.json").read_text())
    assert "<title>Comparison of results" in (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert run("compare-results", result, other, "--only-worse").exit_code == 0
    assert run("compare-results", result, result, other).exit_code == 3


def test_what_cannot_be_done_is_said(result: Path, tmp_path: Path) -> None:
    assert run("compare-results", result).exit_code == 2
    assert run("compare-results", result, result, "--tolerance", "nan").exit_code == 2  # nothing would be above it
    assert run("compare-results", result, result, "--level", "nan").exit_code == 2
    done = run("compare-results", result, tmp_path / "missing.json")
    assert (done.exit_code, "no such file" in done.output) == (1, True)
    before = result.read_bytes()
    done = run("compare-results", result, result, "--json", result)
    assert (done.exit_code, "would be replaced" in done.output) == (1, True)
    done = run("compare-results", result, result, "--out", result.parent)
    assert (done.exit_code, "report of another command" in done.output) == (1, True)
    assert result.read_bytes() == before
