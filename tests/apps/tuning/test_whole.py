"""Whole identifications are of the settings that pages wait for, and of no others."""

from __future__ import annotations

import threading
from types import SimpleNamespace

from dynident.apps.tuning import Tuning
from dynident.apps.tuning.session import WholeRuns
from dynident.runtime import InputError, Step, report_progress

ONE, TWO, THREE = (Tuning((float(k),), ((),), (0.0,), "least_squares") for k in (1, 2, 3))


def waited(runs: WholeRuns, tuning: Tuning):
    with runs._changed:
        assert runs._changed.wait_for(lambda: tuning in runs._ended, 10) or runs.outcome(tuning)
    return runs.outcome(tuning)


class Slow:
    """Identifies when it is let."""

    def __init__(self):
        self.begun, self.go, self.asked = threading.Event(), threading.Event(), []

    def __call__(self, tuning):
        self.asked.append(tuning)
        report_progress(Step("smoothing", 1, 4))
        self.begun.set()
        self.go.wait(10)
        report_progress("fitting")
        if tuning == THREE:
            raise InputError("nothing is left.")
        return SimpleNamespace(of=tuning)


def test_what_nobody_waits_for_any_longer_is_given_up():
    slow = Slow()
    runs = WholeRuns(slow)
    runs.request_run("page", ONE)
    assert slow.begun.wait(10)
    assert runs.step(ONE) == "smoothing (1 of 4)"
    assert runs.step(TWO) == "waiting"
    runs.request_run("page", TWO)
    slow.go.set()
    runs.request_run("other page", THREE)
    assert waited(runs, TWO).result.of == TWO
    assert waited(runs, THREE).failed == "nothing is left."
    assert runs.outcome(ONE) is None
    assert slow.asked == [ONE, TWO, THREE]
    runs.request_run("page", TWO)  # known by now
    assert slow.asked == [ONE, TWO, THREE]


def test_a_fault_ends_a_setting_and_not_the_runs():
    def identify(tuning):
        if tuning == ONE:
            raise RuntimeError("no")
        return SimpleNamespace(of=tuning)

    runs = WholeRuns(identify)
    runs.request_run("page", ONE)
    assert "fault of dynident: RuntimeError: no" in waited(runs, ONE).failed
    runs.request_run("page", TWO)
    assert waited(runs, TWO).result.of == TWO
