"""Large faults are found by trying, and a right log has none."""

import re
from dataclasses import replace

import numpy as np
import pytest

from dynident.checks import file_notes
from dynident.checks.alternatives import better_alternative
from dynident.checks.file_notes import (
    AffectedColumns,
    ColumnReversed,
    JointsSwapped,
    MotorCoupled,
    OtherAxis,
    OtherZero,
)
from dynident.models import Model, RigidBodies
from dynident.motion.log import Motion
from dynident.runtime import Finding
from tests.checks.moving_arm import MOVED, arm, case, motion, text, truth

ORDER = [0, 2, 1]
NAMES = {
    AffectedColumns.TORQUE: ("tau",),
    AffectedColumns.POSITION: ("q", "dq", "ddq"),
    AffectedColumns.BOTH: ("tau", "q", "dq", "ddq"),
}


def found(moved: Motion = MOVED, model: Model | None = None) -> list[Finding]:
    return list(better_alternative(case(moved, model, samples=250)))


def changed(channel: AffectedColumns, change) -> Motion:
    return replace(MOVED, **{name: change(getattr(MOVED, name)) for name in NAMES[channel]})


def test_a_right_log_has_none() -> None:
    assert found() == []


def test_torques_of_joints_that_rest_while_another_moves_are_no_exchanged_columns() -> None:
    """They are constant, so that any joint explains them by its offset; the friction of each is not of the model."""
    moves = np.repeat(np.eye(3), len(MOVED.t) // 3 + 1, axis=0)[: len(MOVED.t)]
    model, states = arm(), (moves * MOVED.q, moves * MOVED.dq, moves * MOVED.ddq)
    jitter = 1e-4 * np.random.default_rng(0).standard_normal(MOVED.q.shape)
    tau = model.torque(*states, truth(model)) + 1.5 * np.sin(40 * states[0])
    assert found(replace(MOVED, q=states[0], dq=states[1] + jitter, ddq=states[2], tau=tau)) == []


@pytest.mark.parametrize("channel", AffectedColumns)
def test_columns_of_two_joints_that_are_exchanged(channel: AffectedColumns) -> None:
    (entry,) = found(changed(channel, lambda x: x[:, ORDER]))
    assert isinstance(entry.message, JointsSwapped)
    assert (entry.message.joints, entry.message.channel) == (("j2", "j3"), channel)
    assert entry.message.after < 0.5 * entry.message.before


@pytest.mark.parametrize("channel", AffectedColumns)
@pytest.mark.parametrize(("steps", "joints"), [(1, ("j1", "j2", "j3")), (-1, ("j3", "j2", "j1"))])
def test_columns_of_all_joints_that_are_one_place_off(channel: AffectedColumns, steps: int, joints: tuple) -> None:
    (finding,) = found(changed(channel, lambda x: np.roll(x, steps, axis=1)))
    assert isinstance(finding.message, JointsSwapped)
    assert (finding.message.joints, finding.message.channel) == (joints, channel)


@pytest.mark.parametrize(
    ("channel", "joint"), [(AffectedColumns.POSITION, 1), (AffectedColumns.POSITION, 2), (AffectedColumns.BOTH, 1)]
)
def test_a_column_that_is_reversed(channel: AffectedColumns, joint: int) -> None:
    sign = np.where(np.arange(3) == joint, -1.0, 1.0)
    (entry,) = found(changed(channel, lambda x: sign * x))
    assert isinstance(entry.message, ColumnReversed)
    assert (entry.joint, entry.message.channel) == (f"j{joint + 1}", channel)


def test_motors_that_are_reversed() -> None:
    model = arm(text(axis=(0, 0, 1)))
    right, sign = motion(model=model), np.array([-1.0, -1.0, 1.0])
    wrong = replace(right, **{name: sign * getattr(right, name) for name in NAMES[AffectedColumns.BOTH]})
    (entry,) = found(wrong, model)
    assert isinstance(entry.message, ColumnReversed)
    assert (entry.joint, entry.message.others, entry.message.channel) == ("j1", ("j2",), AffectedColumns.BOTH)


def test_an_axis_that_is_another() -> None:
    (entry,) = found(model=arm(text(axis=(1, 0, 0))))
    assert isinstance(entry.message, OtherAxis)
    assert (entry.joint, entry.message.given) == ("j3", (1, 0, 0))
    assert np.abs(entry.message.fitted).tolist() == [0, 1, 0]


@pytest.mark.parametrize("quarters", [1, -1, 2])
def test_a_zero_that_is_quarter_turns_away(quarters: int) -> None:
    (finding,) = found(replace(MOVED, q=MOVED.q - quarters * np.pi / 2 * np.eye(3)[1]))
    assert isinstance(finding.message, OtherZero)
    assert (finding.joint, finding.message.angle) == ("j2", 90 * quarters)


@pytest.mark.parametrize("channel", [AffectedColumns.POSITION, AffectedColumns.BOTH])
@pytest.mark.parametrize("coefficient", [1, -1])
def test_a_motor_that_turns_with_another_joint_too(coefficient: int, channel: AffectedColumns) -> None:
    """Its positions are A q, and by virtual work its torques inv(A') tau."""
    gears = np.eye(3)
    gears[2, 1] = coefficient
    (finding,) = found(
        changed(channel, lambda x: x @ gears.T if x is not MOVED.tau else np.linalg.solve(gears.T, x.T).T)
    )
    note = finding.message
    assert isinstance(note, MotorCoupled)
    assert (note.joint, note.partner, note.coefficient, note.channel) == ("j3", "j2", coefficient, channel)


def test_the_friction_of_a_motor_that_turns_with_two_joints_is_that_of_its_own_motion() -> None:
    """As of a parallel linkage, whose third motor turns the forearm against the base, not against the upper arm."""
    gears = np.array([[1.0, 0, 0], [0, 1, 0], [0, 1, 1]])
    q, dq, ddq = (x @ gears.T for x in (MOVED.q, MOVED.dq, MOVED.ddq))
    tau = np.linalg.solve(gears.T, MOVED.tau.T).T
    size = np.sqrt(np.mean(tau[:, 2] ** 2))
    tau[:, 2] += size * (2.0 * np.sign(dq[:, 2]) + dq[:, 2] / np.std(dq[:, 2]))
    (finding,) = found(replace(MOVED, q=q, dq=dq, ddq=ddq, tau=tau))
    assert isinstance(finding.message, MotorCoupled)
    assert (finding.joint, finding.message.channel) == ("j3", AffectedColumns.BOTH)
    assert "`couplings: { j3_motor: { joints: { j3: 1, j2: 1 } } }` in `model`" in str(finding.message)


def test_gravity_that_is_another_whatever_the_inertias_of_the_file() -> None:
    gravity = (9.81, 0.0, 0.0)
    hung = Model((RigidBodies(text(), gravity=gravity), *arm().terms[1:]))
    light = arm(re.sub(r'mass value="[^"]*"', 'mass value="0.001"', text()))
    (entry,) = found(motion(model=hung, theta=truth(hung)), light)
    assert isinstance(entry.message, file_notes.OtherGravity)
    np.testing.assert_allclose(entry.message.fitted, np.round(gravity, 1))
