"""A comparison in words, tables and as a page: nothing of a name acts, and numbers are those of the comparison."""

from __future__ import annotations

import json
from dataclasses import replace

from dynident.apps.compare_results import ExportRecord, compare_results
from dynident.apps.compare_results.report import (
    comparison_dict,
    comparison_lines,
    comparison_page,
    comparison_tables,
    headline,
    overview_table,
)
from dynident.files.results import json_text
from dynident.runtime import Use
from tests.apps.compare_results.test_identification_comparison import FIRST, log, result

HOSTILE = "<script>alert('x')</script>"
FIRST_FULL = replace(
    FIRST,
    use=Use.CONTROL,
    logs=(log(2.0), log(1.0, "monday", "train", "y")),
    exports=(ExportRecord("arm.urdf", "urdf", "ab" * 32, True, 0.0, True),),
)
WORSE = replace(
    FIRST_FULL,
    name="two",
    value=result([1.0, 2.0, 1.5, 0.8]).value,
    use=Use.DO_NOT_USE,
    logs=(log(2.4), log(1.0, "monday", "train", "y")),
    exports=(ExportRecord("arm.urdf", "urdf", "cd" * 32, False, None, False),),
)


def test_sentences_say_what_differs_and_what_is_worse() -> None:
    found = compare_results(FIRST_FULL, WORSE)
    assert headline(found) == "two beside one: worse, and the parameters differ"
    lines = comparison_lines(found)
    assert lines[0].startswith("1 of 3 base parameters that both determine differs significantly by itself (level 1 %")
    assert lines[1].startswith("All together: chi-squared = ")
    assert any("fitted to monday: their errors are not independent" in one for one in lines)
    assert "Torque error on tuesday (held out): 2.4 % against 2 %: 20 % more, beyond the 5 % allowed." in lines
    assert "Verdict: do not use, where one is good for control." in lines
    assert "Written and proven with one, but not with two: arm.urdf." in lines
    assert "Of two, no longer there as written: arm.urdf." in lines


def test_the_same_and_nothing_in_common() -> None:
    same = compare_results(FIRST_FULL, FIRST_FULL)
    assert headline(same).endswith(": no significant difference")
    assert comparison_lines(same)[0].startswith("None of 3 base parameters that both determine differs")
    assert any(one.endswith("2 % against 2 %, the same.") for one in comparison_lines(same))
    other = replace(FIRST, name="other", names=("w", "x", "y", "z"), joints=("c",))
    nothing = compare_results(FIRST, other)
    assert headline(nothing).endswith(": nothing that can be compared")
    lines = comparison_lines(nothing)
    assert lines[0] == "Joints of one result alone: a, b, c."
    assert lines[1].startswith("No base parameter is determined by both results")
    assert lines[2].startswith("No log has the same name and role in both")


def test_a_held_out_log_judged_on_other_samples_is_not_passed_over() -> None:
    other = replace(FIRST_FULL, logs=(log(0.5, recording="z"), log(1.0, "monday", "train", "y")))
    lines = comparison_lines(compare_results(FIRST_FULL, other))
    assert any(one.startswith("Of tuesday, held out, other recordings or samples were judged") for one in lines)
    assert "Torque error on monday (training): 1 % against 1 %, the same." in lines


def test_tables_hold_the_numbers() -> None:
    found = compare_results(FIRST_FULL, WORSE)
    base, errors, files = comparison_tables(found)
    assert base.rows[0][0] == "f"
    assert base.rows[0][6] == "+3.54"
    assert errors.rows[0] == ("tuesday", "held out", "all", "2.00", "2.40", "+20.0", "the same")
    assert files.rows == (("arm.urdf", "yes", "abababab", "no", "cdcdcdcd (gone)", "no"),)
    rows = overview_table([FIRST_FULL, WORSE]).rows
    assert rows[1] == ("two", "do not use", "2.40", "1.00", "3", "0")


def test_the_page_escapes_names_and_the_numbers_are_json() -> None:
    odd = replace(WORSE, name=HOSTILE, base_names=(HOSTILE, "h", "f"))
    found = compare_results(replace(FIRST_FULL, base_names=(HOSTILE, "h", "f")), odd)
    page = comparison_page([found, compare_results(FIRST_FULL, WORSE)])
    assert HOSTILE not in page
    assert "&lt;script&gt;alert" in page
    assert page.count("Differences of base parameters in their standard errors") >= 2
    data = json.loads(json_text(comparison_dict([found])))
    assert data["comparisons"][0]["worse"]
    assert data["comparisons"][0]["parameters"]["compared"][0]["significant"]
    assert data["comparisons"][0]["verdicts"] == ["good for control", "do not use"]
