import re
from dataclasses import replace

import numpy as np
import polars as pl
import pytest

from dynident.apps.fleets import Changes, ChangeShape, History, residual_groups
from dynident.apps.fleets.changes_report import change_words
from dynident.apps.fleets.report import fleet_findings, fleet_heading, fleet_page, fleet_tables
from dynident.regression import GroupKind
from dynident.report.page import _plotly_source
from dynident.report.terminal import terminal_table
from dynident.runtime.jobs import Status
from tests.apps.article.test_report_study import text_of
from tests.report.fleets import NONE, RESIDUAL, change, fleet, groups, history
from tests.report.test_page import Outline


@pytest.fixture(scope="module")
def found():
    return fleet()


@pytest.fixture(scope="module")
def page(found):
    return fleet_page(found)


def own(page):
    """The page without plotly's script."""
    return page.replace(_plotly_source(), "")


def test_what_changed_comes_first_the_worst_before_all(found):
    load, wear, offset, few, lost = fleet_findings(found)
    assert load.startswith(
        "arm-0: payload at elbow changed on 2026-07-06: hand.mass by +0.500 +- 0.050 kg, hand.mz by "
    )
    assert wear.startswith("arm-1: friction of elbow has been rising since 2026-05-12: Fc_elbow by +1.50 +- 0.050 N m")
    assert wear.endswith(" (+0.949 in 100 days).")
    assert offset.startswith("arm-2: offset of elbow changed on 2026-05-15 (at once or slowly: the logs do not tell): ")
    assert offset.endswith("offset_elbow by -0.400 +- 0.050 N m.")
    assert (few, lost) == ("Too few logs to find changes: new.", "1 of 201 logs has no result: 1 timed out.")
    assert fleet_heading(found) == "201 logs of 10 robots, 2026-01-06 to 2026-11-01."


def test_the_page_says_the_rate_of_false_alarms(page):
    text = re.sub(r"\s+", " ", own(page)).replace("\u00a0", " ")
    assert "3 robots changed" in text
    assert "Of 10 robots, in which nothing changes, 0.10 would be listed here by chance (1 %)." in text
    assert "200 of 201" in text
    assert "step or drift" in text  # where the odds do not tell
    assert "± 0.050 kg" in text


@pytest.mark.parametrize(
    ("shape", "size", "words"),
    [
        (ChangeShape.STEP, [0.0, 1.0], "friction of shoulder rose on"),
        (ChangeShape.STEP, [-1.0, 0.0], "friction of shoulder fell on"),
        (ChangeShape.STEP, [-1.0, 1.0], "friction of shoulder changed on"),
        (ChangeShape.DRIFT, [1.0, 1.0], "friction of shoulder has been rising since"),
        (ChangeShape.DRIFT, [1.0, -1.0], "friction of shoulder has been drifting since"),
        (ChangeShape.STEP, [0.01, 0.02], "friction of shoulder rose on"),  # the clearest, where none is certain
    ],
)
def test_words_follow_what_is_certain(found, shape, size, words):
    one = change(history("arm-0"), groups()[0], shape, 8, size)
    made = replace(found, changes=(Changes(0.01, (one,), {"arm-0": 0.001}, (), NONE),))
    assert words in fleet_findings(made)[0]


@pytest.mark.parametrize(
    ("size", "word"),
    [([-3.0, 4.0], "rising"), ([3.0, -2.0], "falling"), ([3.0, 4.0], "rising"), ([0.0, 0.0], "drifting")],
)
def test_a_ripple_rises_by_its_size_whatever_its_phase(found, size, word):
    ripple = replace(groups()[0], kind=GroupKind.RIPPLE)
    one = change(history("arm-0"), ripple, ChangeShape.DRIFT, 8, size)
    assert f"ripple of shoulder has been {word} since" in change_words(one, found.start, np.array([-2.0, 3.0]))
    assert "has been drifting" in change_words(one, found.start, np.full(2, np.nan))


def test_torque_that_the_model_leaves_is_worded_with_what_to_do_and_drawn(found):
    """Of a joint of a robot whose payload changed, too; as a torque, with a rise of its logarithm in percent."""
    left = [
        History(one.robot, one.logs, one.days, np.full((20, 2), np.log(0.5)), np.tile(400 * np.eye(2), (20, 1, 1)))
        for one in found.histories
    ]
    group = residual_groups(found.base.joints)[1]
    rise = change(left[0], group, ChangeShape.STEP, 8, [np.log(1.5)], std=np.array([0.02]), p_value=0.0005)
    changes = replace(found.changes[0], changes=(*found.changes[0].changes, rise), residual_scatter=RESIDUAL)
    made = replace(found, residuals=tuple(left), changes=(changes,))
    words = fleet_findings(made)[0]
    assert words.startswith("arm-0: torque that the model leaves at elbow rose on ")
    assert "residual by +50.0 +- 3.0 %. No term of the recipe describes this: look at the residual" in words
    fell = replace(changes, changes=(replace(rise, size=-rise.size),))
    assert fleet_findings(replace(made, changes=(fell,)))[0].endswith(": residual by -33.3 +- 1.3 %.")
    page = own(fleet_page(made))
    assert page.count("torque that the model leaves at elbow rose") >= 2  # in words and below the figure
    assert "torque that the model leaves at shoulder" in page  # side by side
    assert "Robots of type ur10" in page
    assert "+50.0 +- 3.0 %" in text_of(*map(terminal_table, fleet_tables(made)), width=160)


