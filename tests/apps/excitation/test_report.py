"""The report of a designed motion: figures, sentences, tables, the scene, and the page."""

from __future__ import annotations

from base64 import b64decode
from dataclasses import replace

import numpy as np
import pytest
import yaml

from dynident.apps.excitation import (
    Interrupted,
    LeftOut,
    LimitedQuantity,
    Program,
    design_figure,
    distance_figure,
    expected_figure,
)
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
from dynident.apps.excitation.report import (
    arm_view,
    excitation_findings,
    excitation_page,
    limit_use_table,
    obstacle_mesh,
    scene_section,
)
from dynident.apps.excitation.run import _limits_text
from dynident.models import Box, Cylinder, EmptySpace, Floor, ShapeSource
from dynident.project.arms import KnownArm
from dynident.regression import UnexcitedParameters
from dynident.report.page import Figure, PageTable
from tests.apps.excitation.arms import TWO
from tests.report.designs import designed

T = np.linspace(0, 2, 50)


def test_limits_are_in_sight_and_missing_ones_are_not() -> None:
    one, other = (
        LimitedQuantity("velocity, rad/s", np.sin(T), -2.0, 2.0),
        LimitedQuantity("torque, N m", np.cos(T), -np.inf, np.inf),
    )
    figure = design_figure(T, [one, other])
    assert [trace["name"] for trace in figure.data] == ["velocity", "limit", "limit", "torque"]
    low, high = figure.layout["yaxis"]["range"]
    assert low < -2 < 2 < high
    assert figure.layout["yaxis2"]["range"][1] < 1.2


def test_distances_with_the_clearance() -> None:
    figure = distance_figure(T, T + 0.1, 0.05)
    assert list(figure.data[1]["y"]) == [0.05, 0.05]


def test_what_is_not_known_before_is_left_out() -> None:
    before = np.array([np.inf, 3.0])
    figure = expected_figure(["<m>", "b"], np.array([1.0, 2.0]), 10.0, before)
    *_, now, then = figure.data
    assert now["text"] == ["&lt;m&gt;", "b"]
    assert list(then["x"]) == [3.0]
    assert figure.layout["showlegend"]


def test_limits_by_rule_and_beyond_the_file_are_named() -> None:
    _, found = designed()
    limits = replace(
        found.limits, by_rule={"lift": ("jerk", "torque"), "bend": ("jerk", "position")}, beyond={"bend": ("velocity",)}
    )
    said = list(limit_words(replace(found, limits=limits)))
    assert len(said) == 4
    assert said[0].startswith("Limits of jerk of all joints are by rule (at lift ")
    assert said[1] == "The torque of lift has no limit: it was not looked at."
    assert said[2] == "Limits of position of bend are by rule: give your robot's own, if they are known."
    assert said[3] == "The limits that are given for bend exceed those of the robot file: velocity."


def test_usual_limits_of_a_known_arm_are_offered_where_a_rule_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    project, found = designed()
    limits = {"lift": {"acceleration": 7.0}, "bend": {"acceleration": 7.0}}
    monkeypatch.setattr("dynident.apps.excitation.limits.find_arm", lambda _: KnownArm("Two", "a/b, c.yaml", limits))
    ruled = replace(found, limits=replace(found.limits, by_rule={"lift": ("acceleration",)}))
    said = list(limit_words(ruled))
    assert said[1].startswith(
        "The joints are those of a Two, whose usual limits of acceleration are public (a/b, c.yaml)"
    )
    assert "--settings limits.yaml" in said[1]
    arm = usual_arm(ruled.model, ruled.limits)
    assert arm is not None
    given = {"lift": JointLimits(acceleration=1.0, upper=0.5)}
    changed = replace(project, settings=project.settings.model_copy(update={"limits": given}))
    text = yaml.safe_load(_limits_text(changed, arm))
    assert text["limits"] == {"lift": {"acceleration": 1.0, "upper": 0.5}, "bend": {"acceleration": 7.0}}
    assert usual_arm(found.model, replace(found.limits, by_rule={"lift": ("jerk",)})) is None


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


def with_shares(*percents: float):
    """A design whose parameters that have a value are expected to so many per cent, the others to 1 unit."""
    found = designed()[1]
    one = found.expected
    value, std = np.zeros(len(one.std)), np.ones(len(one.std))
    value[: len(percents)], std[: len(percents)] = 2.0, np.array(percents) / 50
    return replace(found, expected=replace(one, value=value, std=std))


def test_parameters_are_counted_by_how_well_they_will_be_known() -> None:
    first, longer, worst, rest, *others = expected_findings(with_shares(1.0, 9.0, 25.0, 50.0, 200.0))
    assert "5 of which have a nominal value" in first
    assert "2 will be known well (to 10 %), 1 fairly (to 30 %) and 2 poorly" in first
    assert "2 will be known well (to 10 %), 2 fairly (to 30 %) and 1 poorly" in longer
    assert worst.startswith(f"The least known is {designed()[1].expected.basis.groupings[4].split(' ')[0]}")
    assert "2.00 +- 4.0" in worst
    assert f"The other {len(designed()[1].expected.std) - 5}, such as friction, have no nominal value" in rest
    assert others == []


