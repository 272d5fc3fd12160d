"""A ranking in words, tables, figures, and as a page on which no name acts."""

from collections.abc import Iterator
from dataclasses import replace

from rich.console import Console

from dynident.apps.ranking import CombinationOutcome, Ranking, cost_figure, ranking_figure
from dynident.apps.ranking.page import ranking_page
from dynident.apps.ranking.report import ranking_dict, ranking_findings, ranking_heading, ranking_tables
from dynident.checks.motion_notes import LoopDiffers
from dynident.report.terminal import TerminalTable
from dynident.runtime import Finding, Remark, Severity
from tests.kept import check_kept
from tests.report.rankings import ranking, untold


def said(result: Ranking) -> list[str]:
    return [ranking_heading(result), *ranking_findings(result)]


def variants() -> Iterator[tuple[str, Ranking]]:
    """Yield rankings in which something is otherwise, with what it is."""
    made = ranking()
    first, second, *others = made.rows
    best = replace(first, eigenvalue=0.1)
    not_own = replace(best, combination=replace(first.combination, is_configured=False))
    own = replace(second, combination=replace(second.combination, is_configured=True))
    near = replace(own, error=3.02, interval=(0.01, 0.029), p_value=0.001, seconds_estimate=0.6)
    fast, quick = replace(second, seconds_estimate=0.05), replace(not_own, seconds_estimate=0.7)
    unsettled = CombinationOutcome.UNSETTLED
    pairs = {
        "an equal is configured": (not_own, replace(own, seconds_estimate=2.0)),
        "an equal is much faster": (not_own, fast),
        "an equal is not much faster": (replace(not_own, seconds_estimate=0.4), fast),
        "the best is configured, and no equal is faster": (best, replace(second, seconds_estimate=2.0)),
        "the faster one is impossible": (best, replace(fast, eigenvalue=-1.0)),
        "the faster one did not converge": (best, replace(fast, outcome=unsettled)),
        "the best did not converge": (replace(best, outcome=unsettled), second),
        "surely less than 1 % worse": (quick, near),
        "perhaps more than 1 % worse": (quick, replace(near, interval=(0.01, 0.031))),
    }
    yield from ((name, replace(made, rows=(*pair, *others))) for name, pair in pairs.items())
    yield "logs are short", untold(replace(made, rows=(quick, near, *others)))
    fourth = replace(others[1], combination=replace(others[1].combination, is_configured=True))
    lost = replace(fourth, error=float("nan"), outcome=CombinationOutcome.FAILED, reason="too short")
    for name, row in (("the configured one is number 4", fourth), ("the configured one has no estimate", lost)):
        yield name, replace(made, rows=(replace(not_own, eigenvalue=None), second, others[0], row, *others[2:]))
    same, crossed = dict.fromkeys(made.joints, 3.0), dict.fromkeys(made.joints, 9.0)
    plain = [replace(row, cross_p_value=1.0, same_motion=same) for row in made.rows]
    for chance in (0.001, 0.05, 0.2):
        doubted = replace(plain[0], cross_validated=crossed, cross_p_value=chance)
        yield f"cross-validation has the best worse by {chance}", replace(made, rows=(doubted, *plain[1:]))
    doubted, worse = replace(doubted, cross_p_value=0.001), replace(plain[1], p_value=0.001)
    yield "cross-validation contradicts, all others are worse", replace(made, rows=(doubted, worse, *plain[2:]))
    reasons = (replace(made.rows[-1], reason=f"reason {k}") for k in range(6))
    yield "many reasons", replace(made, rows=(first, second, *reasons))
    yield "one reason of two", replace(made, absent=(*made.absent, replace(made.absent[0], estimator="others")))
    torque = {**first.held_out, "still": float("nan")}
    yield "a joint has no torque", replace(made, rows=(replace(first, held_out=torque), second, *others))
    yield "a log is repeated", replace(made, repeats=(("tuesday", "monday"),))
    wrong = Finding(Remark("turns <b>the other way</b>"), "elbow", source="monday", severity=Severity.ERROR)
    yield "an error forbids any", replace(made, findings=(wrong,))
    loop = replace(wrong, severity=Severity.WARNING, message=LoopDiffers(0.7))
    yield "the loop differs", replace(made, findings=(loop,))
    yield "nothing is held out, logs are short", untold(ranking(basis="train"))
    yield "none has an estimate", replace(made, rows=made.rows[-1:])


def test_what_to_take_and_why_stays_in_all_situations() -> None:
    lines, usual = list[str](), said(ranking())
    for name, result in variants():
        data = ranking_dict(result)
        marks = [row[-1] for table in ranking_tables(result) for row in table.rows]
        lines.append(f"{name}: take {data['take']}, contradicted by {data['contradicted_by']}, marks {marks}")
        lines += [f"    {line}" for line in said(result) if line not in usual]
    check_kept("ranking_situations", "\n".join(lines))


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
    result = ranking(6, 10)
    figure = ranking_figure(result)
    heights = [y for x in figure.data if x["mode"] == "markers" for y in x["y"]]
    assert len(set(heights)) == len(heights) == 59
    assert figure.layout["height"] < 1300
    assert figure.layout["xaxis"]["type"] == "log"
    assert figure.figure()
    assert cost_figure(result).figure()


def test_without_chance_there_are_no_whiskers() -> None:
    figure = ranking_figure(untold(ranking()))
    assert not any("error_x" in x for x in figure.data)
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
    result = untold(ranking())
    plain = replace(result, rows=tuple(replace(row, truth=None) for row in result.rows), absent=())
    assert "Against the truth" not in ranking_page(plain)
    none = ranking_page(replace(result, rows=result.rows[-1:]))
    assert "By joint" not in none
    assert "no estimate" in none
