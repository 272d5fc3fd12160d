"""Findings gathered for the eye: like ones once, with the names of all places."""

import numpy as np

from dynident.checks import CheckResult, RobotJointFacts, log_notes
from dynident.checks.robot import LinkFacts
from dynident.checks.robot_notes import MissingTerm, TermKind, TorqueGain
from dynident.models.robot_files import RobotJointLimits
from dynident.report.check import check_tables
from dynident.runtime import ConfigRemark, Finding, Remark


def rows(*findings: Finding) -> dict[str, list[tuple[str, ...]]]:
    return {table.caption: list(table.rows) for table in check_tables(CheckResult(findings))}


def test_a_mistake_in_the_configuration_comes_before_what_may_follow_from_it() -> None:
    made = [Finding(log_notes.PerhapsRadians(0.1, 60.0, 5.0)), Finding(ConfigRemark("twice."), source="robot.yaml")]
    assert rows(*made[::-1])["Warnings"][0] == ("robot.yaml", "twice.")
    assert rows(Finding(Remark("coarse.")), made[1])["Warnings"][0] == ("robot.yaml", "twice.")


def test_the_type_of_a_joint_is_that_of_its_limits() -> None:
    for kind, lower, upper, held, shown in (
        ("revolute", None, None, "", "continuous"),
        ("revolute", None, 1.0, "", "revolute"),
        ("revolute", -1.0, None, "", "revolute"),
        ("prismatic", None, None, "", "prismatic"),
        ("revolute", None, None, "planar", "held fixed"),
    ):
        fact = RobotJointFacts("a", kind, RobotJointLimits(np.nan, 2.0, lower, upper), None, held, 0.5)
        link = LinkFacts("arm", 0.5, np.zeros(3), np.ones(3))
        table, *_ = check_tables(CheckResult((), links=(link,), joints=(fact,)))
        limits = ["-" if limit is None else f"{limit:g}" for limit in (lower, upper)]
        assert table.rows == (("a", shown, *limits, "2", "-", "0.5"),)


def test_each_of_several_outliers_is_named() -> None:
    """Like findings are one row, but sizes and rows of all of them are said, and what was done about each."""

    def spikes(joint: str, log: str, row: int, size: float, held_out: bool = False) -> Finding:
        note = log_notes.TorqueSpikes(1, (row,), (1700 + 0.002 * row,), size, not held_out, held_out)
        return Finding(note, joint, source=log)

    made = (spikes("a", "one", 1, 4.0), spikes("b", "one", 3, 5000.0), spikes("b", "two", 5, 60.0))
    ((where, said),) = rows(*made)["Warnings"]
    assert where == "one: a"
    assert said.startswith(
        "1 torque stands out by up to 4, unlike the motion: sample 1 (t = 1700.002 s). It is left out"
    )
    assert said.endswith(
        " Likewise b (1 by up to 5000, sample 3 (t = 1700.006 s))."
        " Also in two (b: 1 by up to 60, sample 5 (t = 1700.01 s))."
    )
    apart = rows(made[0], spikes("b", "two", 5, 60.0, held_out=True))["Warnings"]
    assert [x[0] for x in apart] == ["one: a", "two: b"]
    assert "The error on this log counts it as measured" in apart[1][1]


def test_outliers_of_other_kinds_name_their_rows() -> None:
    kinds = (
        (lambda row: log_notes.FrozenPosition(row, 10, 1.0, 2.0, 0.5, True), "10 samples at 0.5 from sample 7"),
        (lambda row: log_notes.FrozenTorque(row, 10, 1.0, 2.0, 0.0, True, False), "10 samples at 0 from sample 7"),
        (lambda row: log_notes.ClippedTorque(4, 9.5, row, 1.0, True, False), "4 at 9.5, first sample 7"),
        (lambda row: log_notes.PositionJump(1, 0.25, row, 1.0), "by 0.25 after sample 7"),
    )
    for make, said in kinds:
        made = [Finding(make(row), joint, source="one") for joint, row in (("a", 3), ("b", 7))]
        assert rows(*made)["Warnings"][0][1].endswith(f" Likewise b ({said}).")


def test_only_effects_of_one_kind_are_alike_and_each_has_its_size() -> None:
    """What one joint lacks says nothing of what another does."""
    sizes = {"a": (TermKind.DELAY, -0.0024), "b": (TermKind.LOAD, 0.04), "c": (TermKind.DELAY, 0.003)}
    made = [Finding(MissingTerm(kind, size, 1e-4, 0.5), joint) for joint, (kind, size) in sizes.items()]
    (where, said), (other, _) = rows(*made)["Warnings"]
    assert (where, other) == ("a", "b")
    assert said.startswith("a torque that leads the positions by 0.0024 +- 0.0001 s")
    assert said.endswith(" Likewise c (0.003).")
    gains = [Finding(TorqueGain(size, 0.01, 0.5), joint) for joint, size in (("a", 0.8), ("b", 3.0))]
    assert rows(*gains)["Warnings"][0][1].endswith(" Likewise b (3).")


def test_spikes_that_are_too_many_are_not_like_a_few() -> None:
    made = [
        Finding(kind(9, (1, 5, 7), (0.1, 0.5, 0.7), 3.0, False), joint, source="one")
        for joint, kind in (("a", log_notes.PositionSpikes), ("b", log_notes.ManyPositionSpikes))
    ]
    assert [x[0] for x in rows(*made)["Warnings"]] == ["one: b", "one: a"]  # what forbids a use comes first
