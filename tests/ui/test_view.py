"""An address says what a page shows, and nothing else is taken."""

from __future__ import annotations

from dataclasses import replace

import pytest

from dynident.errors import ConfigError
from dynident.tuning import Bench
from dynident.ui.view import View


def test_there_and_back(arm: Bench) -> None:
    view = View.start(arm)
    assert view.to_query(arm) == ""
    assert View.of_query("", arm) == view
    other = View(arm.start.with_degree(0.7).excluding("monday", 1.0, 2.0), arm.joints[1], "tuesday", alone=True)
    text = other.to_query(arm)
    assert text.startswith("?degree=0.7&exclude=monday:1.0:2.0&")
    assert View.of_query(text, arm) == other
    assert View.of_query(replace(view, log="tuesday").to_query(arm), arm).log == "tuesday"


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
def test_what_makes_no_sense_is_said(arm: Bench, text: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        View.of_query(text, arm)
