"""Whole identifications are of the settings that pages wait for, and of no others."""

from __future__ import annotations

import threading
from types import SimpleNamespace

from dynident.errors import InputError, Step
from dynident.tuning import Tuning
from dynident.ui.whole import WholeRuns

ONE, TWO, THREE = (Tuning((float(k),), ((),), (0.0,), "least_squares") for k in (1, 2, 3))


def waited(runs: WholeRuns, tuning: Tuning):
    with runs._changed:
        assert runs._changed.wait_for(lambda: tuning in runs._ended, 10) or runs.ended(tuning)
    return runs.ended(tuning)


class Slow:
    """Identifies when it is let."""

    def __init__(self):
        self.begun, self.go, self.asked = threading.Event(), threading.Event(), []

    def __call__(self, tuning, progress):
        self.asked.append(tuning)
        progress(Step("smoothing", 1, 4))
        self.begun.set()
        self.go.wait(10)
        progress("fitting")
        if tuning == THREE:
            raise InputError("nothing is left.")
        return SimpleNamespace(of=tuning)


def test_what_nobody_waits_for_any_longer_is_given_up():
    slow = Slow()
    runs = WholeRuns(slow)
    runs.want("page", ONE)
    assert slow.begun.wait(10)
    assert runs.step(ONE) == "smoothing (1 of 4)"
    assert runs.step(TWO) == "waiting"
    runs.want("page", TWO)
    slow.go.set()
    runs.want("other page", THREE)
    assert waited(runs, TWO).found.of == TWO
    assert waited(runs, THREE).failed == "nothing is left."
    assert runs.ended(ONE) is None
    assert slow.asked == [ONE, TWO, THREE]
    runs.want("page", TWO)  # known by now
    assert slow.asked == [ONE, TWO, THREE]


def test_a_fault_ends_a_setting_and_not_the_runs():
    def identify(tuning, progress):
        if tuning == ONE:
            raise RuntimeError("no")
        return SimpleNamespace(of=tuning)

    runs = WholeRuns(identify)
    runs.want("page", ONE)
    assert "fault of dynident: RuntimeError: no" in waited(runs, ONE).failed
    runs.want("page", TWO)
    assert waited(runs, TWO).found.of == TWO
