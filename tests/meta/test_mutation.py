"""The mutation run: its sample, the tests of a file, its list of equivalent mutants, and what it resumes from."""

from __future__ import annotations

import runpy
import sys
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest

ROOT = Path(__file__).parents[2]
with patch.object(sys, "path", [str(ROOT / "benchmarks"), *sys.path]):
    RUN = runpy.run_path(str(ROOT / "benchmarks" / "mutation.py"))


def test_every_file_has_a_room_with_tests() -> None:
    rooms = RUN["rooms"]()
    assert {"motion", "runtime", "apps/online", "apps/bound"} <= set(rooms)
    paths = RUN["files"](rooms)
    assert len(paths) > 200
    for path in paths[::8]:
        tests = RUN["tests_of"](path, ROOT)
        assert path in tests
        assert len(tests) > 1, path
        assert all((ROOT / test).is_file() for test in tests)


def test_the_tests_of_a_file_run_before_the_others_of_its_room() -> None:
    first, *others = RUN["tests_of"]("src/dynident/estimators/maximum_likelihood/segment.py", ROOT)
    assert first == "tests/estimators/maximum_likelihood/test_segment.py"
    near = others.index("tests/estimators/maximum_likelihood/test_fit.py")
    assert near < others.index("tests/estimators/test_least_squares.py")
    assert first not in others
    assert "tests/apps/test_bound.py" in RUN["tests_of"]("src/dynident/apps/bound.py", ROOT)


def test_a_sample_is_the_same_for_a_seed_and_larger_by_more() -> None:
    pytest.importorskip("cosmic_ray")
    (few, _), (more, _) = (RUN["sample"](["validation"], size, 3) for size in (3, 5))
    assert [one.key for one in more[:3]] == [one.key for one in few]
    assert len({(one.key, one.line) for one in more}) == 5


def test_equivalent_mutants_are_of_lines_that_exist() -> None:
    listed = tomllib.loads((ROOT / "benchmarks" / "mutation_equivalent.toml").read_text(encoding="utf-8"))["mutant"]
    for one in listed:
        lines = {line.strip() for line in (ROOT / one["path"]).read_text(encoding="utf-8").splitlines()}
        assert one["was"] in lines, one
        assert one["becomes"] not in lines, one
        assert len(one["why"]) > 10
    keys = [(one["path"], one["was"], one["becomes"]) for one in listed]
    assert len(set(keys)) == len(keys)


def test_what_has_no_effect_is_no_mutant() -> None:
    meaning = RUN["meaning"]
    assert meaning("def f(x: A | B) -> C: y: A | None = 1") == meaning("def f(x: A & B) -> D: y: A & None = 1")
    assert meaning("zip(a, b, strict=True)") == meaning("zip(a, b, strict=False)")
    assert meaning("x + 1") != meaning("x - 1")
    assert meaning("x +* 1") is None


def test_a_survivor_is_tried_again_when_its_tests_change_and_all_when_the_file_does() -> None:
    killed = RUN["Outcome"]("a.py", 1, "x", "y", "file", "tests", "killed", 1.0)
    survived, holds = replace(killed, result="survived"), RUN["holds"]
    assert holds(killed, "file", "other tests")
    assert not holds(killed, "other file", "tests")
    assert holds(survived, "file", "tests")
    assert not holds(survived, "file", "other tests")
    assert not holds(None, "file", "tests")


def test_the_score_is_of_the_mutants_that_are_not_equivalent(capsys: pytest.CaptureFixture[str]) -> None:
    killed = RUN["Outcome"]("a.py", 7, "x + 1", "x - 1", "file", "tests", "killed", 1.0)
    slow, survived = replace(killed, result="too long"), replace(killed, result="survived")
    RUN["show"]({"one": [killed, slow, killed, survived], "two": [killed]}, 2)
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["a.py:7"] in rows
    assert rows[-4:-1] == [
        ["one", "4", "3", "1", "75.0", "%"],
        ["two", "1", "1", "0", "100.0", "%"],
        ["all", "5", "4", "1", "80.0", "%"],
    ]


def test_tests_are_timed_once_for_a_project_as_it_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    copy, ran = object.__new__(RUN["Copy"]), []
    copy.times, copy._project, copy.failed = tmp_path / "times.json", "as it was", "test_a"

    def run(self: Any, tests: tuple[str, ...]) -> str:
        ran.append(tests)
        return "killed" if tests == ("bad.py",) else "survived"

    monkeypatch.setattr(RUN["Copy"], "run", run)
    assert copy.limit(("a.py", "b.py")) == copy.limit(("a.py", "b.py")) >= RUN["AT_LEAST"]
    assert len(ran) == 1
    copy._project = "changed"
    copy.limit(("a.py", "b.py"))
    assert len(ran) == 2
    with pytest.raises(SystemExit, match="test_a"):
        copy.limit(("bad.py",))
    with pytest.raises(SystemExit):
        copy.limit(("bad.py",))
