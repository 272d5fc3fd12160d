"""What reading a log raises and warns of, in words."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

from dynident import checks
from dynident.checks import notes, reading_line, require
from dynident.checks import notes as file_notes
from dynident.runtime import Finding, InputError, Severity

CHECKS = Path(checks.__file__).parent
STILL = notes.NeverMoves(1, 0.3)


def test_require_words_every_error_and_lets_warnings_pass() -> None:
    warning = Finding(Severity.WARNING, None, file_notes.OddTotalMass(6e3))
    require([warning], "x.csv")
    gap, short = notes.LongGap(0.5, 1.0, 50.0, 1), notes.TooFewSamples(4, 30)
    errors = [Finding(Severity.ERROR, "a", gap), warning, Finding(Severity.ERROR, None, short)]
    with pytest.raises(InputError) as caught:
        require(errors, "x.csv")
    first, second = str(caught.value).split("\n")
    assert first.startswith("x.csv: joint 'a': a gap of 0.5 s after t = 1 s")
    assert second.startswith("  only 4 samples; at least 30 are needed")


def test_a_line_names_the_joint_at_fault() -> None:
    assert reading_line(Finding(Severity.WARNING, "b", STILL)).startswith(
        "joint 'b': the position never moves (one value"
    )
    assert reading_line(Finding(Severity.WARNING, None, STILL)).startswith("the position never moves")
    assert reading_line(Finding(Severity.WARNING, None, "odd")) == "odd"


def test_what_only_a_report_words_is_no_line_of_reading() -> None:
    with pytest.raises(TypeError, match="there is no text for OddTotalMass"):
        reading_line(Finding(Severity.WARNING, None, file_notes.OddTotalMass(6e3)))


def sentences(source: str) -> list[str]:
    """The literals with a space in what a finding is made of."""
    calls = [one for one in ast.walk(ast.parse(source)) if isinstance(one, ast.Call)]
    made = [one for one in calls if ast.unparse(one.func) == "Finding" or ast.unparse(one.func).startswith("notes.")]
    texts = [node.value for call in made for node in ast.walk(call) if isinstance(node, ast.Constant)]
    return [text for text in texts if isinstance(text, str) and " " in text]


def test_no_check_writes_a_sentence() -> None:
    assert sentences("Finding(severity, None, f'only {count} samples')")
    sources = {path.name: path.read_text(encoding="utf-8") for path in CHECKS.glob("*.py")}
    assert sum("notes." in source for source in sources.values()) >= 7
    assert {name: found for name, source in sources.items() if (found := sentences(source))} == {}
