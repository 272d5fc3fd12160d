"""What changed is said once, in words."""

from __future__ import annotations

from dataclasses import replace

from dynident.apps.tuning import Tuning
from dynident.apps.tuning.edit import setting_changes
from dynident.regression import ParallelFilter

START = Tuning((0.0, 0.0), (("viscous",), ("viscous", "coulomb")), (0.0, 0.0), "least_squares")


def test_nothing_changed() -> None:
    assert setting_changes(START, START, ("a", "b")) == []


def test_the_same_of_all_joints_is_said_once() -> None:
    assert setting_changes(START, START.with_degree(1.0), ("a", "b")) == [
        ("smoothing of all joints", "S/n = 1.00", "S/n = 10.0")
    ]
    assert setting_changes(START, START.with_degree(1.0, 1), ("a", "b")) == [
        ("smoothing of b", "S/n = 1.00", "S/n = 10.0")
    ]


def test_each_setting_is_said() -> None:
    now = replace(
        START.exclude("monday", 1.0, 2.5),
        terms=(("viscous", "dahl"), START.terms[1]),
        min_speed=(0.1, 0.0),
        unfitted=("b",),
        filter=ParallelFilter(decimate=4),
        estimator="consistent",
        time_offset=0.002,
    )
    assert setting_changes(START, now, ("a", "b")) == [
        ("minimum speed of a", "0", "0.100"),
        ("terms of a", "viscous", "viscous, dahl"),
        ("joints not fitted", "none", "b"),
        ("parallel filter", "none", "low-pass of order 4 at 0.8 of half the decimated rate, one of 4 samples kept"),
        ("estimator", "least squares", "physically consistent"),
        ("time offset", "0 ms", "2.000 ms"),
        ("samples of monday", "used", "without 1.000 to 2.500 s"),
    ]
    assert ("samples of monday", "without 1.000 to 2.500 s", "used again") in setting_changes(now, START, ("a", "b"))
