"""What an MJCF may say in more than one way: each is the same arm."""

import sys

import numpy as np
import pytest

from dynident.models import RigidBodies
from dynident.runtime import ModelError
from tests.robots import ARM_MJCF

SECOND = '<body name="wrist" pos="0 0 0.2" xyaxes="0.7648421872844885 0.644217687237691 0 -1 1 0">'
TWIST = '<joint name="twist" axis="0 1 0" class="main"/>'
STATES = np.random.default_rng(0).normal(size=(3, 4, 3))


def torque(text: str, **options: object) -> np.ndarray:
    term = RigidBodies(text, **options)
    values = np.array([parameter.value for parameter in term.parameters])
    return term.torque(*STATES[:, :, : len(term.joints)], values)


def replaced(*pairs: tuple[str, str]) -> str:
    text = ARM_MJCF
    for old, new in pairs:
        assert old in text
        text = text.replace(old, new, 1)
    return text


def test_several_joints_of_one_body_are_those_of_nested_bodies() -> None:
    more = '<joint name="swing" axis="1 0 1" pos="0.1 0 0.2" ref="0.3" type="hinge" class="main"/>'
    lift = '<joint name="lift" axis="0 0 1" type="slide" pos="0.3 0 0" class="main"/>'
    case = replaced((TWIST, more + lift + TWIST))
    nested = replaced(
        (SECOND, f'{SECOND}{more}<body name="a">{lift}<body name="b">'), (TWIST, f"{TWIST}</body></body>")
    )
    used = ("swing", "lift", "twist")
    assert [joint.name for joint in RigidBodies(case).joints] == ["shoulder", "rail", *used]
    assert [p.body for p in RigidBodies(case).parameters[::10]] == ["upper", "slide", "wrist"]
    for options in ({"joints_used": used}, {"joints_used": used[::-1]}, {"joints_used": used, "locked": {"rail": 0.2}}):
        np.testing.assert_allclose(torque(case, **options), torque(nested, **options), rtol=1e-13, atol=1e-13)


def test_a_floating_base_stands_still_and_is_named() -> None:
    for joint, name in (("<freejoint/>", "base (free)"), ('<joint name="f" type="free"/>', "f")):
        text = replaced(('<body name="base">', f'<body name="base">{joint}'))
        assert RigidBodies(text).file.floating == (name,)
        np.testing.assert_array_equal(torque(text), torque(ARM_MJCF))
        assert torque(text, locked={name: 0.0}).shape == (4, 3)


