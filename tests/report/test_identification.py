import io
import json

import numpy as np
import pytest
import rich.console
from plotly.offline import get_plotlyjs

from dynident.report.identification import identification_page, identification_tables, result_dict

from .conftest import identification_of
from .test_page import EVIL, Outline


def body(identification):
    return identification_page(identification).replace(get_plotlyjs(), "")


def test_result_holds_plain_floats_by_log_and_joint(identification):
    result = result_dict(identification)
    assert list(result["train"]) == ["swing.csv"]
    assert list(result["validation"]) == ["reach.csv"]
    assert result["train"]["swing.csv"] == {
        "relative_error": 4.2,
        "relative_error_filtered": 1.1,
        "rmse": {"shoulder": 0.02, "elbow": 0.02},
        "per_joint": {"shoulder": 3.5, "elbow": 4.5},
    }
    assert result["validation"]["reach.csv"]["relative_error_filtered"] is None
    assert result["parameters"][2] == {
        "name": "theta3",
        "value": pytest.approx(0.00585),
        "std": float("inf"),
        "unit": "kg m^2",
    }
    assert (result["rank"], result["condition"]) == (6, 143.7)
    assert result["warnings"] == ["elbow hardly moves"]
    assert {"status", "versions", "settings"} < set(result)
    assert json.loads(json.dumps(result)) == result


def test_page_tells_the_findings_in_sentences(identification):
    page = body(identification)
    assert "From 1 log, 7 parameters (6 independent combinations) of two-link arm were estimated" in page
    assert "On 1 log that the fit has not seen, it leaves 5.10\u00a0% unexplained." in page
    assert "6 of 7 parameters have a standard error of at most 10\u00a0%; less certain: theta3." in page
    assert "1 of 7 parameters is not determined by these motions" in page
    assert "elbow hardly moves" in page


def test_page_says_when_nothing_was_held_out_or_warned_of():
    page = body(identification_of(logs=("swing.csv",), warnings=()))
    assert "No log was held out" in page
    assert "<p>None.</p>" in page
    assert "<dt>torque error, held out</dt><dd>-</dd>" in page


def test_several_logs_are_summed_up_by_their_range():
    identification = identification_of(logs=("a", "b", "c"))
    identification.logs[2].relative_error = 7.25
    assert "On 2 logs that the fit has not seen, it leaves 5.10 to 7.25\u00a0% unexplained." in body(identification)


def test_page_shows_every_log_and_joint(identification):
    page = body(identification)
    outline = Outline(page)
    assert outline.count("figure") == 1 + 2 * 2 + 2 * 2
    assert "<h3>swing.csv (training)</h3>" in page
    assert "<h3>reach.csv (held out)</h3>" in page
    assert "elbow: relative error 4.50 %, rmse 0.0200 N m." in page
    assert '<td class="words">theta3</td><td class="number">0.005850</td><td class="number">∞</td>' in page
    assert '<td class="words">elbow</td><td class="number">0.001000</td><td class="number">1200</td>' in page
    assert "swing.csv: method spline, note S = n" in page
    assert "least squares" in page


def test_a_smoother_that_tells_nothing_is_reported_too(identification):
    for log in identification.logs:
        object.__setattr__(log.motion, "smoothing", {})
    assert "Smoothing per log and joint" not in body(identification)


def test_a_parameter_that_is_zero_has_no_relative_error(identification):
    identification.estimate.value = np.zeros(7)
    assert "0 of 7 parameters have a standard error" in body(identification)


@pytest.mark.parametrize("part", ["joints", "logs"])
def test_names_cannot_break_out_of_the_page(part):
    page = body(identification_of(**{part: (EVIL, "other")}))
    outline = Outline(page)
    assert "<script>alert" not in page
    assert outline.count("b") == 0
    figures = [attrs for tag, attrs in outline.tags if attrs.get("type") == "application/json"]
    assert len(figures) == outline.count("figure") == 9
    for text in outline.scripts[1:-1]:
        assert json.loads(text)["data"]


def test_a_page_of_many_logs_and_joints_stays_small():
    joints, logs = tuple(f"joint{i}" for i in range(7)), tuple(f"log{i}" for i in range(5))
    assert len(body(identification_of(joints, logs))) < 1_500_000


def test_terminal_tables_hold_parameters_and_errors(identification):
    console = rich.console.Console(width=100, file=io.StringIO(), color_system=None)
    parameters, logs, joints = identification_tables(identification)
    console.print(parameters, logs, joints)
    shown = console.file.getvalue()
    rows = {line.split()[0]: line.split() for line in shown.splitlines() if line.strip()}
    assert rows["theta1"][:6] == ["theta1", "0.03400", "0.00040", "1.2", "0.03400", "kg"]
    assert rows["theta3"][2:4] == ["inf", "inf"]
    assert (parameters.row_count, logs.row_count, joints.row_count) == (7, 2, 4)