def test_what_was_known_before_and_what_stays_open() -> None:
    found = designed()[1]
    one = found.expected
    B = one.basis.combination
    before = 0.01 * B.T @ np.diag(1 / one.std**2) @ B
    prior = replace(found, request=replace(found.request, prior=before))
    (line,) = [line for line in expected_findings(prior) if line.startswith("Together with")]
    assert "smaller than now by a factor of" in line
    std = one.std.copy()
    std[0] = np.inf
    said = list(expected_findings(replace(found, expected=replace(one, std=std))))
    assert said[-1] == f"1 base parameter stays open: {one.basis.leading[0]}."
    slow = replace(found.request, program=Program.FRICTION)
    *_, said = expected_findings(replace(found, request=slow, expected=replace(one, std=std)))
    assert "`--program motion`" in said
    assert list(expected_findings(replace(found, expected=replace(one, std=np.full_like(std, np.inf))))) == [
        "The motion tells nothing: it shows no base parameter."
    ]


def test_the_table_marks_what_is_open_or_has_no_value() -> None:
    found = with_shares(5.0)
    std = found.expected.std.copy()
    std[1] = np.inf
    section = expected_section(replace(found, expected=replace(found.expected, std=std)))
    (table,) = [fold.blocks[0] for fold in section.blocks if getattr(fold, "title", "") == "All numbers"]
    assert table.rows[0][1:] == ("2.000", "0.10", "5.0")
    assert table.rows[1][1:] == ("-", "open", "-")
    assert has_value(found.expected).sum() == 1
    rounded = np.where(found.expected.value == 0, 1e-12, found.expected.value)
    assert has_value(replace(found.expected, value=rounded)).sum() == 1


def test_bodies_move_as_the_robot_does() -> None:
    project, found = designed()
    view = arm_view(project, found)
    assert view is not None
    figure = view.figure
    assert figure.motion is not None
    assert [one["name"] for one in figure.data[: len(figure.motion["moving"])]] == ["upper", "lower"]
    (replay,) = figure.motion["replays"]
    assert replay["stop"] == found.trajectory.duration
    q = np.frombuffer(b64decode(replay["q"]), "<f4").reshape(-1, 2)
    t = np.linspace(0.0, replay["stop"], len(q))
    np.testing.assert_allclose(q, found.trajectory.states(t)[0], atol=1e-6)


def test_the_closest_pairs_come_first() -> None:
    project, found = designed()
    (table,) = [one for one in scene_section(project, found).blocks if isinstance(one, PageTable)]
    sizes = [float(row[2]) for row in table.rows]
    assert sizes == sorted(sizes)
    t = found.trajectory.times(100.0)
    least = 1e3 * found.space.distances(found.trajectory.states(t)[0]).min()
    assert sizes[0] == np.round(least, 1) or abs(sizes[0] / least - 1) < 0.01


def test_what_is_known_of_the_shapes_is_said() -> None:
    project, found = designed()
    (lines,) = [one for one in scene_section(project, found).blocks if isinstance(one, tuple)]
    assert lines[0].startswith("Distances of")
    assert "the lines between their joints" in lines[0]
    geometry = replace(
        project.geometry,
        missing={"a.dae": "there is no such file."},
        sources={0: ShapeSource.VISUAL, 1: ShapeSource.COLLISION},
    )
    project.__dict__["geometry"], kept = geometry, project.geometry
    (lines,) = [one for one in scene_section(project, found).blocks if isinstance(one, tuple)]
    project.__dict__["geometry"] = kept
    assert lines[0] == "Distances of lower: by capsules around their collision shapes."
    assert lines[2] == "Meshes that could not be read: a.dae (there is no such file)."


def test_a_model_without_bodies_has_no_view() -> None:
    project, found = designed()
    project.__dict__["geometry"], kept = None, project.geometry
    section = scene_section(project, replace(found, space=EmptySpace(2)))
    assert arm_view(project, found) is None
    project.__dict__["geometry"] = kept
    assert len(section.blocks) == 2
    assert not any(isinstance(one, Figure) for one in section.blocks)


def test_obstacles_are_drawn_where_they_are() -> None:
    floor = obstacle_mesh(Floor(-0.5), 2.0)
    np.testing.assert_array_equal(floor.vertices[:, 2], -0.5)
    turned = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    box = obstacle_mesh(Box("b", (1, 2, 3), (0.2, 0.4, 0.6), tuple(map(tuple, turned))), 2.0)
    np.testing.assert_allclose(np.ptp(box.vertices, axis=0), [0.4, 0.2, 0.6])
    np.testing.assert_allclose(box.vertices.mean(axis=0), [1, 2, 3])
    post = obstacle_mesh(Cylinder("c", (1, 2), 0.3, -np.inf, 1.0), 2.0)
    np.testing.assert_allclose(np.ptp(post.vertices, axis=0), [0.6, 0.6, 3.0])


def test_the_page_has_all_parts_and_escapes_names() -> None:
    project, found = designed()
    page = excitation_page(project, found, [("motion.csv", "the motion"), ("trial.csv", "slower")])
    for words in (
        "What it will tell",
        "Run <code>trial.csv</code> first",
        '<a href="./motion.csv">motion.csv</a>',
        "dynident excite result/result.json -o next",
        'class="player"',
        "Distances along the path",
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
    table = limit_use_table(designed()[1])
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


def test_a_joint_without_a_limit_of_torque() -> None:
    project, found = designed()
    free = replace(found, limits=replace(found.limits, torque=np.full(2, np.inf)))
    assert "∞" in excitation_page(project, free)
