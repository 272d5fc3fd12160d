"""All settings as one value."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from dynident.apps.tuning import Tuning
from dynident.runtime import ConfigError

START = Tuning((0.0, 0.0), (("viscous",), ()), (0.0, 0.0), "least_squares")


def test_it_is_a_value() -> None:
    assert hash(START.with_degree(1.0)) == hash(replace(START, degree=(1.0, 1.0)))
    assert START.with_degree(1.0, 0).degree == (1.0, 0.0)
    assert START.with_terms(1, ["coulomb"]).terms == (("viscous",), ("coulomb",))


def test_windows_that_meet_are_one() -> None:
    tuning = START.exclude("a", 1.0, 2.0).exclude("b", 0.0, 1.0).exclude("a", 4.0, 5.0).exclude("a", 2.0, 3.0)
    assert tuning.windows("a") == ((1.0, 3.0), (4.0, 5.0))
    assert tuning.windows("b") == ((0.0, 1.0),)
    assert tuning.exclude("a", 0.0, 9.0).windows("a") == ((0.0, 9.0),)
    assert tuning.windows("c") == ()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"degree": (9.0, 0.0)}, r"log10\(S/n\), is 9"),
        ({"degree": (float("nan"), 0.0)}, "degree"),
        ({"min_speed": (-1.0, 0.0)}, "minimum speed is -1"),
        ({"time_offset": float("inf")}, "time offset is inf"),
        ({"excluded": (("a", 2.0, 1.0),)}, "'a': 2 to 1 s; it must stop after it starts"),
        ({"excluded": (("a", 2.0, float("nan")),)}, "excluded window of 'a'"),
    ],
)
def test_numbers_out_of_range_are_refused(change: dict[str, Any], words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        replace(START, **change)
