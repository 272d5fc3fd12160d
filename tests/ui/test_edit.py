"""Each control makes the next setting, of all joints or of the one that is drawn."""

from __future__ import annotations

from dataclasses import replace

import pytest

from dynident.errors import ConfigError
from dynident.regression import ParallelFilter
from dynident.tuning import Bench
from dynident.ui.edit import edited
from dynident.ui.view import View


def test_what_acts_on_joints_acts_on_all_or_on_one(arm: Bench) -> None:
    view = View.start(arm)
    assert set(edited(view, "degree", 1.5, arm).tuning.degree) == {1.5}
    one = edited(view, "reach:one", None, arm)
    assert one.alone
    assert edited(one, "degree", "1.5", arm).tuning.degree == (1.5, *arm.start.degree[1:])
    last = edited(one, f"joint:{arm.joints[-1]}", None, arm)
    assert edited(last, "min_speed", 0.2, arm).tuning.min_speed == (*arm.start.min_speed[:-1], 0.2)
    assert set(edited(view, "min_speed", None, arm).tuning.min_speed) == {0.0}


def test_a_term_is_switched_where_it_differs(arm: Bench) -> None:
    view, kind = View.start(arm), arm.kinds[-1]
    had = kind in arm.start.terms[0]
    some = edited(replace(view, alone=True), f"term:{kind}", None, arm)
    assert (kind in some.tuning.terms[0]) is not had
    assert some.tuning.terms[1:] == arm.start.terms[1:]
    every = edited(replace(some, alone=False), f"term:{kind}", None, arm)
    assert all((kind in terms) is had for terms in every.tuning.terms)


def test_the_filter_is_none_where_it_does_nothing(arm: Bench) -> None:
    view = edited(View.start(arm), "filter:low-pass", None, arm)
    assert view.tuning.filter == ParallelFilter(decimate=5)
    view = edited(view, "cutoff", 12.0, arm)
    assert edited(view, "decimate", 1, arm).tuning.filter == ParallelFilter(cutoff=12.0)
    assert edited(edited(view, "cutoff", None, arm), "decimate", 1, arm).tuning.filter is None
    assert edited(view, "filter:none", None, arm).tuning.filter is None


def test_samples_joints_estimator_and_offset(arm: Bench) -> None:
    view = edited(View.start(arm), "exclude", [3.0, 1.0], arm)
    assert view.tuning.excluded == (("monday", 1.0, 3.0),)
    assert edited(view, "include:0", None, arm).tuning == arm.start
    assert edited(view, f"fitted:{arm.joints[0]}", None, arm).tuning.unfitted == arm.joints[:1]
    assert edited(view, "estimator:consistent", None, arm).tuning.estimator == "consistent"
    assert edited(view, "offset", 2.5, arm).tuning.time_offset == 0.0025
    assert edited(view, "reset", None, arm).tuning == arm.start


def test_a_mark_is_where_its_rule_chooses(arm: Bench) -> None:
    marks = arm.curve(arm.start).marks
    assert edited(View.start(arm), "mark:GCV", None, arm).tuning.degree == marks["GCV"]
    alone = replace(View.start(arm), alone=True)
    found = edited(alone, "mark:GCV", None, arm).tuning.degree
    assert found == (marks["GCV"][0], *arm.start.degree[1:])


@pytest.mark.parametrize(
    ("control", "value", "words"),
    [
        ("degree", "much", "no number"),
        ("degree", 9, "from -6 to 6"),
        ("degree", float("nan"), "must be finite"),
        ("min_speed", -1, "at least 0"),
        ("decimate", 2.5, "no whole number"),
        ("exclude", [1.0, 1.0], "drag over some samples"),
        ("exclude", [None, 1.0], "no number"),
        ("mark:best", None, "there is no mark 'best'"),
        ("estimator:lucky", None, "there is no estimator 'lucky'"),
        ("colour", 1, "there is no control 'colour'"),
    ],
)
def test_what_makes_no_sense_is_said(arm: Bench, control: str, value: object, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        edited(View.start(arm), control, value, arm)
