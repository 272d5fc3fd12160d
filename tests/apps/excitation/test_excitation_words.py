"""What a design assumed, in sentences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynident.apps.excitation.config import NoiseOrigin
from dynident.apps.excitation.expected_report import floor_words, limit_words, noise_words, shape_words
from tests.report.designs import designed


def test_limits_by_rule_and_beyond_the_file_are_named() -> None:
    _, found = designed()
    limits = replace(
        found.limits,
        by_rule={"lift": ("jerk", "torque"), "bend": ("jerk", "position")},
        beyond={"bend": ("velocity",)},
    )
    said = list(limit_words(replace(found, limits=limits)))
    assert len(said) == 4
    assert said[0].startswith("Limits of jerk of all joints are by rule (at lift ")
    assert said[1] == "The torque of lift has no limit: it was not looked at."
    assert said[2] == "Limits of position of bend are by rule: give your robot's own, if they are known."
    assert said[3] == "The limits that are given for bend exceed those of the robot file: velocity."


def test_where_the_noise_is_from_and_what_was_lost() -> None:
    project, _ = designed()
    (said,) = noise_words(project)
    assert "lift 0.40, bend 0.15; by rule: 1 % of the torque limit" in said
    known = replace(project.prior, loss_reason="its logs are gone")
    said, lost = noise_words(replace(project, origin=NoiseOrigin.RESULT, prior=known))
    assert "the residual of the result" in said
    assert lost == "What was recorded before does not count: its logs are gone."


def test_without_a_floor_it_is_said_how_low_the_arm_reaches() -> None:
    project, found = designed()
    assert list(floor_words(project, found)) == []
    free = replace(project, settings=project.settings.model_copy(update={"floor": None}))
    (said,) = floor_words(free, found)
    t = found.trajectory.times(50.0)
    q = found.trajectory.states(t)[0]
    elbow = 0.4 * np.sin(q[:, 0])  # the axes turn about -y
    low = float(said.partition("reaches down to ")[2].partition(" m")[0])
    assert "m below" in said
    assert low > -elbow.min() - 1e-2
    assert "give `floor: 0`" in said


def test_unknown_shapes_and_a_missing_program_are_said(monkeypatch: pytest.MonkeyPatch) -> None:
    project, _ = designed()
    monkeypatch.setitem(project.__dict__, "geometry", replace(project.geometry, missing={"hand.stl": "there is none."}))
    monkeypatch.setitem(project.__dict__, "shapes", None)
    links, program = shape_words(project)
    assert links.startswith("The shapes of upper, lower are not known (hand.stl: there is none)")
    assert "install pin" in program or "pip install" in program
    monkeypatch.setitem(project.__dict__, "geometry", None)
    (said,) = shape_words(project)
    assert "not made of a robot file" in said
