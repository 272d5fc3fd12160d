"""The verdict as a reader meets it."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from dynident.report.identification import identification_page, result_dict
from dynident.report.verdict import verdict_text

from .conftest import identification_of
from .test_page import EVIL


def run(name="reach.csv", joints=("shoulder", "elbow"), failure=""):
    each = dict.fromkeys(joints, np.inf if failure else 3.5)
    return SimpleNamespace(
        name=name, joints=joints, driver="torque", restart=0.5, relative_error=each, motion_error=each, rms=each,
        torque_error={}, failure=failure,
    )  # fmt: skip


def test_the_page_begins_with_the_verdict(identification):
    page = identification_page(identification)
    assert "<h2>Verdict: do not use</h2>" in page
    assert page.index("Verdict: do not use") < page.index("What was found")
    assert "The mass matrix is positive definite" in page
    assert "What to do next" in page
    assert "What is left of the torque, unfiltered" in page
    assert "Free simulation beside" not in page


def test_the_terminal_says_it_in_one_paragraph():
    words, steps = verdict_text(identification_of(logs=("swing.csv",)))
    assert words.startswith("Verdict: Do not use this model yet: no log was held out.")
    assert "\n" not in words
    assert steps[0].startswith("Record another motion")


def test_free_simulations_are_shown_with_their_failures(identification):
    identification.runs = (run(), run("swing.csv", failure="it runs away"))
    page = identification_page(identification)
    assert "torque, 0.5 s" in page
    assert "swing.csv: it runs away" in page
    kept = result_dict(identification)["simulation"]
    assert kept["reach.csv"]["rms"] == {"shoulder": 3.5, "elbow": 3.5}
    assert kept["swing.csv"]["failure"] == "it runs away"


def test_names_cannot_break_out_of_the_verdict():
    found = identification_of(joints=(EVIL, "elbow"), logs=(EVIL, "other"))
    found.runs = (run(EVIL, (EVIL, "elbow"), failure=EVIL),)
    assert "<script>alert" not in identification_page(found)


def test_robust_errors_stand_beside_the_plain_ones(identification):
    identification.std_hac = np.arange(7.0)
    rows = result_dict(identification)["parameters"]
    assert [row["std_hac"] for row in rows] == list(range(7))
    assert rows[0]["std"] == 4e-4
