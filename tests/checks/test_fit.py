"""Compensated gravity, motion that is too slow, and logs that repeat."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.checks import file_notes, log_notes, robot_notes, run_checks
from dynident.checks.motion import compensation_findings, friction_findings, repeat_findings, slow_findings
from dynident.checks.stamps import thin_regression
from dynident.models import Model, RigidBodies
from dynident.models.friction import Coulomb, Viscous
from dynident.motion.log import Log, Motion
from tests.checks import moving_arm
from tests.checks.moving_arm import waves
from tests.robots import ARM

BODIES = RigidBodies(ARM)
MODEL = Model((BODIES,))
RUBBING = Model((BODIES, Viscous(BODIES.joints), Coulomb(BODIES.joints)))
THETA = np.array([x.value for x in MODEL.parameters], dtype=float)
T = np.arange(1500) * 0.01


def motion(seed: int, *, speed: float = 1.0, gravity: bool = True) -> Motion:
    """Sums of sines on every joint, with the torque of the file's inertias and noise."""
    rng, shape = np.random.default_rng(seed), (3, len(MODEL.joints))
    sizes, rates, phases = rng.uniform(0.1, 0.4, shape), rng.uniform(1, 6, shape) * speed, rng.uniform(0, 6, shape)
    model = MODEL if gravity else Model((RigidBodies(ARM, gravity=(0.0, 0.0, 0.0)),))
    return waves(model, THETA, rates, sizes, phases, 0.05, seed, T)


@pytest.mark.parametrize("seed", range(4))
def test_whole_torques_of_fast_motion_have_no_findings(seed: int) -> None:
    case = [motion(seed)]
    assert list(compensation_findings(thin_regression(MODEL, case))) == []
    assert list(slow_findings(thin_regression(MODEL, case))) == []


@pytest.mark.parametrize("seed", range(3))
def test_compensated_gravity_is_said_with_its_share(seed: int) -> None:
    (finding,) = compensation_findings(thin_regression(MODEL, [motion(seed, gravity=False)]))
    note = finding.message
    assert isinstance(note, log_notes.GravityCompensated)
    assert abs(note.factor) < max(5 * note.std, 0.02)
    assert note.after < 0.8 * note.before


def test_compensated_gravity_is_said_beside_a_larger_effect_that_the_model_lacks() -> None:
    """Friction without a term hides most of the difference; nothing else is said of the torques of the arm."""
    bare = motion(0, gravity=False)
    rubbed = replace(bare, tau=bare.tau + bare.tau.std(axis=0) * np.sign(bare.dq))
    (finding,) = compensation_findings(thin_regression(MODEL, [rubbed]))
    assert abs(finding.message.factor) < 0.1
    assert 0.8 * finding.message.before < finding.message.after < 0.95 * finding.message.before
    log = Log(T, rubbed.q, rubbed.tau, rubbed.joints)
    kinds = {type(finding.message) for finding in run_checks(MODEL, {"train": {"log": log}}).findings}
    assert log_notes.GravityCompensated in kinds
    assert not kinds & {robot_notes.TermLeftOut, robot_notes.Unexplained, file_notes.UnrelatedTorque}


def test_columns_one_place_off_are_no_compensated_gravity() -> None:
    q, tau = (np.roll(x, 1, axis=1) for x in (moving_arm.MOVED.q, moving_arm.MOVED.tau))
    log = Log(moving_arm.T, q, tau, moving_arm.MOVED.joints)
    findings = run_checks(moving_arm.arm(), {"train": {"log": log}}).findings
    assert [type(x.message) for x in findings if x.forbids] == [file_notes.JointsSwapped]


@pytest.mark.parametrize("shown", [0.0, 0.002, 0.05])
def test_torque_without_friction_is_said(shown: float) -> None:
    """Friction of which the torque shows so large a share."""
    bare = motion(0)
    slid = np.sign(bare.dq) + bare.dq / bare.dq.std(axis=0)
    tau = bare.tau + shown * bare.tau.std(axis=0) * slid
    result = list(friction_findings(thin_regression(RUBBING, [replace(bare, tau=tau)])))
    if shown > 0.01:
        assert result == []
    else:
        (case,) = result
        assert isinstance(case.message, log_notes.NoFriction)
        assert case.message.share < 1


@pytest.mark.parametrize("seed", range(3))
def test_slow_motion_is_said(seed: int) -> None:
    (result,) = slow_findings(thin_regression(MODEL, [motion(seed, speed=0.02)]))
    assert isinstance(result.message, log_notes.SlowMotion)
    assert result.message.share < result.message.residual / 3
    assert result.message.faster > 3


def test_windows_that_overlap_are_said_with_their_share() -> None:
    moved = motion(1)
    train, half, little = (
        Log(moved.t[k], moved.q[k], moved.tau[k], moved.joints) for k in np.s_[:900, 580:1300, 850:1500]
    )
    (finding,) = repeat_findings({"train": {"a": train}, "validation": {"half": half, "little": little}})
    assert finding.source == "half"
    assert isinstance(finding.message, log_notes.SharedSamples)
    assert finding.message.share == pytest.approx(320 / 720, abs=0.01)
