"""A ranking in words, tables, figures, and as a page on which no name acts."""

from __future__ import annotations

from dataclasses import replace

from rich.console import Console

from dynident.apps.ranking import CombinationOutcome, RankedCombination, cost_figure, ranking_figure
from dynident.apps.ranking.page import ranking_page
from dynident.apps.ranking.report import ranking_dict, ranking_findings, ranking_heading, ranking_tables
from dynident.checks.motion_notes import LoopDiffers
from dynident.report.terminal import TerminalTable
from dynident.runtime import Finding, Remark, Severity
from tests.report.rankings import ranking, untold


def said(found: object) -> str:
    return "\n".join(ranking_findings(found))  # type: ignore[arg-type]


def test_what_a_few_lines_cannot_hold_is_in_the_report() -> None:
    found = ranking()
    lost = tuple(replace(found.rows[-1], reason=f"reason {k}") for k in range(6))
    assert "2 more reasons in the report" in said(replace(found, rows=(*found.rows[:2], *lost)))
    absent = (*found.absent, replace(found.absent[0], estimator="others"))
    assert "apply: instruments, others: monday: has no" in said(replace(found, absent=absent))


def test_what_holds_nothing_out_or_has_no_torque_is_said() -> None:
    found = ranking()
    joints = {**found.rows[0].held_out, "still": float("nan")}
    first = replace(found.rows[0], held_out=joints)
    text = said(replace(found, rows=(first, *found.rows[1:]), repeats=(("tuesday", "monday"),)))
    assert "tuesday repeats the motion of monday, which holds nothing out" in text
    assert "still: no torque to compare with" in text


def test_among_equals_nothing_is_changed() -> None:
    found = ranking()
    first, second = found.rows[:2]
    slow = replace(first, combination=replace(first.combination, is_configured=False), eigenvalue=0.1)
    own = replace(
        second, combination=replace(second.combination, is_configured=True), seconds_estimate=first.seconds_estimate
    )
    text = said(replace(found, rows=(slow, own, *found.rows[2:])))
    assert "Take smoother1 with estimator0 (3.4 %): as good within chance, and nothing is to be changed." in text
    fast = replace(second, seconds_estimate=0.05)
    text = said(replace(found, rows=(slow, fast, *found.rows[2:])))
    assert "as good within chance, and takes 0.15 s instead of 2.1 s." in text
    soon = replace(slow, seconds_estimate=0.4)
    assert "Take smoother0 with estimator0" in said(replace(found, rows=(soon, fast, *found.rows[2:])))


def test_what_is_surely_less_than_a_percent_worse_is_as_good() -> None:
    found = ranking()
    first, second, *others = found.rows
    best = replace(
        first, combination=replace(first.combination, is_configured=False), eigenvalue=0.1, seconds_estimate=0.7
    )
    own = replace(second.combination, is_configured=True)
    near = replace(second, combination=own, error=3.02, interval=(0.01, 0.029), p_value=0.001, seconds_estimate=0.6)
    hardly = replace(found, rows=(best, near, *others))
    text = said(hardly)
    assert "All others are worse by more than chance." in text
    assert "Of those that are worse, 1 is so by less than 1 % of the error, which makes no difference in use." in text
    assert "Take smoother1 with estimator0 (3.02 %): less than 1 % worse, and nothing is to be changed." in text
    assert "is number 2 of 5 with 3.02 %, worse by more than chance, but by less than 1 % of the error." in text
    assert [row[-1] for row in next(ranking_tables(hardly)).rows[:3]] == ["", "take, yours, hardly worse", "worse"]
    assert ranking_dict(hardly)["as_good"] == [["smoother0", "estimator0"], ["smoother1", "estimator0"]]
    far = replace(hardly, rows=(best, replace(near, interval=(0.01, 0.031)), *others))  # perhaps by more
    assert far.choice is best
    assert "makes no difference" not in said(far)
    short = untold(hardly)
    assert short.choice is short.best


def test_why_the_best_is_taken_though_another_is_faster() -> None:
    found = ranking()
    first, second = found.rows[:2]
    best = replace(first, eigenvalue=0.1)

    def why(one: RankedCombination, other: RankedCombination) -> str:
        return said(replace(found, rows=(one, other, *found.rows[2:])))

    slow, fast = replace(second, seconds_estimate=first.seconds_estimate), replace(second, seconds_estimate=0.05)
    assert "estimator0, as the configuration does: none of these is much faster." in why(best, slow)
    assert "bodies are possible, which those of faster ones are not." in why(best, replace(fast, eigenvalue=-1.0))
    unsettled = CombinationOutcome.UNSETTLED
    assert "converged, which those of faster ones did not" in why(best, replace(fast, outcome=unsettled))
    assert "converged, which that of the best did not." in why(replace(best, outcome=unsettled), second)


