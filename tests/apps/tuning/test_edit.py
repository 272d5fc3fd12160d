"""Each control makes the next setting, of all joints or of the one that is drawn."""

from __future__ import annotations

from dataclasses import replace

import pytest

from dynident.apps.tuning import Bench
from dynident.apps.tuning.edit import apply_control
from dynident.apps.tuning.view import View
from dynident.regression import ParallelFilter
from dynident.runtime import ConfigError


def test_what_acts_on_joints_acts_on_all_or_on_one(validated_arm: Bench) -> None:
    view = View.start(validated_arm)
    assert set(apply_control(view, "degree", 1.5, validated_arm).tuning.degree) == {1.5}
    one = apply_control(view, "reach:one", None, validated_arm)
    assert one.alone
    assert apply_control(one, "degree", "1.5", validated_arm).tuning.degree == (1.5, *validated_arm.start.degree[1:])
    last = apply_control(one, f"joint:{validated_arm.joints[-1]}", None, validated_arm)
    assert apply_control(last, "min_speed", 0.2, validated_arm).tuning.min_speed == (
        *validated_arm.start.min_speed[:-1],
        0.2,
    )
    assert set(apply_control(view, "min_speed", None, validated_arm).tuning.min_speed) == {0.0}


def test_a_term_is_switched_where_it_differs(validated_arm: Bench) -> None:
    view, kind = View.start(validated_arm), validated_arm.kinds[-1]
    had = kind in validated_arm.start.terms[0]
    some = apply_control(replace(view, alone=True), f"term:{kind}", None, validated_arm)
    assert (kind in some.tuning.terms[0]) is not had
    assert some.tuning.terms[1:] == validated_arm.start.terms[1:]
    every = apply_control(replace(some, alone=False), f"term:{kind}", None, validated_arm)
    assert all((kind in terms) is had for terms in every.tuning.terms)


def test_the_filter_is_none_where_it_does_nothing(validated_arm: Bench) -> None:
    view = apply_control(View.start(validated_arm), "filter:low-pass", None, validated_arm)
    assert view.tuning.filter == ParallelFilter(decimate=5)
    view = apply_control(view, "cutoff", 12.0, validated_arm)
    assert apply_control(view, "decimate", 1, validated_arm).tuning.filter == ParallelFilter(cutoff=12.0)
    assert (
        apply_control(apply_control(view, "cutoff", None, validated_arm), "decimate", 1, validated_arm).tuning.filter
        is None
    )
    assert apply_control(view, "filter:none", None, validated_arm).tuning.filter is None


def test_samples_joints_estimator_and_offset(validated_arm: Bench) -> None:
    view = apply_control(View.start(validated_arm), "exclude", [3.0, 1.0], validated_arm)
    assert view.tuning.excluded == (("monday", 1.0, 3.0),)
    assert apply_control(view, "include:0", None, validated_arm).tuning == validated_arm.start
    assert (
        apply_control(view, f"fitted:{validated_arm.joints[0]}", None, validated_arm).tuning.unfitted
        == validated_arm.joints[:1]
    )
    assert apply_control(view, "estimator:consistent", None, validated_arm).tuning.estimator == "consistent"
    assert apply_control(view, "offset", 2.5, validated_arm).tuning.time_offset == 0.0025
    assert apply_control(view, "reset", None, validated_arm).tuning == validated_arm.start


def test_a_mark_is_where_its_rule_chooses(validated_arm: Bench) -> None:
    marks = validated_arm.curve(validated_arm.start).marks
    assert apply_control(View.start(validated_arm), "mark:GCV", None, validated_arm).tuning.degree == marks["GCV"]
    alone = replace(View.start(validated_arm), alone=True)
    found = apply_control(alone, "mark:GCV", None, validated_arm).tuning.degree
    assert found == (marks["GCV"][0], *validated_arm.start.degree[1:])


@pytest.mark.parametrize(
    ("control", "value", "words"),
    [
        ("degree", "much", "no number"),
        ("degree", 9, "from -6 to 6"),
        ("degree", "nan", "from -6 to 6"),
        ("min_speed", -1, "at least 0"),
        ("decimate", 2.5, "must be a whole number"),
        ("cutoff", -1, "positive"),
        ("offset", "inf", "time offset is inf"),
        ("exclude", [1.0, 1.0], "drag over some samples"),
        ("exclude", [None, 1.0], "no number"),
        ("mark:best", None, "there is no mark 'best'"),
        ("estimator:lucky", None, "there is no estimator 'lucky'"),
        ("colour", 1, "there is no control 'colour'"),
    ],
)
def test_what_makes_no_sense_is_said(validated_arm: Bench, control: str, value: object, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        apply_control(View.start(validated_arm), control, value, validated_arm)
