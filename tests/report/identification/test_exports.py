"""The files of a model in a report: differences, what is left out, refusals; names from files are escaped."""

from dataclasses import replace

import numpy as np

from dynident.project.export import FileError, Urdf, export, random_states
from dynident.report.identification.robot import export_notes, export_results, export_section
from dynident.report.page import render
from tests.project.export.arms import STATES, arm
from tests.robots import ARM


def page(exports) -> str:
    return render("title", "lead", list(export_section(exports)))


def test_a_proven_file_with_what_it_leaves_out() -> None:
    made = export(arm(), Urdf(), STATES)
    text = page([made])
    for words in ("robot.identified.urdf", "Pinocchio, dynident", "offset_shoulder = \u22120.3 N m", "Ia_motor"):
        assert words in text
    (result,) = export_results([made])
    assert result["proven"]
    assert result["agreement"] == made.proof.agreement
    assert result["left_out"] == list(made.written.left_out)
    first, second, third = export_notes([made])
    assert third.startswith("robot.identified.urdf: what it leaves out is, as root mean square over the states")
    assert first == "robot.identified.urdf cannot store 6 items, listed in the report."
    assert second.startswith("robot.identified.urdf: Ia_shoulder (0.5 kg m^2): part of other parameters")


def test_what_is_left_out_has_its_cost() -> None:
    errors = (FileError("fast", "train", 1.0, 9.0), FileError("slow", "validation", 2.0, 3.25))
    made = replace(export(arm(), Urdf(), STATES), errors=errors)
    assert export_notes([made])[0].endswith("its torque error on 'slow' is 3.25 %; that of the full model is 2 %.")
    assert "3.25" in page([made])
    assert export_results([made])[0]["errors"] == [
        {"log": "fast", "role": "train", "model": 1.0, "file": 9.0},
        {"log": "slow", "role": "validation", "model": 2.0, "file": 3.25},
    ]
    assert "3.25" not in page([replace(made, written=replace(made.written, left_out=()))])


def test_names_are_escaped() -> None:
    text = ARM.replace('"twist"', '"&lt;b>twist"')
    made = export(arm(text), Urdf(), random_states(3, np.random.default_rng(0), 20))
    assert made.ready
    assert "<b>twist" not in page([replace(made, file="<b>twist.urdf")])
