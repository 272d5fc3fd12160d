"""All together: what is left out, what fails, and what is still said."""

import sys
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import pytest

from dynident.checks import file_notes, motion_notes, robot_notes, run_checks
from dynident.checks.motion_notes import SearchKind, SearchLeftOut
from dynident.identification import Recipe
from dynident.identification.calibration import with_plain_terms
from dynident.models import Model, RigidBodies, Term
from dynident.models.friction import Coulomb, LoadCoulomb, Viscous
from dynident.models.lagrangian import slider
from dynident.motion.log import Log, Motion
from dynident.motion.smoothers import Difference, Smoother
from dynident.runtime import Finding, Note, Severity
from tests.checks import moving_arm
from tests.robots import ARM_MJCF

T = np.arange(1500) * 0.004
SLIDER = slider()
NAME = SLIDER.joints[0].name


def log(x: np.ndarray, dx: np.ndarray, ddx: np.ndarray, seed: int) -> Log:
    x = x + 1e-6 * np.random.default_rng(seed).standard_normal(len(T))
    return Log(T, x[:, None], (5 * ddx + 8 * dx + 3 * np.sign(dx))[:, None], (NAME,))


ONE = log(0.3 * np.sin(3 * T), 0.9 * np.cos(3 * T), -2.7 * np.sin(3 * T), 9)
TWO = log(
    0.3 * np.sin(2 * T) * np.cos(T), 0.15 * (3 * np.cos(3 * T) + np.cos(T)), -0.15 * (9 * np.sin(3 * T) + np.sin(T)), 8
)


@pytest.fixture(scope="module")
def sound():
    return run_checks(SLIDER, {"train": {"one": ONE}, "validation": {"two": TWO}})


def topics(result) -> list[str]:
    return [finding.topic for finding in result.findings]


@pytest.mark.parametrize(("outliers", "left_out"), [("mask", (1, 2)), ("keep", (0, 0))])
def test_the_facts_of_a_channel_leave_out_what_the_fit_does(outliers: Literal["mask", "keep"], left_out, sound) -> None:
    q, tau = ONE.q.copy(), ONE.tau.copy()
    q[500], tau[[250, 1000]] = 3.0, 900.0
    findings = run_checks(SLIDER, {"train": {"one": replace(ONE, q=q, tau=tau)}}, Recipe(outliers=outliers))
    (fact,), (expected,) = findings.channels["one"], sound.channels["one"]
    assert (fact.left_out, fact.torque_left_out) == left_out
    assert (fact.rms < 1.01 * expected.rms) == (fact.noise < 2 * expected.noise) == (outliers == "mask")


def test_a_log_with_an_error_is_left_out_of_the_motion_and_joints_are_matched_by_name(sound) -> None:
    torn = replace(ONE, t=T + np.where(np.arange(len(T)) > 500, 3.0, 0.0))
    more = Log(T, np.hstack([np.zeros_like(ONE.q), ONE.q]), np.hstack([ONE.tau * 0, ONE.tau]), ("other", NAME))
    both = run_checks(SLIDER, {"train": {"good": more, "torn": torn}})
    assert [(finding.topic, finding.source) for finding in both.findings] == [("gap", "torn")]
    assert both.has_errors
    assert both.excitations == sound.excitations
    assert run_checks(SLIDER, {"train": {"torn": torn}}).excitations == ()


@pytest.mark.parametrize(("usable", "time_offset"), [(0, 0.0), (1, "estimate"), (4, 0.0), (4, "estimate")])
def test_motions_of_few_usable_samples_are_an_error_that_is_found(
    usable: int, time_offset: float | Literal["estimate"]
) -> None:
    """Whatever smoother leaves so few; another log that has enough makes up for one."""

    class FewSamples(Smoother):
        def __call__(self, log: Log) -> Motion:
            motion = Difference("central")(log)
            few = np.isin(np.arange(len(log)), 700 + np.arange(usable))
            return replace(motion, mask=few) if log.source == "one" else motion

    recipe = Recipe(FewSamples(), time_offset=time_offset)
    findings = run_checks(SLIDER, {"train": {"one": ONE}, "validation": {"two": TWO}}, recipe)
    (error,) = (finding for finding in findings.findings if finding.severity is Severity.ERROR)
    assert str(error.message).startswith("one: ")
    assert "too few for 4 parameters" in str(error.message)
    assert findings.channels.keys() == {"one", "two"}
    assert not run_checks(SLIDER, {"train": {"one": ONE, "two": TWO}}, recipe).has_errors


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


def test_another_gravity_in_the_file_of_any_term_is_said() -> None:
    moon = RigidBodies(ARM_MJCF.replace("<default>", '<option gravity="0 0 -1.62"/><default>', 1))
    for term in (moon, Mine(moon)):
        findings = run_checks(Model((term,)), {})
        (gravity,) = (finding.message for finding in findings.findings if finding.topic == "gravity")
        assert gravity == file_notes.GravityIgnored((0.0, 0.0, -1.62), (0.0, 0.0, -9.81))
        assert len(findings.links) > 0
    assert "gravity" not in topics(run_checks(Model((RigidBodies(ARM_MJCF),)), {}))


