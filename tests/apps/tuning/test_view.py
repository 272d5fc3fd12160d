"""An address says what a page shows, and nothing else is taken."""

from __future__ import annotations

from dataclasses import replace

import pytest

from dynident.apps.tuning import Bench
from dynident.apps.tuning.answers import View
from dynident.runtime import ConfigError


def test_there_and_back(validated_arm: Bench) -> None:
    view = View.start(validated_arm)
    assert view.to_query(validated_arm) == ""
    assert View.of_query("", validated_arm) == view
    other = View(
        validated_arm.start.with_degree(0.7).exclude("monday", 1.0, 2.0), validated_arm.joints[1], "tuesday", alone=True
    )
    text = other.to_query(validated_arm)
    assert text.startswith("?degree=0.7&exclude=monday:1.0:2.0&")
    assert View.of_query(text, validated_arm) == other
    assert View.of_query(replace(view, log="tuesday").to_query(validated_arm), validated_arm).log == "tuesday"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("?show_joint=knee", "show_joint=knee: there is no such one"),
        ("?show_log=../etc/passwd", "there is no such one"),
        ("?degree=nan", "give a number"),
        ("?script=1", "no field 'script'"),
        ("?" + "a=1&" * 9000, "more than"),
    ],
)
def test_what_makes_no_sense_is_said(validated_arm: Bench, text: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        View.of_query(text, validated_arm)
