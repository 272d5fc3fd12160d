"""The verdict as a reader meets it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from dynident.identification import Remedy, judge
from dynident.identification.verdict_steps import HoldOutFaster
from dynident.models.simulation import Broken
from dynident.report.identification import identification_page, report
from dynident.report.identification.report import next_step_texts
from dynident.validation import Driver
from tests.report.conftest import identification_of
from tests.report.test_page import EVIL


def run(name="reach.csv", joints=("shoulder", "elbow"), failure=None):
    each = dict.fromkeys(joints, np.inf if failure else 3.5)
    t = np.linspace(0.0, 1.0, 50)
    q = np.outer(t, np.arange(1.0, len(joints) + 1))
    return SimpleNamespace(
        t=t, q=np.full_like(q, np.inf) if failure else q + 0.01, measured=q, name=name, joints=joints,
        driver=Driver.TORQUE, restart=0.5, relative_error=each, motion_error=each, rms=each, torque_error={},
        failure=failure,
    )  # fmt: skip


def test_the_terminal_gives_remedies_and_the_largest_gains(monkeypatch):
    steps = [HoldOutFaster(float(k)) for k in range(9, 1, -1)]
    result = judge(identification_of(logs=("swing.csv",)))
    monkeypatch.setattr(report, "judge", lambda _: replace(result, next=(Remedy.HOLD_OUT, *steps)))

    said = next_step_texts(identification_of())
    assert said == (Remedy.HOLD_OUT, *map(str, steps[:5]), "3 more, which the report lists.")


def test_free_simulations_are_shown_with_their_failures(identification):
    identification.runs = (run(), run("swing.csv", failure=Broken("it runs away")))
    page = identification_page(identification)
    assert "torque, 0.5 s" in page
    assert '<dd>fails</dd><dd class="note">swing.csv: it runs away</dd>' in page
    assert page.count("elbow: measured and simulated position.") == 2  # the figure's label and its caption
    assert "swing.csv: it runs away" in page


def test_of_a_single_joint_the_error_is_given_in_its_unit():
    identification = identification_of(joints=("slider",))
    identification.model.limits.clear()
    for log in identification.validations:
        log.errors.effort_share = {}
    identification.runs = (run(joints=("slider",)),)
    page = identification_page(identification)
    assert "<dt>position error, free simulation</dt><dd>3.5 %</dd>" in page
    assert '<dt>largest rms error, held out</dt><dd>0.0200 N m</dd><dd class="note">slider, reach.csv</dd>' in page
    assert "worst joint" not in page


def test_names_cannot_break_out_of_the_verdict():
    identification = identification_of(joints=(EVIL, "elbow"), logs=(EVIL, "other"))
    identification.runs = (run(EVIL, (EVIL, "elbow"), failure=Broken(EVIL)),)
    assert "<script>alert" not in identification_page(identification)
