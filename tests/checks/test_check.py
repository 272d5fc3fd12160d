"""All together: what is left out, what fails, and what is still said."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import pytest

from dynident.checks import file_notes, motion_notes, robot_notes, run_checks, with_findings
from dynident.checks.motion_notes import SearchKind, SearchLeftOut
from dynident.identification import Recipe, identify
from dynident.models import Model, RigidBodies, Term
from dynident.models.lagrangian import slider, two_link_arm
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import Butterworth, Difference, Smoother, Spline
from dynident.runtime import Finding, Remark, Severity
from tests.checks import moving_arm
from tests.robots import ARM_MJCF

T = np.arange(3000) * 0.002
NAME = slider().joints[0].name


def log(scale: float = 1.0, t: np.ndarray = T) -> Log:
    x = 0.3 * np.sin(3 * T) + 1e-6 * np.random.default_rng(9).standard_normal(len(T))
    return Log(t, x[:, None], scale * force(0.9 * np.cos(3 * T), -2.7 * np.sin(3 * T)), (NAME,))


def other(scale: float = 1.0) -> Log:
    x = 0.3 * np.sin(2 * T) * np.cos(T) + 1e-6 * np.random.default_rng(8).standard_normal(len(T))
    dx = 0.15 * (3 * np.cos(3 * T) + np.cos(T))
    return Log(T, x[:, None], scale * force(dx, -0.15 * (9 * np.sin(3 * T) + np.sin(T))), (NAME,))


def force(dx: np.ndarray, ddx: np.ndarray) -> np.ndarray:
    return (5 * ddx + 8 * dx + 3 * np.sign(dx))[:, None]


def topics(found) -> list[str]:
    return [finding.topic for finding in found.findings]


def test_a_sound_log_gives_facts_and_no_findings() -> None:
    found = run_checks(slider(), {"train": {"one": log()}, "validation": {"two": other()}})
    assert topics(found) == []
    assert not found.has_errors
    assert found.timings.keys() == found.channels.keys() == {"one", "two"}
    assert found.rank is not None
    assert [one.joint for one in found.excitations] == [one.joint for one in found.agreements] == [NAME]


@pytest.mark.parametrize(("outliers", "left_out"), [("mask", (1, 2)), ("keep", (0, 0))])
def test_the_facts_of_a_channel_leave_out_what_the_fit_does(outliers: Literal["mask", "keep"], left_out) -> None:
    one, sound = log(), log()
    q, tau = one.q.copy(), one.tau.copy()
    q[1000], tau[[500, 2000]] = 3.0, 900.0
    found = run_checks(slider(), {"train": {"one": replace(one, q=q, tau=tau)}}, Recipe(outliers=outliers))
    (fact,), (expected,) = found.channels["one"], run_checks(slider(), {"train": {"one": sound}}).channels["one"]
    assert (fact.left_out, fact.torque_left_out) == left_out
    assert (fact.rms < 1.01 * expected.rms) == (fact.noise < 2 * expected.noise) == (outliers == "mask")


def test_a_log_with_an_error_is_left_out_of_the_motion() -> None:
    torn = log(t=T + np.where(np.arange(len(T)) > 1000, 3.0, 0.0))
    both = run_checks(slider(), {"train": {"good": log(), "torn": torn}})
    assert topics(both) == ["gap"]
    assert both.has_errors
    assert both.findings[0].source == "torn"
    assert both.excitations == run_checks(slider(), {"train": {"good": log()}}).excitations
    assert run_checks(slider(), {"train": {"torn": torn}}).excitations == ()


def test_a_stage_that_fails_is_a_finding() -> None:
    found = run_checks(slider(), {"train": {"one": log()}}, Recipe(smoother=Butterworth(cutoffs=(1e4, 1e4, 1e4))))
    assert topics(found) == ["motion"]
    assert found.has_errors


@pytest.mark.parametrize("usable", [0, 1, 4])
@pytest.mark.parametrize("time_offset", [0.0, "estimate"])
def test_motions_of_few_usable_samples_are_an_error_that_is_found(
    usable: int, time_offset: float | Literal["estimate"]
) -> None:
    """Whatever smoother leaves so few; another log that has enough makes up for one."""

    class FewSamples(Smoother):
        def __call__(self, log: Log) -> Motion:
            motion = Difference("central")(log)
            few = np.isin(np.arange(len(log)), 1500 + np.arange(usable))
            return replace(motion, mask=few) if log.source == "one" else motion

    recipe = Recipe(FewSamples(), time_offset=time_offset)
    found = run_checks(slider(), {"train": {"one": log()}, "validation": {"two": other()}}, recipe)
    (error,) = (one for one in found.findings if one.severity is Severity.ERROR)
    assert str(error.message).startswith("one: ")
    assert "too few for 4 parameters" in str(error.message)
    assert found.channels.keys() == {"one", "two"}
    assert not run_checks(slider(), {"train": {"one": log(), "two": other()}}, recipe).has_errors


@pytest.mark.parametrize("count", [4, 6, 29])
def test_a_log_that_is_too_short_is_said_and_no_more(count: int) -> None:
    found = run_checks(slider(), {"train": {"one": log().window(stop=T[count - 1])}})
    assert topics(found) == ["samples"]


def test_the_most_severe_come_first() -> None:
    given = [
        Finding(Remark("so"), severity=Severity.INFO),
        Finding(Remark("torn"), severity=Severity.ERROR),
        Finding(Remark("odd")),
    ]
    found = run_checks(slider(), {"train": {"one": log()}}, initial_findings=given)
    assert [one.severity for one in found.findings] == ["error", "warning", "info"]


def test_another_gravity_in_the_file_is_said() -> None:
    moon = ARM_MJCF.replace("<default>", '<option gravity="0 0 -1.62"/><default>', 1)
    (found,) = (one for one in run_checks(Model((RigidBodies(moon),)), {}).findings if one.topic == "gravity")
    assert found.message == file_notes.GravityIgnored((0.0, 0.0, -1.62), (0.0, 0.0, -9.81))
    assert "gravity" not in topics(run_checks(Model((RigidBodies(ARM_MJCF),)), {}))


def test_joints_are_matched_by_name() -> None:
    one = log()
    two = Log(T, np.hstack([np.zeros_like(one.q), one.q]), np.hstack([one.tau * 0, one.tau]), ("other", NAME))
    found = run_checks(slider(), {"train": {"one": two}})
    assert found.excitations == run_checks(slider(), {"train": {"one": one}}).excitations


@dataclass(frozen=True)
class Mine(Term):
    """A term of another class that was made from a robot file."""

    bodies: RigidBodies

    joints = property(lambda self: self.bodies.joints)
    parameters = property(lambda self: self.bodies.parameters)
    file = property(lambda self: self.bodies.file)
    gravity = property(lambda self: self.bodies.gravity)

    def regressor(self, q, dq, ddq):
        return self.bodies.regressor(q, dq, ddq)

    def partials(self, q, dq, ddq, theta):
        return self.bodies.partials(q, dq, ddq, theta)


def test_any_term_with_a_robot_file_is_checked() -> None:
    moon = ARM_MJCF.replace("<worldbody>", '<option gravity="0 0 -1.62"/><worldbody>')
    found, expected = (run_checks(Model((one(RigidBodies(moon)),)), {}) for one in (Mine, lambda bodies: bodies))
    assert topics(found) == topics(expected)
    assert "gravity" in topics(found)
    assert len(found.links) == len(expected.links) > 0


@dataclass
class Counted(Smoother):
    """A smoother that counts what it smooths."""

    count: int = 0

    def __call__(self, log: Log) -> Motion:
        self.count += 1
        return Spline()(log)


def test_beside_an_identification_nothing_is_smoothed_again() -> None:
    smoother = Counted()
    logs = {"train": {"one": log(-1.0)}, "validation": {"two": other(-1.0)}}
    recipe = Recipe(smoother)
    found = identify(slider(), logs["train"], logs["validation"], recipe)
    before = smoother.count
    both = with_findings(found, slider(), logs, recipe)
    assert smoother.count == before
    assert [type(one.message) for one in both.findings] == [file_notes.ReversedSign]
    assert both.findings == run_checks(slider(), logs, recipe).findings
    assert both.notes == found.warnings


@pytest.mark.parametrize(
    ("limit", "search", "fitted"), [("MAX_FACTOR_NUMBERS", "FITS", False), ("MAX_SEARCH_NUMBERS", "CAUSES", True)]
)
def test_what_many_joints_leave_out_is_said(limit: str, search: str, fitted: bool, monkeypatch) -> None:
    """The factor of one joint with four parameters and the torque has 25 numbers."""
    monkeypatch.setattr(sys.modules[run_checks.__module__], limit, 24)
    found = run_checks(slider(), {"train": {"one": log()}})
    (one,) = found.findings
    assert one.message == SearchLeftOut(SearchKind[search], 1, len(slider().parameters))
    assert (found.rank is not None) is fitted
    assert "1 joint" in str(one)


@pytest.mark.parametrize("dead", [0, 1, 2])
def test_a_dead_torque_explains_itself_and_spoils_nothing_of_the_others(dead: int) -> None:
    moved = moving_arm.motion()
    noise = 1e-5 * np.random.default_rng(0).standard_normal(moved.q.shape)
    whole = Log(moved.t, moved.q + noise, moved.tau, moved.joints)
    silent = replace(whole, tau=whole.tau * (np.arange(3) != dead))
    sound, found = (run_checks(moving_arm.arm(), {"train": {"one": one}}) for one in (whole, silent))
    assert {(one.topic, one.joint) for one in set(found.findings) - set(sound.findings)} == {
        ("dead", moved.joints[dead])
    }


def test_what_a_held_joint_shows_is_no_missing_term() -> None:
    """Its wobble follows the torque, as if there were a spring."""
    arm, rate, size = two_link_arm(), np.array([2.0, 3.0]), np.array([1.5, 1e-3])
    x = rate * T[:, None]
    q, dq, ddq = size * np.sin(x), size * rate * np.cos(x), -size * rate**2 * np.sin(x)
    rng = np.random.default_rng(0)
    tau = arm.torque(q, dq, ddq, arm.values) + q * [0, 2000] + 1e-3 * rng.standard_normal(q.shape)
    names = tuple(joint.name for joint in arm.joints)
    found = run_checks(arm, {"train": {"held": Log(T, q + 1e-6 * rng.standard_normal(q.shape), tau, names)}}).findings
    assert [one.topic for one in found if isinstance(one.message, motion_notes.HardlyMoves)] == ["still"]
    assert not [one for one in found if isinstance(one.message, robot_notes.MissingTerm) and one.joint == names[1]]
