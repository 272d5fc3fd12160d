"""An address says what a page shows, and nothing else is taken."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from dynident.apps.tuning import Bench
from dynident.apps.tuning.tuning import Tuning
from dynident.apps.tuning.view import View
from dynident.regression import ParallelFilter
from dynident.runtime import ConfigError

CHANGES: dict[str, Callable[[Tuning], Tuning]] = {
    "nothing": lambda start: start,
    "all joints": lambda start: start.with_degree(0.1 + 0.2),
    "one joint": lambda start: start.with_degree(-1.0, 1),
    "terms": lambda start: start.with_terms(0, ()).with_terms(1, ("stribeck", "viscous")),
    "windows": lambda start: start.exclude("monday", 1.25, 3.5).exclude("tuesday", 0.0, 1e-3),
    "the rest": lambda start: replace(
        start, min_speed=(0.02, 0.0, 0.1), estimator="consistent", unfitted=("rail",), time_offset=-0.0032
    ),
    "filter": lambda start: replace(start, filter=ParallelFilter(cutoff=12.5, order=2)),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_there_and_back(validated_arm: Bench, change: Callable[[Tuning], Tuning]) -> None:
    for view in (
        replace(View.start(validated_arm), tuning=change(validated_arm.start)),
        View(change(validated_arm.start), validated_arm.joints[1], "tuesday", alone=True),
    ):
        text = view.to_query(validated_arm)
        assert View.of_query(text, validated_arm) == view
        assert set('"<> ').isdisjoint(text)
        assert text.isascii()


def test_only_what_differs_from_the_start_is_said(validated_arm: Bench) -> None:
    view = View.start(validated_arm)
    assert view.to_query(validated_arm) == ""
    shown = replace(view, tuning=validated_arm.start.exclude("monday", 1.0, 2.0), log="tuesday")
    assert shown.to_query(validated_arm) == "?excluded=[[%22monday%22,1.0,2.0]]&log=%22tuesday%22"
    filtered = replace(validated_arm, start=replace(validated_arm.start, filter=ParallelFilter(decimate=2)))
    assert view.to_query(filtered) == "?filter=null"  # what is taken back is said, too
    assert View.of_query("?filter=null", filtered) == view


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('joint="knee"', "there is no joint 'knee'"),
        ("joint=[]", "there is no joint"),
        ('log="../etc/passwd"', "there is no log"),
        ("speed=1", "there is no setting 'speed'"),
        ("degree=high", "degree is 'high', which is no JSON"),
        ("degree=" + "[" * 9000, "no JSON"),
        ("degree=NaN", "no JSON"),
        ("degree=%ff", "no JSON"),
        ("degree", "no JSON"),
        ('degree=["a",0,0]', r"degree\[0\]: should be a valid number"),
        ("degree=[99,0,0]", "log10"),
        ("degree=[1]", "degree has 1 entries for 3 joints"),
        ('estimator="magic"', "there is no estimator 'magic'"),
        ('terms=[["rust"],[],[]]', "there is no kind of terms 'rust'"),
        ('excluded=[["monday",1]]', r"excluded\[0\]"),
        ('excluded=[["friday",1,2]]', "there is no log 'friday'"),
        ('unfitted=["knee"]', "there is no joint 'knee'"),
        ('filter={"decimate":2.5}', r"filter.decimate: should be a valid integer"),
        ('filter={"decimate":1}', "parallel filter"),
        ("time_offset=1e9", "time offset"),
        ("x" * 30_000, "30001 characters"),
    ],
)
def test_what_makes_no_sense_is_said(validated_arm: Bench, text: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        View.of_query(f"?{text}", validated_arm)
