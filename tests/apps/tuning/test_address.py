"""A tuning as the query of an address."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, cast

import pytest

from dynident.apps.tuning import Tuning, parse_query, to_query
from dynident.regression import ParallelFilter
from dynident.runtime import ConfigError

if TYPE_CHECKING:
    from dynident.apps.tuning import Bench

JOINTS = ("elbow", "<b>wrist & co</b>")
LOGS = ("monday", "a:b 1.5")
START = Tuning((0.5, 0.5), (("viscous", "coulomb"), ()), (0.0, 0.1), "consistent", time_offset=0.001)


class Board:
    """As much of a bench as an address needs."""

    start, joints = START, JOINTS

    def check(self, tuning: Tuning) -> None:
        tuning.check(JOINTS, LOGS, ("viscous", "coulomb", "stribeck"), ("consistent", "least_squares"))


BOARD = cast("Bench", Board())
TUNINGS = {
    "start": START,
    "all joints": START.with_degree(0.1 + 0.2),
    "one joint": START.with_degree(-1.0, 1),
    "terms": START.with_terms(0, ()).with_terms(1, ("stribeck", "viscous")),
    "speeds": replace(START, min_speed=(0.02, 0.02)),
    "windows": START.exclude("monday", 1.25, 3.5).exclude("a:b 1.5", 0.0, 1e-3),
    "estimator": replace(START, estimator="least_squares"),
    "unfitted": replace(START, unfitted=(JOINTS[1],)),
    "filter": replace(START, filter=ParallelFilter(decimate=10)),
    "cut-off": replace(START, filter=ParallelFilter(cutoff=12.5, order=2)),
    "offset": replace(START, time_offset=-0.0032),
}


@pytest.mark.parametrize("tuning", TUNINGS.values(), ids=TUNINGS)
def test_there_and_back(tuning: Tuning) -> None:
    text = to_query(tuning, START, JOINTS)
    assert parse_query(text, BOARD) == parse_query(f"?{text}", BOARD) == tuning
    assert text.isascii()
    assert "<" not in text


def test_it_can_be_read() -> None:
    assert to_query(START, START, JOINTS) == ""
    assert to_query(TUNINGS["all joints"], START, JOINTS) == "degree=0.30000000000000004"
    assert to_query(START.with_terms(0, ("viscous",)), START, JOINTS) == "terms.elbow=viscous"
    assert to_query(START.exclude("monday", 1.0, 2.0), START, JOINTS) == "exclude=monday:1.0:2.0"


def test_what_is_taken_back_is_said_too() -> None:
    start = replace(START.exclude("monday", 1.0, 2.0), unfitted=("elbow",), filter=ParallelFilter(decimate=2))
    board = Board()
    board.start = start
    text = to_query(START, start, JOINTS)
    assert text == "exclude=&unfitted=&filter=none"
    assert parse_query(text, cast("Bench", board)) == START


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("speed=1", "there is no field 'speed'"),
        ("degree=high", "degree is 'high'; give a number"),
        ("degree=nan", "degree is 'nan'"),
        ("degree=99", "log10"),
        ("degree.knee=1", "there is no joint 'knee'"),
        ("estimator.elbow=1", "there is no field 'estimator.elbow'"),
        ("estimator=magic", "there is no estimator 'magic'"),
        ("terms.elbow=rust", "there is no kind of terms 'rust'"),
        ("exclude=monday:1", "give LOG:START:STOP"),
        ("exclude=friday:1:2", "there is no log 'friday'"),
        ("unfitted=knee", "there is no joint 'knee'"),
        ("filter=low", "filter is 'low'"),
        ("decimate=2.5", "give a whole number"),
        ("decimate=1", "parallel filter"),
        ("time_offset=1e9", "time offset"),
        ("nonsense", "no list of settings"),
        ("degree=%ff", "no list of settings"),
        ("x" * 30_000, "30000 characters"),
        ("degree=1&" * 1500, "no list of settings"),
    ],
)
def test_what_is_not_understood_is_said(text: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        parse_query(text, BOARD)
