"""The mutation run: its sample, the tests of a line, its list of equivalent mutants, and what it resumes from."""

from __future__ import annotations

import runpy
import sys
import tomllib
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import pytest

ROOT = Path(__file__).parents[2]
with patch.object(sys, "path", [str(ROOT / "benchmarks"), *sys.path]):
    RUN = runpy.run_path(str(ROOT / "benchmarks" / "mutation.py"))


WIDE = "tests/laws/test_shown"
CODE = """SIZE = 3


class Box:
    edge: float = 2.0

    def volume(self, scale=1.0):
        if scale > SIZE:
            return 0.0
        return self.edge**3
"""


def test_every_file_has_a_room() -> None:
    rooms = RUN["rooms"]()
    assert {"motion", "runtime", "apps/online", "apps/bound"} <= set(rooms)
    assert len(RUN["files"](rooms)) > 200


@pytest.mark.parametrize(
    ("line", "tests"),
    [
        (1, ["third", "large", WIDE]),  # a constant: who runs a line with its name, or has it, or compares all
        (5, ["small", "third", "large", WIDE]),  # of a class: likewise
        (7, ["small", "large"]),  # the head of a function: who runs its body
        (8, ["large"]),
        (10, ["small", "large"]),
    ],
)
def test_the_tests_of_a_line_are_those_that_run_it_the_smallest_first(
    tmp_path: Path, line: int, tests: list[str]
) -> None:
    (tmp_path / "box.py").write_text(CODE, encoding="utf-8")
    (tmp_path / WIDE).parent.mkdir(parents=True)
    for name in ("large", "small", "third", WIDE):
        (tmp_path / f"{name}.py").write_text(CODE if name == "third" else "", encoding="utf-8")
    coverage = object.__new__(RUN["Coverage"])
    coverage.root = tmp_path
    coverage.by_line = {"box.py": {8: {"large.py::test"}, 10: {"large.py::test", "small.py::test"}}}
    coverage.size = {"large.py::test": 3, "small.py::test": 1, "third.py::test": 2, f"{WIDE}.py::test": 4}
    assert coverage.tests_of("box.py", line) == [f"{name}.py::test" for name in tests]


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
    assert meaning("cache = lru_cache(maxsize=8)(f)") == meaning("cache = lru_cache(maxsize=7)(f)")
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
