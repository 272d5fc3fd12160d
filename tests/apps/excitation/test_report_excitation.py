"""The page of a designed motion."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from dynident.apps.excitation import Interrupted, LeftOut
from dynident.apps.excitation.report import excitation_findings, excitation_heading, excitation_page, excitation_tables
from dynident.regression import UnexcitedParameters
from tests.apps.excitation.arms import TWO
from tests.report.designs import designed


def test_the_page_has_all_parts_and_escapes_names() -> None:
    project, found = designed()
    page = excitation_page(project, found, [("motion.csv", "the motion"), ("trial.csv", "slower")])
    for words in (
        "What it will tell",
        "Run <code>trial.csv</code> first",
        '<a href="./motion.csv">motion.csv</a>',
        "dynident excite result/result.json -o next",
        'class="player"',
        "smallest distance",
        "&lt;i&gt;table",
        "5000 times, 1 kHz and finer; the torque by the regressor",
    ):
        assert words in page, words
    assert "<i>table" not in page
    assert page.count("<figure>") == 2 + 2 * 2 + 1  # view and distances, two motions of two joints, expected errors


def test_names_of_joints_and_links_cannot_act_on_the_page() -> None:
    project, found = designed(TWO.replace('"lift"', '"&lt;script&gt;lift"').replace('"lower"', '"&lt;script&gt;low"'))
    page = excitation_page(project, found)
    assert "<script>lift" not in page
    assert "<script>low" not in page
    assert "What to do with it" not in page  # nothing was written


def test_the_table_gives_shares_of_both_motions() -> None:
    (table,) = excitation_tables(designed()[1])
    assert table.rows[0] == ("lift", *["90.0"] * 10)
    assert [name for name, _ in table.groups if name] == ["motion, % of the limit", "validation, % of the limit"]


def test_notes_are_said() -> None:
    project, found = designed()
    open_one = UnexcitedParameters(("a.Ixx",), ("lift",), False, ())
    said = excitation_findings(project, replace(found, notes=(Interrupted(), LeftOut(("Dahl",)), open_one)))
    assert any("stopped before its end" in one for one in said)
    assert any("remember the motion (Dahl)" in one for one in said)
    page = excitation_page(project, replace(found, notes=(open_one,)))
    assert "What stays open, and why" in page
    assert "it takes motion of lift" in page


def test_the_heading_says_how_long_both_take() -> None:
    assert excitation_heading(designed()[1]) == "An optimised motion, 4.00 s, and another of 4.00 s for validation."


def test_a_joint_without_a_limit_of_torque() -> None:
    project, found = designed()
    free = replace(found, limits=replace(found.limits, torque=np.full(2, np.inf)))
    assert "∞" in excitation_page(project, free)
