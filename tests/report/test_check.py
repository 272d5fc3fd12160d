"""Findings gathered for the eye: like ones once, with the names of all places."""

from __future__ import annotations

from dynident.checks import CheckResult, ExcitedRank, Finding, Topic
from dynident.errors import Severity
from dynident.identification import BaseTilt, TimeOffset
from dynident.regression import UnexcitedParameters
from dynident.report.check import check_dict, check_summary, check_tables


def rows(*findings: Finding) -> dict[str, list[tuple[str, ...]]]:
    return {table.caption: list(table.rows) for table in check_tables(CheckResult(findings))}


def test_like_findings_are_one_row() -> None:
    made = [
        Finding(Severity.WARNING, joint, "coarse.", Topic.QUANTISED, log)
        for log in ("one", "two")
        for joint in ("a", "b")
    ]
    assert rows(*made) == {"Warnings": [("one: a", "coarse. Likewise b. Also in two.")]}
    assert check_summary(CheckResult(tuple(made))) == "1 warning."


def test_several_statements_on_one_place_stay_apart() -> None:
    made = [Finding(Severity.WARNING, None, words, Topic.NOT_EXCITED) for words in ("move a.", "move b.")]
    assert rows(*made) == {"Warnings": [("", "move a."), ("", "move b.")]}


def test_the_most_severe_first_and_counted() -> None:
    found = CheckResult(
        (
            Finding(Severity.ERROR, None, "torn.", Topic.GAP, "one"),
            Finding(Severity.INFO, None, "so.", Topic.LOST, "one"),
        )
    )
    assert list(rows(*found.findings)) == ["Errors", "Good to know"]
    assert found.failed
    assert check_summary(found) == "1 error."
    assert check_summary(CheckResult(())) == "No errors and no warnings."


def test_the_dictionary_is_plain() -> None:
    found = check_dict(CheckResult((Finding(Severity.ERROR, None, "torn.", Topic.GAP, "one"),)))
    assert found["findings"][0]["topic"] == "gap"
    assert found["rank"] is None
    assert [type(found["findings"][0][key]) for key in ("severity", "topic")] == [str, str]


def test_nouns_of_findings_are_worded() -> None:
    time_offset, tilt = TimeOffset(0.005, 4.0, 2.0), BaseTilt(0.02, -0.035, (1e-3, 2e-3), 4.0, 2.0)
    missing = UnexcitedParameters(("Fv_b",), ("b",))
    found = CheckResult(
        (
            Finding(Severity.WARNING, None, missing, Topic.NOT_EXCITED),
            Finding(Severity.INFO, None, time_offset, Topic.TIME_OFFSET),
            Finding(Severity.INFO, None, tilt, Topic.BASE_TILT),
        ),
        rank=ExcitedRank(3, 2, 3, 10.0, (missing,)),
    )
    shown = [one["message"] for one in check_dict(found)["findings"]]
    assert shown == [row[1] for table in check_tables(found) for row in table.rows]
    assert shown[0] == "Fv_b: not excited by these data; move b."
    assert shown[1].startswith("Time offset: positions are stamped 5 ms later")
    assert shown[1].endswith("instead of 4 %.")
    assert shown[2].startswith("The base is tilted by 1.15 deg")
    assert shown[2].endswith("If it may stand so, set `base_tilt: estimate` in the model.")
    assert check_dict(found)["rank"]["missing"][0]["words"] == shown[0]
