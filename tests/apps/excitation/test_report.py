"""The report of a designed motion: what is not on the page that `tests/laws/test_shown.py` keeps."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from dynident.apps.excitation import Interrupted, LeftOut, Program
from dynident.apps.excitation.config import NoiseOrigin
from dynident.apps.excitation.expected_report import (
    expected_findings,
    expected_section,
    floor_words,
    has_value,
    limit_words,
    noise_words,
    shape_words,
)
from dynident.apps.excitation.limits import JointLimits, usual_arm
from dynident.apps.excitation.report import arm_view, excitation_findings, excitation_page, obstacle_mesh, scene_section
from dynident.apps.excitation.run import _limits_text
from dynident.models import Box, EmptySpace
from dynident.project.arms import KnownArm
from dynident.regression import UnexcitedParameters
from dynident.report.page import Figure
from tests.apps.excitation.arms import TWO
from tests.report.designs import designed


def test_limits_by_rule_and_beyond_the_file_are_named() -> None:
    _, result = designed()
    limits = replace(
        result.limits,
        by_rule={"lift": ("jerk", "torque"), "bend": ("jerk", "position")},
        beyond={"bend": ("velocity",)},
    )
    said = list(limit_words(replace(result, limits=limits)))
    assert len(said) == 4
    assert said[0].startswith("Limits of jerk of all joints are by rule (at lift ")
    assert said[1] == "The torque of lift has no limit: it was not looked at."
    assert said[2] == "Limits of position of bend are by rule: give your robot's own, if they are known."
    assert said[3] == "The limits that are given for bend exceed those of the robot file: velocity."


def test_usual_limits_of_a_known_arm_are_offered_where_a_rule_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    project, result = designed()
    limits = {"lift": {"acceleration": 7.0}, "bend": {"acceleration": 7.0}}
    monkeypatch.setattr("dynident.apps.excitation.limits.find_arm", lambda _: KnownArm("Two", "a/b, c.yaml", limits))
    ruled = replace(result, limits=replace(result.limits, by_rule={"lift": ("acceleration",)}))
    words = "The joints are those of a Two, whose usual limits of acceleration are public (a/b, c.yaml)"
    said = list(limit_words(ruled))[1]
    assert said.startswith(words)
    assert "--settings limits.yaml" in said
    arm = usual_arm(ruled.model, ruled.limits)
    given = {"lift": JointLimits(acceleration=1.0, upper=0.5)}
    changed = replace(project, settings=project.settings.model_copy(update={"limits": given}))
    text = yaml.safe_load(_limits_text(changed, arm))
    assert text["limits"] == {"lift": {"acceleration": 1.0, "upper": 0.5}, "bend": {"acceleration": 7.0}}
    assert usual_arm(result.model, replace(result.limits, by_rule={"lift": ("jerk",)})) is None


def test_where_the_noise_is_from_and_what_was_lost() -> None:
    project, _ = designed()
    (said,) = noise_words(project)
    assert "lift 0.40, bend 0.15; by rule: 1 % of the torque limit" in said
    reference = replace(project.prior, loss_reason="its logs are gone")
    said, lost = noise_words(replace(project, origin=NoiseOrigin.RESULT, prior=reference))
    assert "the residual of the result" in said
    assert lost == "What was recorded before does not count: its logs are gone."


def test_without_a_floor_it_is_said_how_low_the_arm_reaches() -> None:
    project, result = designed()
    assert list(floor_words(project, result)) == []
    free = replace(project, settings=project.settings.model_copy(update={"floor": None}))
    (said,) = floor_words(free, result)
    q = result.trajectory.states(result.trajectory.times(50.0))[0]
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


def with_shares(*percents: float):
    """A design whose parameters that have a value are expected to so many per cent, the others to 1 unit."""
    result = designed()[1]
    expected = result.expected
    value, std = np.zeros(len(expected.std)), np.ones(len(expected.std))
    value[: len(percents)], std[: len(percents)] = 2.0, np.array(percents) / 50
    return replace(result, expected=replace(expected, value=value, std=std))


def test_what_was_known_before_and_what_stays_open() -> None:
    result = designed()[1]
    expected = result.expected
    B = expected.basis.combination
    before = 0.01 * B.T @ np.diag(1 / expected.std**2) @ B
    prior = replace(result, request=replace(result.request, prior=before))
    (line,) = [line for line in expected_findings(prior) if line.startswith("Together with")]
    assert "smaller than now by a factor of" in line
    std = expected.std.copy()
    std[0] = np.inf
    said = list(expected_findings(replace(result, expected=replace(expected, std=std))))
    assert said[-1] == f"1 base parameter stays open: {expected.basis.leading[0]}."
    slow = replace(result.request, program=Program.FRICTION)
    *_, said = expected_findings(replace(result, request=slow, expected=replace(expected, std=std)))
    assert "`--program motion`" in said
    assert list(expected_findings(replace(result, expected=replace(expected, std=np.full_like(std, np.inf))))) == [
        "The motion tells nothing: it shows no base parameter."
    ]


def test_the_table_marks_what_is_open_or_has_no_value() -> None:
    result = with_shares(5.0)
    std = result.expected.std.copy()
    std[1] = np.inf
    section = expected_section(replace(result, expected=replace(result.expected, std=std)))
    (table,) = [fold.blocks[0] for fold in section.blocks if getattr(fold, "title", "") == "All numbers"]
    assert table.rows[0][1:] == ("2.000", "0.10", "5.0")
    assert table.rows[1][1:] == ("-", "open", "-")
    assert has_value(result.expected).sum() == 1
    rounded = np.where(result.expected.value == 0, 1e-12, result.expected.value)
    assert has_value(replace(result.expected, value=rounded)).sum() == 1


def test_a_model_without_bodies_has_no_view(monkeypatch: pytest.MonkeyPatch) -> None:
    project, result = designed()
    monkeypatch.setitem(project.__dict__, "geometry", None)
    section = scene_section(project, replace(result, space=EmptySpace()))
    assert arm_view(project, result) is None
    assert len(section.blocks) == 2
    assert not any(isinstance(block, Figure) for block in section.blocks)


def test_a_turned_box_is_drawn_where_it_is() -> None:
    box = obstacle_mesh(Box("b", (1, 2, 3), (0.2, 0.4, 0.6), ((0, 1, 0), (-1, 0, 0), (0, 0, 1))), 2.0)
    np.testing.assert_allclose(np.ptp(box.vertices, axis=0), [0.4, 0.2, 0.6])
    np.testing.assert_allclose(box.vertices.mean(axis=0), [1, 2, 3])


def test_names_of_joints_links_and_obstacles_cannot_act_on_the_page() -> None:
    project, result = designed(TWO.replace('"lift"', '"&lt;script&gt;lift"').replace('"lower"', '"&lt;script&gt;low"'))
    page = excitation_page(project, result)
    for name in ("<script>lift", "<script>low", "<i>table"):
        assert name not in page
    assert "What to do with it" not in page  # nothing was written
    page = excitation_page(project, result, [("motion.csv", "the motion"), ("trial.csv", "slower")])
    assert "Run <code>trial.csv</code> first" in page


def test_notes_are_said_and_a_torque_without_a_limit() -> None:
    project, result = designed()
    open_note = UnexcitedParameters(("a.Ixx",), ("lift",), False, ())
    said = excitation_findings(project, replace(result, notes=(Interrupted(), LeftOut(("Dahl",)), open_note)))
    assert any("stopped before its end" in words for words in said)
    assert any("remember the motion (Dahl)" in words for words in said)
    free = replace(result, notes=(open_note,), limits=replace(result.limits, torque=np.full(2, np.inf)))
    page = excitation_page(project, free)
    for words in ("What stays open, and why", "it takes motion of lift", "∞"):
        assert words in page, words