@pytest.mark.parametrize("ref", ["0.1", "0"])
def test_an_equality_of_two_joints_makes_one_follow(ref: str) -> None:
    """q_twist = 0.3 + 2 (q_rail - ref), and its torque acts on the rail twice."""
    tied = replaced(
        ('axis="1 0 0" range="-1 1"', f'axis="1 0 0" range="-1 1" ref="{ref}"'),
        ("</mujoco>", '<equality><joint joint1="twist" joint2="rail" polycoef="0.3 2"/></equality></mujoco>'),
    )
    free = tied.replace("<equality><joint", '<equality><joint active="false"')
    term, other = RigidBodies(tied), RigidBodies(free)
    assert [joint.name for joint in term.joints] == ["shoulder", "rail"]
    assert [p.name for p in term.parameters] == [p.name for p in other.parameters]
    q, dq, ddq = STATES[:, :, :2]
    spread = np.array([[1, 0], [0, 1], [0, 2.0]])
    rest = np.array([0, 0, 0.3 - 2 * float(ref)])
    expected = other.regressor(q @ spread.T + rest, dq @ spread.T, ddq @ spread.T)
    np.testing.assert_allclose(term.regressor(q, dq, ddq), spread.T @ expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("tendon", ["", ' stiffness="0"', ' limited="true" range="0 1"'])
def test_a_tendon_that_is_only_measured_couples_nothing(tendon: str) -> None:
    fixed = f'<tendon><fixed name="t"{tendon}><joint joint="rail" coef="1"/><joint joint="twist" coef="2"/></fixed>'
    text = replaced(("</mujoco>", f"{fixed}</tendon></mujoco>"))
    np.testing.assert_array_equal(torque(text), torque(ARM_MJCF))


END = "</worldbody></mujoco>"
BAD_MJCF = {
    "include": ("<default>", '<include file="x.xml"/><default>', "<include> names another file"),
    "replicate": ('<body name="slide"', '<replicate count="2"/><body name="slide"', "<replicate> is not supported"),
    "attach": ('<body name="slide"', '<attach model="x"/><body name="slide"', "<attach> is not supported"),
    "global": ('angle="radian"', 'coordinate="global"', "global coordinates no longer supported"),
    "nameless joint": ('<joint name="twist"', "<joint", "of body 'wrist': it has no name"),
    "same bodies": ('<body name="tool"', '<body name="base"', "the name 'base' is given to more than one body"),
    "ball": ('type="slide" axis="1 0 0" range="-1 1"', 'type="ball"', "joint 'rail' .* it is a ball joint"),
    "nameless ball": ('<inertial mass="1"', '<joint type="ball"/><inertial mass="1"', "'slide .ball.' .* it is"),
    "spring": ('damping="0.4"', 'damping="0.4" stiffness="3"', "it has a spring .stiffness 3."),
    "polynomial": (
        END, '</worldbody><equality><joint joint1="rail" joint2="twist" polycoef="0 1 2"/></equality></mujoco>',
        "binds it to",
    ),
    "follows nothing": (
        END, '</worldbody><equality><joint joint1="rail" joint2="twits"/></equality></mujoco>', "'twits'"
    ),
    "coupled tendons": (
        END,
        END.replace("</mujoco>", "<equality><tendon tendon1='t'/></equality><tendon><fixed name='t'>")
        + "<joint joint='rail' coef='1'/></fixed></tendon></mujoco>",
        "<equality> <tendon> '' binds it to 'rail'",
    ),
    "connect": (
        END, '</worldbody><equality><connect body1="upper" body2="wrist" anchor="0 0 0"/></equality></mujoco>', "a loop"
    ),
    "sites": (
        END, '<site name="a"/><site name="b"/></worldbody><equality><weld site1="a" site2="b"/></equality></mujoco>',
        "closes a loop",
    ),
    "too large": ('pos="0 0 0.2"', 'pos="0 0 1e200"', "body_pos has no numbers below 1e.30"),
    "tendon": (
        END, END.replace("</mujoco>", '<tendon><fixed name="t" stiffness="3"><joint joint="rail" coef="1"/></fixed>')
        + "</tendon></mujoco>",
        "<tendon> <fixed> 't' binds it to 'rail'",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("old", "new", "message"), BAD_MJCF.values(), ids=BAD_MJCF)
def test_bad_mjcf_files(old, new, message):
    assert old in ARM_MJCF
    with pytest.raises(ModelError, match=message):
        RigidBodies(ARM_MJCF.replace(old, new, 1))


def test_without_mujoco_it_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(ModelError, match=r"arm\.xml: it is an MJCF, which MuJoCo compiles.*install mujoco"):
        RigidBodies(f"{ARM_MJCF}\n", source="arm.xml")


def test_what_the_arm_is_not_made_of_needs_no_files():
    """Textures, sensors, actuators and cameras are not looked at."""
    text = replaced(
        ("<asset>", '<asset><texture name="t" type="2d" file="no.png"/><material name="m" texture="t"/>'),
        ('<geom type="mesh"', '<camera name="c" target="nothing"/><geom material="m" type="mesh"'),
        ("</mujoco>", '<sensor><accelerometer site="nowhere"/></sensor><size memory="900G"/></mujoco>'),
    )
    np.testing.assert_array_equal(torque(text), torque(ARM_MJCF))
