"""Robot files with one fault each: the fault is named, and nothing else is."""

import numpy as np
import pytest

from dynident.checks import check_robot, file_notes
from dynident.models.rigid_bodies import read_robot_file
from dynident.runtime import Finding, Note
from tests.robots import joint, link, urdf

BASE = link("base", 4.0)
ROD = np.diag([0.001, 0.015, 0.015])  # 2 kg, 0.3 m long
UPPER = link("upper", 2.0, (0.15, 0.0, 0.0), tensor=ROD)
FORE = link("fore", 1.5, (0.12, 0.0, 0.0), tensor=0.6 * ROD)
SHOULDER = joint("shoulder", "revolute", "base", "upper")
ELBOW = joint("elbow", "revolute", "upper", "fore", (0.3, 0.0, 0.0))


def arm(upper: str = UPPER, fore: str = FORE, shoulder: str = SHOULDER, elbow: str = ELBOW, *more: str) -> str:
    return urdf(BASE, upper, fore, shoulder, elbow, *more)


def found(xml: str, **options) -> tuple[Finding, ...]:
    return check_robot(read_robot_file(xml, "arm.urdf"), **options)


def origin(mass: float, c: float) -> np.ndarray:
    return np.diag([0.0, mass * c**2, mass * c**2])


LIMIT = '<limit effort="{}" velocity="{}" lower="{}" upper="{}"/>'
FAULTS = {
    "negative mass": (
        arm(upper=link("upper", -2.0)), "error", "impossible", "upper",
        file_notes.ImpossibleInertia("negative mass -2 kg"),
    ),
    "no triangle": (
        arm(upper=link("upper", 2.0, tensor=np.diag([0.001, 0.001, 0.02]))), "error", "impossible", "upper",
        file_notes.ImpossibleInertia(
            "principal moments 0.001, 0.001, 0.02 kg m^2 break the triangle inequality: the largest exceeds the sum of "
            "the others"
        ),
    ),
    "massless": (arm(fore=link("fore")), "warning", "massless", "fore", file_notes.NoMass(("fore",))),
    "millimetres": (
        arm(fore=link("fore", 1.5, (120.0, 0, 0), tensor=ROD)), "warning", "far", "fore", file_notes.FarCentre(120.0),
    ),
    "too wide": (
        arm(fore=link("fore", 0.3, tensor=0.05 * np.eye(3))), "warning", "spread", "fore",
        file_notes.LargeGyration(pytest.approx(0.05), pytest.approx((0.05 / 0.3) ** 0.5), 0.3, 0.3),
    ),
    "grams": (
        arm(link("upper", 2e3, (0.15, 0, 0), tensor=1e3 * ROD), link("fore", 4e3, (0.12, 0, 0), tensor=2e3 * ROD)),
        "warning", "total mass", "", file_notes.OddTotalMass(6004.0),
    ),
    "about origin": (
        arm(
            link("upper", 2.0, (0.15, 0.0, 0.0), tensor=ROD + origin(2.0, 0.15)),
            link("fore", 1.5, (0.12, 0.0, 0.0), tensor=0.6 * ROD + origin(1.5, 0.12)),
        ),
        "warning", "about origin", "", file_notes.InertiaAboutOrigin(("upper", "fore")),
    ),
    "a point": (
        arm(fore=link("fore", 0.2, tensor=np.zeros((3, 3)))), "info", "point", "fore", file_notes.PointMass(0.2),
    ),
    "no effort": (
        arm(elbow=joint("elbow", "revolute", "upper", "fore", inside=LIMIT.format(0, 2, -1, 1))),
        "warning", "limits", "", file_notes.LimitNotPositive("effort", 0.0),
    ),
    "no range": (
        arm(elbow=joint("elbow", "revolute", "upper", "fore", inside=LIMIT.format(9, 2, 0, 0))),
        "warning", "limits", "", file_notes.EmptyRange(0.0, 0.0),
    ),
}  # fmt: skip


@pytest.mark.parametrize(("xml", "severity", "topic", "link", "note"), FAULTS.values(), ids=FAULTS)
def test_each_fault_is_found_and_is_the_only_one(xml: str, severity: str, topic: str, link: str, note: Note) -> None:
    (finding,) = found(xml)
    assert (finding.severity, finding.topic, finding.link) == (severity, topic, link)
    assert finding.message == note
    assert finding.source == "arm.urdf"


def test_a_sound_arm_has_none() -> None:
    """Nor has the boom of a large machine, which is in metres, or a frame without mass that is fixed to a link."""
    boom = link("upper", 1800.0, (2.0, 0.0, 0.3), tensor=np.diag([150.0, 4000.0, 4000.0]))
    elbow = joint("elbow", "revolute", "upper", "fore", (5.0, 0.0, 0.0))
    flange = (link("flange"), joint("flange joint", "fixed", "fore", "flange"))
    beam = link("fore", 1.5, (0.0, 0.0, 0.0), tensor=np.diag([0.002, 0.3, 0.3]))  # as long as the travel on it
    crane = arm(fore=beam, elbow=joint("elbow", "prismatic", "upper", "fore", (0.3, 0.0, 0.0)))
    for sound in (arm(), arm(boom, elbow=elbow), arm(UPPER, FORE, SHOULDER, ELBOW, *flange), crane):
        assert found(sound) == ()
    assert len(found(arm(fore=beam))) == 1


def test_copies_are_distinguished_from_placeholders_and_from_a_gripper() -> None:
    twin = link("fore", 2.0, (0.15, 0.0, 0.0), tensor=ROD)
    (copied,) = found(arm(fore=twin))
    assert (copied.severity, copied.topic) == ("info", "copied")
    assert copied.message == file_notes.EqualLinks(("upper", "fore"), 2.0, alone=False)
    (all_alike,) = found(arm(fore=twin).replace(BASE, link("base", 2.0, (0.15, 0.0, 0.0), tensor=ROD)))
    assert (all_alike.severity, all_alike.topic) == ("warning", "copied")
    assert all_alike.message == file_notes.EqualLinks(("base", "upper", "fore"), 2.0, alone=True)
    fingers = [link(name, 0.1, tensor=1e-5 * np.eye(3)) for name in ("left", "right")]
    joints = [joint(f"{name} joint", "prismatic", "fore", name) for name in ("left", "right")]
    assert found(arm(UPPER, FORE, SHOULDER, ELBOW, *fingers, *joints)) == ()


def test_missing_limits_are_reported_once_for_all_joints_that_move() -> None:
    bare = [joint(name, "continuous", *ends) for name, *ends in (("s", "base", "upper"), ("e", "upper", "fore"))]
    effort, velocity = found(urdf(BASE, UPPER, FORE, *bare))
    assert effort.message == file_notes.NoLimit("effort", ("s", "e"))
    assert velocity.message == file_notes.NoLimit("velocity", ("s", "e"))
    assert found(urdf(BASE, UPPER, FORE, *bare), joints=["s"])[0].message == file_notes.NoLimit("effort", ("s",))


def test_what_mujoco_computes_from_meshes_is_said() -> None:
    xml = (
        '<mujoco><worldbody><body name="arm"><joint name="hinge"/><geom type="mesh" mesh="shell"/></body></worldbody>'
        "</mujoco>"
    )
    shapes = [x for x in found(xml) if x.topic == "shapes"]
    assert [(shape.link, shape.message) for shape in shapes] == [("arm", file_notes.OnlyShapes())]
