from dataclasses import replace

import numpy as np

from dynident.apps.article import findings, study_page, study_tables
from dynident.report.page import plotly_packed
from tests.report.conftest import TRUE, Case, Reproduction, cases


def exact(**changes):
    """A study whose estimates are all right, to spoil one thing at a time."""
    case = Case(1e-6, "spline", np.tile(TRUE, (4, 1)))
    return Reproduction((replace(case, **changes),), runs=4)


def test_a_method_that_always_fails_is_named_and_does_not_stop_the_report():
    lost = exact(estimates=np.empty((0, 7)), failed=4)
    lines = findings(lost)
    assert "1e-6: no run gave an estimate" in lines[0]
    assert lines[-1].startswith("4 of 4 estimations failed and are left out")
    assert lines[-1].endswith(": 4 of smoothing splines at 1e-6.")
    assert "sample mean of 4 estimates" in study_page(lost)


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


def test_a_page_of_many_runs_is_small_and_its_texts_are_escaped(reproduction):
    odd = {"scenario": "<script>x", "description": "<b>y", "settings": {"<i>": "<u>z"}}
    page = study_page(replace(reproduction, cases=tuple(cases(1000)), **odd))
    assert len(page) - len(plotly_packed()) < 1_000_000
    for text in ("<script>x", "<b>y", "<i>", "<u>z"):
        assert text not in page.split("</head>")[1]