def test_the_configured_combination_has_its_place() -> None:
    found = ranking()
    own = replace(found.rows[3], combination=replace(found.rows[3].combination, is_configured=True))
    first = replace(found.rows[0], combination=replace(found.rows[0].combination, is_configured=False), eigenvalue=None)
    other = replace(found, rows=(first, *found.rows[1:3], own, *found.rows[4:]))
    text = said(other)
    assert "is number 4 of 5 with 4.2 %, worse by more than chance." in text
    assert "Take smoother0 with estimator0" in text
    lost = replace(own, error=float("nan"), outcome=CombinationOutcome.FAILED, reason="too short")
    assert "has no estimate: too short" in said(replace(other, rows=(first, *found.rows[1:3], lost)))


def test_a_best_that_cross_validation_contradicts_is_not_recommended() -> None:
    """The first one is best on held-out motion, and far worse in cross-validation, by more than chance."""
    found = ranking()
    same, crossed = dict.fromkeys(("shoulder", "elbow"), 3.0), dict.fromkeys(("shoulder", "elbow"), 9.0)
    rows = [replace(one, cross_p_value=1.0, same_motion=same) for one in found.rows]
    rows[0] = replace(rows[0], cross_validated=crossed, cross_p_value=0.001)
    other = replace(found, rows=tuple(rows))
    assert other.rival is rows[1]
    assert other.choice is rows[1]
    text = said(other)
    assert (
        "contradict each other: smoother0 with estimator0 has 3 % and 9 %, smoother1 with estimator0 has 3.4 %" in text
    )
    assert "the lead is in how smoother0 sees the motion, not in its parameters" in text
    rows[1] = replace(rows[1], p_value=0.001)
    worse = replace(found, rows=tuple(rows))
    assert worse.choice is None
    assert "Take none of them before that is settled." in said(worse)
    for chance in (0.2, 0.05):
        assert replace(found, rows=(replace(rows[0], cross_p_value=chance), *rows[1:])).rival is None


def test_what_forbids_any_model_comes_first() -> None:
    finding = Finding(Remark("turns <b>the other way</b>"), "elbow", source="monday", severity=Severity.ERROR)
    first = ranking_findings(replace(ranking(), findings=(finding,)))[0]
    assert first == "Before any of them is used: monday: elbow: turns <b>the other way</b>."
    loop = replace(finding, severity=Severity.WARNING, message=LoopDiffers(0.7))
    first = ranking_findings(replace(ranking(), findings=(loop,)))[0]
    assert first.startswith("What simulates is as right as its controller: monday: elbow: ")


def test_what_is_not_known_is_not_claimed() -> None:
    assert "worse by more than chance" not in said(untold(ranking(basis="train")))
    none = replace(ranking(), rows=ranking().rows[-1:])
    assert ranking_heading(none) == "none of the combinations has an estimate"
    assert list(ranking_tables(none)) == []


def test_tables_fit_a_terminal() -> None:
    console = Console(width=80, record=True)
    for table in ranking_tables(ranking(6, 10)):
        assert len(table.rows) == 3
        console.print(TerminalTable(table))
    text = console.export_text()
    assert max(map(len, text.splitlines())) <= 80
    assert "take" in text
    assert "56 more with larger errors" in text


def test_each_combination_has_its_line_and_mark() -> None:
    found = ranking(6, 10)
    figure = ranking_figure(found)
    heights = [y for one in figure.data if one["mode"] == "markers" for y in one["y"]]
    assert len(set(heights)) == len(heights) == 59
    assert figure.layout["height"] < 1300
    assert figure.layout["xaxis"]["type"] == "log"
    assert figure.figure()
    assert cost_figure(found).figure()


def test_without_chance_there_are_no_whiskers() -> None:
    figure = ranking_figure(untold(ranking()))
    assert not any("error_x" in one for one in figure.data)
    assert "type" not in figure.layout["xaxis"]


HOSTILE = "<script>alert('x')</script>"


def test_the_badge_tells_what_comes_before_any_ranking_and_names_are_escaped() -> None:
    finding = Finding(Remark(HOSTILE), severity=Severity.ERROR)
    text = ranking_page(replace(ranking(joint=HOSTILE), findings=(finding,)))
    assert "correct first what was found" in text
    assert "yours is among the best" not in text
    assert HOSTILE not in text
    assert "<b>too short</b>" not in text


def test_a_page_without_chance_truth_or_estimates() -> None:
    found = untold(ranking())
    plain = replace(found, rows=tuple(replace(one, truth=None) for one in found.rows), absent=())
    assert "Against the truth" not in ranking_page(plain)
    none = ranking_page(replace(found, rows=found.rows[-1:]))
    assert "By joint" not in none
    assert "no estimate" in none