def test_a_direction_that_no_log_shows_is_not_named(found):
    one = change(history("arm-0"), groups()[0], ChangeShape.STEP, 8, [9.0, 1.0], std=np.array([np.inf, 0.1]))
    made = replace(found, changes=(Changes(0.01, (one,), {"arm-0": 0.001}, (), NONE),))
    assert "Fv_shoulder" not in fleet_findings(made)[0]


def test_a_quiet_fleet(found):
    quiet = fleet(changed=0)
    assert fleet_findings(quiet)[0] == "No change is found on 10 robots."
    page = own(fleet_page(quiet))
    assert "no change" in page
    assert "Robots that changed" not in page
    assert len(fleet_tables(quiet)) == 2
    unknown = replace(quiet, changes=())
    assert fleet_findings(unknown) == ["1 of 201 logs has no result: 1 timed out."]
    assert "too few logs to say" in fleet_page(unknown)


def test_a_fleet_without_any_result_has_a_page(found):
    rows = found.rows.with_columns(
        *(
            pl.lit(text).alias(name)
            for name, text in (("status", Status.FAILED.value), ("reason", "no column 'q1'"), ("folder", ""))
        ),
        *(pl.lit(None).cast(found.rows.schema[name]).alias(name) for name in ("error", "errors", "verdict", "date")),
    )  # fmt: skip
    page = own(fleet_page(replace(found, rows=rows, histories=(), changes=(), pooled={}, start=None)))
    assert "201 of 201 logs have no result" in page
    assert 'class="plot"' not in page


def test_every_log_leads_to_its_report_and_says_what_became_of_it(page):
    links = [attrs["href"] for tag, attrs in Outline(page).tags if tag == "a"]
    reports = [link for link in links if not link.startswith("#")]
    assert len(reports) == 200
    assert reports[0] == "./runs/arm-0/0/report.html"
    text = own(page)
    assert "longer than 5 s" in text
    assert "timed out" in text
    assert "5.00 (elbow)" in text


def test_each_robot_that_changed_is_drawn_and_all_side_by_side(page):
    text = own(page)
    assert re.findall(r"<h3>(.*?)</h3>", text) == ["arm-0", "arm-1", "arm-2"]
    assert re.findall(r'<button type="button">(.*?)</button>', text)[1:4] == [
        "payload at elbow", "friction of elbow", "offset of elbow",
    ]  # fmt: skip
    assert "Robots of type ur10" in text


def test_types_are_drawn_apart(found):
    names = found.types["ur10"]
    page = own(fleet_page(replace(found, types={"ur10": names[:6], "ur5": names[6:], "none": ("gone",)})))
    assert re.findall(r'<div class="choices" role="group" aria-label="(.*?)"', page) == ["type", "group"]
    assert re.findall(r"<button.*?>(ur.*?)</button>", page) == ["ur10", "ur5"]
    assert page.count('<div class="view"') == 2 * len(found.groups)


@pytest.mark.parametrize(("robots", "logs"), [(10, 500), (500, 10)])
def test_a_page_of_5000_logs_stays_small_and_says_what_it_leaves_out(robots, logs):
    page = own(fleet_page(fleet(robots, logs)))
    assert len(page) < 3e6
    assert page.count('href="./runs') <= 2500
    assert "`fleet.parquet` has all" in page.replace("<code>", "`").replace("</code>", "`")
    if robots == 500:
        assert "Drawn are 48 of 500 robots" in page
        assert "of the first 300 robots" in page


def test_many_changes_are_counted_and_few_are_drawn():
    made = fleet(60, 8)
    kinds = groups()
    some = [change(one, kinds[0], ChangeShape.STEP, 4, [1.0, 0.0]) for one in made.histories]
    made = replace(made, changes=(Changes(0.01, tuple(some), {one.robot: 0.0 for one in some}, (), NONE),))
    assert "There are 52 more changes; the table has them." in fleet_findings(made)
    page = own(fleet_page(made))
    assert "The changes of 20 more robots are in the table above only." in page
    assert len(fleet_tables(made)[0].rows) == 20
    assert fleet_tables(made)[0].caption == "Changes, worst first, the 20 worst of 60"


def test_tables_of_a_terminal(found):
    shown = text_of(*map(terminal_table, fleet_tables(found)), width=100)
    lines = shown.splitlines()
    assert lines[0] == "Changes, worst first"
    assert lines[3].startswith("arm-0  payload at elbow")
    robots = lines.index("Robots")
    assert [line.split()[0] for line in lines[robots + 3 : robots + 6]] == ["arm-0", "arm-1", "arm-2"]
    assert "longer than 5 s" in lines[-2]
