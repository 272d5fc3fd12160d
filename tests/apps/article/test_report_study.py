import io
from dataclasses import replace

import numpy as np
import rich.console

from dynident.apps.article import findings, study_page, study_tables, study_text
from dynident.report.page import plotly_packed
from tests.report.conftest import TRUE, Case, Reproduction, cases


def text_of(*renderables, width=80):
    console = rich.console.Console(width=width, file=io.StringIO(), color_system=None)
    for renderable in renderables:
        console.print(renderable)
    return console.file.getvalue()


def exact(**changes):
    """A study whose estimates are all right, to spoil one thing at a time."""
    case = Case(1e-6, "spline", np.tile(TRUE, (4, 1)))
    return Reproduction((replace(case, **changes),), runs=4)


def test_findings_are_in_percent_of_the_true_value():
    lines = findings(exact())
    assert lines[0].endswith("1e-6: smoothing splines 0 %.")
    assert lines[1:] == ["All 4 estimations succeeded."]
    printed = tuple(TRUE * 1.02)[:3] + (None,) * 4
    assert "of the true value: smoothing splines 2.0 %." in findings(exact(published_mean=printed))[1]


def test_a_method_that_always_fails_is_named_and_does_not_stop_the_report():
    lost = exact(estimates=np.empty((0, 7)), failed=4)
    lines = findings(lost)
    assert "1e-6: no run gave an estimate" in lines[0]
    assert lines[-1].startswith("4 of 4 estimations failed and are left out")
    assert lines[-1].endswith(": 4 of smoothing splines at 1e-6.")
    assert "sample mean of 4 estimates" in study_page(lost)


def test_methods_and_levels_beyond_the_article_have_no_published_column():
    table, _ = study_tables(Reproduction((Case(1e-5, "kalman", np.tile(TRUE, (4, 1))),)))
    assert table.caption.startswith("Sample mean of")
    assert [(column.group, column.title) for column in table.columns] == [("", "par."), ("", "true"), ("kalman", "own")]


def test_terminal_text_fits_eighty_columns_and_keeps_every_name(reproduction):
    shown = text_of(study_text(reproduction))
    assert max(map(len, shown.splitlines())) <= 80
    assert shown.count("\ntheta5 ") == 6
    assert "All 108 estimations succeeded." in shown


def with_bound(reproduction):
    """Least variances of one percent of each value."""
    return replace(reproduction, bounds=dict.fromkeys((1e-8, 1e-6, 1e-4), (0.01 * TRUE) ** 2))


def test_the_bound_stands_beside_the_variances(reproduction):
    bounded = with_bound(reproduction)
    tables = study_tables(bounded)
    assert [len(table.columns) for table in tables] == [8, 8] * 3 + [12]
    assert len(tables[-1].rows) == 9
    near = next(line for line in findings(bounded) if "over the Cramér-Rao bound" in line)
    assert near.count("(at most ") == 3
    assert "Ratios scatter by 20\u00a0%" in study_page(bounded)


def test_a_method_exactly_at_the_bound_has_ratio_one():
    estimates = np.concatenate([TRUE * np.ones((2, 7)) * 1.01, TRUE * np.ones((2, 7)) * 0.99])
    table = study_tables(with_bound(exact(estimates=estimates)))[-1]
    assert set(table.rows[0][2:9]) == {"1.0"}


def test_a_page_of_many_runs_is_small_and_its_texts_are_escaped(reproduction):
    odd = {"scenario": "<script>x", "description": "<b>y", "settings": {"<i>": "<u>z"}}
    page = study_page(replace(reproduction, cases=tuple(cases(1000)), **odd))
    assert len(page) - len(plotly_packed()) < 1_000_000
    for text in ("<script>x", "<b>y", "<i>", "<u>z"):
        assert text not in page.split("</head>")[1]
