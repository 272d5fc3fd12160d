"""Findings gathered for the eye: like ones once, with the names of all places."""

from __future__ import annotations

from dynident.diagnostics import Finding
from dynident.examination import Examination
from dynident.report.check import check_dict, check_summary, check_tables


def rows(*findings: Finding) -> dict[str, list[tuple[str, ...]]]:
    return {table.caption: list(table.rows) for table in check_tables(Examination(findings))}


def test_like_findings_are_one_row() -> None:
    made = [Finding("warning", joint, "coarse.", "quantised", log) for log in ("one", "two") for joint in ("a", "b")]
    assert rows(*made) == {"Warnings": [("one: a", "coarse. Likewise b. Also in two.")]}
    assert check_summary(Examination(tuple(made))) == "1 warning."


def test_several_statements_on_one_place_stay_apart() -> None:
    made = [Finding("warning", None, words, "not excited") for words in ("move a.", "move b.")]
    assert rows(*made) == {"Warnings": [("", "move a."), ("", "move b.")]}


def test_the_gravest_first_and_counted() -> None:
    found = Examination((Finding("error", None, "torn.", "gap", "one"), Finding("info", None, "so.", "x", "one")))
    assert list(rows(*found.findings)) == ["Errors", "Good to know"]
    assert found.failed
    assert check_summary(found) == "1 error."
    assert check_summary(Examination(())) == "No errors and no warnings."


def test_the_dictionary_is_plain() -> None:
    found = check_dict(Examination((Finding("error", None, "torn.", "gap", "one"),)))
    assert found["findings"][0]["topic"] == "gap"
    assert found["rank"] is None