@pytest.mark.parametrize(
    ("limit", "search", "fitted"), [("MAX_FACTOR_NUMBERS", "FITS", False), ("MAX_SEARCH_NUMBERS", "CAUSES", True)]
)
def test_what_many_joints_leave_out_is_said(limit: str, search: str, fitted: bool, monkeypatch) -> None:
    """The factor of one joint with four parameters and the torque has 25 numbers."""
    monkeypatch.setattr(sys.modules[run_checks.__module__], limit, 24)
    findings = run_checks(SLIDER, {"train": {"one": ONE}})
    (finding,) = findings.findings
    assert finding.message == SearchLeftOut(SearchKind[search], 1, len(SLIDER.parameters))
    assert (findings.rank is not None) is fitted


ARM = moving_arm.arm()
NOISE = 1e-5 * np.random.default_rng(0).standard_normal(moving_arm.MOVED.q.shape)


@pytest.fixture(scope="module")
def moved() -> Log:
    motion = moving_arm.MOVED
    return Log(motion.t, motion.q + NOISE, motion.tau, motion.joints)


@pytest.fixture(scope="module")
def sound_arm(moved: Log):
    return set(run_checks(ARM, {"train": {"one": moved}}).findings)


@pytest.mark.parametrize("doubt", [file_notes.OddScale(8.0, "N m"), file_notes.UnrelatedTorque(8.0, 0.1)], ids=str)
def test_a_file_that_is_wrong_raises_no_doubt_of_the_torque(doubt: Note, monkeypatch: pytest.MonkeyPatch) -> None:
    """The coupling with the other joints tells a tool from a wrong gain, and a fit the joint's torque from another."""
    finding, motion = Finding(doubt, "j3"), moving_arm.MOVED
    module = sys.modules[run_checks.__module__]
    monkeypatch.setattr(module, "agreement_findings", lambda entry, _unit: [finding] if entry.joint == "j3" else [])
    other = motion.tau[:, 2] + 10.0 * np.sin(1.7 * motion.t**1.5)
    wrong = 8.0 * motion.tau[:, 2] if isinstance(doubt, file_notes.OddScale) else other
    for torque, is_wrong in ((motion.tau[:, 2], False), (wrong, True)):
        tau = np.column_stack([motion.tau[:, :2], torque])
        log = Log(motion.t, motion.q + NOISE, tau, motion.joints)
        assert (finding in run_checks(ARM, {"train": {"one": log}}).findings) is is_wrong


def test_a_torque_without_friction_is_said_where_none_was_chosen(moved: Log) -> None:
    bare = Model(tuple(term for term in ARM.terms if not isinstance(term, (Viscous, Coulomb))))
    tau = bare.torque(moving_arm.MOVED.q, moving_arm.MOVED.dq, moving_arm.MOVED.ddq, moving_arm.truth(bare))
    logs = {"train": {"one": replace(moved, tau=tau)}}
    assert "friction" not in topics(run_checks(bare, logs))
    assert "friction" in topics(run_checks(bare, logs, plain=with_plain_terms(bare)))


def test_friction_by_the_load_is_missing_only_where_the_model_lacks_it(moved: Log) -> None:
    motion, bodies = moving_arm.MOVED, Model(ARM.terms[:1])
    load = bodies.torque(motion.q, motion.dq, motion.ddq, moving_arm.truth(bodies))
    logs = {"train": {"one": replace(moved, tau=moved.tau + 0.3 * np.abs(load) * np.sign(motion.dq))}}
    for model, effects in ((ARM, {"LOAD"}), (Model((*ARM.terms, LoadCoulomb(ARM.joints))), set())):
        notes = [finding.message for finding in run_checks(model, logs).findings]
        assert {note.effect.name for note in notes if isinstance(note, robot_notes.MissingTerm)} == effects


def test_a_clock_that_is_far_off_explains_the_scale_of_the_torques(moved: Log) -> None:
    findings = run_checks(ARM, {"train": {"one": replace(moved, t=0.5 * moved.t)}}).findings
    (clock,) = (finding.message for finding in findings if isinstance(finding.message, robot_notes.ClockWrong))
    assert clock.value == pytest.approx(2.0, rel=0.05)
    assert not [finding for finding in findings if isinstance(finding.message, file_notes.OddScale)]


@pytest.mark.parametrize("dead", [0, 2])
def test_a_dead_torque_explains_itself_and_spoils_nothing_of_the_others(dead: int, moved: Log, sound_arm) -> None:
    silent = replace(moved, tau=moved.tau * (np.arange(3) != dead))
    more = set(run_checks(ARM, {"train": {"one": silent}}).findings) - sound_arm
    assert {(x.topic, x.joint) for x in more} == {("dead", moved.joints[dead])}


def test_what_a_held_joint_shows_is_no_missing_term() -> None:
    """Its wobble follows the torque, as if there were a spring."""
    motion, size = moving_arm.MOVED, np.array([1.0, 1.0, 1e-3])
    q, dq, ddq = (size * x for x in (motion.q, motion.dq, motion.ddq))
    tau = ARM.torque(q, dq, ddq, moving_arm.truth(ARM)) + q * [0, 0, 2000] + 100 * NOISE
    held = Log(motion.t, q + 0.1 * NOISE, tau, motion.joints)
    findings = run_checks(ARM, {"train": {"held": held}}, Recipe(time_offset=0.0)).findings
    assert [x.topic for x in findings if isinstance(x.message, motion_notes.HardlyMoves)] == ["still"]
    assert not [x for x in findings if isinstance(x.message, robot_notes.MissingTerm) and x.joint == "j3"]
