"""The page of a comparison: nothing of a name or reason acts."""

from __future__ import annotations

from dataclasses import replace

from dynident.apps.ranking.page import ranking_page
from dynident.runtime import Finding, Remark, Severity
from tests.report.rankings import ranking, untold

HOSTILE = "<script>alert('x')</script>"


def test_the_page_has_all_parts_and_escapes_names() -> None:
    text = ranking_page(ranking(joint=HOSTILE))
    assert HOSTILE not in text
    assert "<b>too short</b>" not in text
    titles = ("Which to take", "Errors", "All combinations", "By joint", "Against the truth", "Without an estimate")
    for title in titles:
        assert f">{title}" in text


def test_the_badge_tells_what_comes_before_any_ranking() -> None:
    assert "yours is among the best" in ranking_page(ranking())
    finding = Finding(Remark(HOSTILE), severity=Severity.ERROR)
    text = ranking_page(replace(ranking(), findings=(finding,)))
    assert "correct first what was found" in text
    assert "yours is among the best" not in text
    assert HOSTILE not in text


def test_a_page_without_chance_truth_or_estimates() -> None:
    found = untold(ranking())
    plain = replace(found, rows=tuple(replace(one, truth=None) for one in found.rows), absent=())
    assert "Against the truth" not in ranking_page(plain)
    none = ranking_page(replace(found, rows=found.rows[-1:]))
    assert "By joint" not in none
    assert "no estimate" in none
