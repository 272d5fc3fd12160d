"""Sign, scale and column of a torque against the robot file, on simulated torques whose faults are known."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.checks import file_notes
from dynident.checks.torque import agreement, agreement_findings
from dynident.models import Model, RigidBodies, RotorInertia
from dynident.models.friction import Offset, Viscous
from dynident.models.lagrangian import slider
from dynident.motion.log import Motion
from dynident.runtime import Note
from tests.checks.moving_arm import waves
from tests.robots import ARM, joint, link, urdf

BODIES = RigidBodies(ARM)
JOINTS = BODIES.joints
ARM_MODEL = Model((BODIES, RotorInertia(JOINTS), Viscous(JOINTS), Offset(JOINTS)))
TRUE = np.array([parameter.value if parameter.value is not None else 0.1 for parameter in ARM_MODEL.parameters])
T = np.arange(0, 20, 0.01)


def motion(model: Model = ARM_MODEL, theta: np.ndarray = TRUE) -> Motion:
    n = np.arange(len(model.joints))
    return waves(model, theta, 1.3 + 0.7 * n, 0.8 - 0.1 * n, seed=8, t=T)


def notes_on(moved: Motion, model: Model = ARM_MODEL) -> dict[str | None, Note]:
    """The notes by joint."""
    return {x.joint: x.message for entry in agreement(model, [moved]) for x in agreement_findings(entry, "N m")}


def test_a_right_torque_raises_no_question() -> None:
    assert notes_on(motion()) == {}


@pytest.mark.parametrize("joint", range(len(JOINTS)))
def test_a_turned_sign_is_asked_about_for_that_joint_alone(joint: int) -> None:
    gain = np.ones(len(JOINTS))
    gain[joint] = -1
    moved = motion()
    ((name, note),) = notes_on(replace(moved, tau=gain * moved.tau)).items()
    assert (name, type(note)) == (JOINTS[joint].name, file_notes.ReversedSign)
    assert note.correlation is None or note.correlation == pytest.approx(-1.0, abs=0.01)


@pytest.mark.parametrize("gain", [100.0, 0.01])
def test_a_missing_gear_or_unit_is_asked_about(gain: float) -> None:
    moved = motion()
    right = file_notes.OddScale(pytest.approx(gain, rel=0.01), "N m")
    notes = list(notes_on(replace(moved, tau=gain * moved.tau)).values())
    assert notes == [right] * len(notes) != []


def test_a_torque_of_another_joint_is_asked_about() -> None:
    moved = motion()
    weak = int(np.argmin(moved.tau.std(axis=0)))
    strong = int(np.argmax(moved.tau.std(axis=0)))
    swapped = moved.tau.copy()
    swapped[:, strong] = moved.tau[:, weak]
    notes = notes_on(replace(moved, tau=swapped))
    (note,) = (x for x in notes.values() if isinstance(x, file_notes.UnrelatedTorque))
    assert notes[JOINTS[strong].name] is note
    assert note.ratio > 2
    assert abs(note.correlation) < 0.3


BALANCED = urdf(
    link("base"), link("upper", 2.0, (0.15, 0, 0.02)), link("fore", 1.0, (0.1, 0, 0.03)),
    joint("shoulder", "revolute", "base", "upper", axis=(0, 1, 0)),
    joint("elbow", "revolute", "upper", "fore", (0.3, 0, 0), axis=(0, 1, 0)),
)  # fmt: skip


@pytest.mark.parametrize(
    ("share", "speed"), [(0.8, 0.3), (0.9, 1.0), (1.0, 0.3), (1.0, 1.0), (1.1, 0.6), (1.3, 0.3), (2.0, 1.0)]
)
def test_a_counterbalance_explains_what_the_file_does_not(share: float, speed: float) -> None:
    """It carries a share of the weight; without it the torque would pass for another's, or for one of another sign."""
    bodies = RigidBodies(BALANCED)
    model = Model((bodies, RotorInertia(bodies.joints), Viscous(bodies.joints), Offset(bodies.joints)))
    theta = np.array([0.1 if parameter.value is None else parameter.value for parameter in model.parameters])
    rates = speed * np.array([1.3, 2.0])
    phase = np.outer(T, rates)
    states = np.sin(phase), rates * np.cos(phase), -(rates**2) * np.sin(phase)
    tau = model.torque(*states, theta)
    weight = np.column_stack([np.sin(states[0][:, 0]), np.cos(states[0][:, 0])])
    tau[:, 0] -= share * weight @ np.linalg.lstsq(weight, tau[:, 0])[0]
    names = tuple(each.name for each in bodies.joints)
    assert notes_on(Motion(T, *states, tau, names, np.ones(len(T), bool)), model) == {}


def test_without_a_robot_file_friction_and_inertia_tell_the_sign() -> None:
    model = slider()
    moved = motion(model, np.array([5.0, 8.0, 3.0, 0.5]))
    assert notes_on(moved, model) == {}
    assert notes_on(replace(moved, tau=-moved.tau), model) == {model.joints[0].name: file_notes.ReversedSign(None)}
