"""Limits of a motion, from the file, as given or by rule, and what an arm may do within them."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from dynident.apps.excitation import JointLimits, min_fit_speeds, motion_limits
from dynident.apps.excitation.limits import ACCELERATION_TIME, JERK_TIME
from dynident.models import Model, RigidBodies
from dynident.models.friction import Coulomb, LoadCoulomb
from dynident.runtime import ConfigError, ModelError
from tests.apps.excitation.arms import AROUND, FREE, LIMITS, MODEL, THETA, Post
from tests.robots import ARM_MJCF, GRIPPER, joint, link, urdf


def arm(inside='<limit effort="10" velocity="2" lower="-1" upper="3"/>', kind="revolute"):
    text = urdf(link("base"), link("tip", 1.0), joint("hinge", kind, "base", "tip", inside=inside))
    return Model((RigidBodies(text, source="tip.urdf"),), name="tip")


def test_the_margin_is_a_share_of_each_range_half_of_it_at_either_end_of_the_positions():
    limits = motion_limits(arm(), margin=0.2)
    assert (limits.lower[0], limits.upper[0]) == pytest.approx((-0.6, 2.6))
    assert (limits.velocity[0], limits.torque[0]) == pytest.approx((1.6, 8.0))
    assert limits.acceleration[0] == pytest.approx(1.6 / ACCELERATION_TIME)
    assert limits.jerk[0] == pytest.approx(1.6 / ACCELERATION_TIME / JERK_TIME)
    assert limits.by_rule == {"hinge": ("acceleration", "jerk")}
    assert (limits.middle[0], limits.half[0]) == pytest.approx((1.0, 1.6))
    np.testing.assert_allclose(limits.sizes[:, 0], [1.6, 1.6, 6.4, 128.0])


def test_given_limits_come_before_those_of_the_file_and_what_exceeds_these_is_named():
    given = JointLimits(lower=-0.5, upper=3.5, velocity=1.0, acceleration=7.0, jerk=90.0, torque=12.0)
    limits = motion_limits(arm(), {"hinge": given}, margin=0.0)
    row = [limits.lower, limits.upper, limits.velocity, limits.acceleration, limits.jerk, limits.torque]
    assert [float(x[0]) for x in row] == [-0.5, 3.5, 1.0, 7.0, 90.0, 12.0]
    assert limits.by_rule == {}
    assert limits.beyond == {"hinge": ("upper", "torque")}


@pytest.mark.parametrize(
    ("kind", "ends"), [("continuous", ""), ("revolute", 'lower="-1e6" upper="1e6"')], ids=["endless", "very wide"]
)
def test_a_joint_that_turns_without_end_has_half_a_turn_to_either_side(kind, ends):
    hinge = arm(f'<limit effort="10" velocity="2" {ends}/>', kind)
    limits = motion_limits(hinge, margin=0.0)
    assert (limits.lower[0], limits.upper[0]) == (-np.pi, np.pi)
    assert limits.by_rule["hinge"][0] == "position"
    # a range of more than two turns is one only where the user gives it
    assert motion_limits(hinge, {"hinge": JointLimits(lower=-50.0, upper=50.0)}, 0.0).half[0] == 50.0


def test_one_end_that_is_given_has_a_turn_before_it():
    hinge = arm('<limit effort="10" velocity="2"/>', "continuous")
    limits = motion_limits(hinge, {"hinge": JointLimits(upper=1.0)}, margin=0.0)
    assert (limits.lower[0], limits.upper[0]) == (1.0 - 2 * np.pi, 1.0)
    two_turns = arm('<limit effort="10" velocity="2" lower="-6.2832" upper="6.2832"/>')
    assert motion_limits(two_turns, margin=0.0).upper[0] == 6.2832


def test_without_a_torque_limit_no_torque_is_too_large():
    limits = motion_limits(arm('<limit velocity="2" lower="-1" upper="1"/>'))
    assert limits.torque[0] == np.inf
    assert limits.by_rule["hinge"] == ("acceleration", "jerk", "torque")


@pytest.mark.parametrize(
    ("kind", "limits", "named"),
    [
        ("continuous", "", r"tip does not say.*velocity \(in rad/s\) of hinge"),
        ("revolute", 'effort="1" lower="-1" upper="1"', "velocity"),
        ("prismatic", 'effort="1" velocity="1"', r"lower \(in m\) of hinge; upper \(in m\) of hinge"),
        ("revolute", 'effort="1" velocity="1" lower="1" upper="-1"', r"lower 1 \(file\) and upper -1 \(file\)"),
        ("revolute", 'effort="1" velocity="0" lower="-1" upper="1"', "velocity is 0 in tip"),
        ("revolute", 'effort="0" velocity="1" lower="-1" upper="1"', "torque is 0 in tip"),
    ],
)
def test_a_file_without_limits_or_with_limits_that_contradict(kind, limits, named):
    with pytest.raises(ModelError, match=named):
        motion_limits(arm(f"<limit {limits}/>", kind))


def test_what_a_user_gives_wrong_is_named():
    with pytest.raises(ConfigError, match="did you mean 'hinge'"):
        motion_limits(arm(), {"henge": JointLimits()})
    with pytest.raises(ConfigError, match=r"lower 4 \(given\) and upper 3 \(file\)"):
        motion_limits(arm(), {"hinge": JointLimits(lower=4.0)})


def test_a_format_without_velocity_limits_asks_for_them():
    bodies = RigidBodies(ARM_MJCF, source="arm.xml")
    with pytest.raises(ModelError, match=r"velocity \(in rad/s\) of shoulder, twist; velocity \(in m/s\) of rail\."):
        motion_limits(Model((bodies,), name="arm.xml"))
    bodies = RigidBodies(ARM_MJCF, source="arm.xml", joints_used=("rail", "shoulder", "twist"))
    speeds = {name: JointLimits(velocity=speed) for name, speed in (("shoulder", 2.0), ("twist", 3.0), ("rail", 1.0))}
    limits = motion_limits(Model((bodies,)), speeds, margin=0.1)
    assert limits.upper.tolist() == pytest.approx([0.9, 0.9, 0.9 * np.pi])
    assert limits.velocity.tolist() == pytest.approx([0.9, 1.8, 2.7])  # in the order of the joints


def test_the_joints_that_mimic_another_keep_their_limits_too():
    bodies = RigidBodies(GRIPPER, source="gripper.urdf")  # the follower is at 2 q + 0.01, within -1 and 1, below 2 m/s
    limits = motion_limits(Model((bodies,)), margin=0.0)
    assert (limits.lower[1], limits.upper[1]) == pytest.approx((-0.505, 0.495))
    assert limits.velocity.tolist() == [2.0, 1.0]


@pytest.mark.parametrize("friction", [Coulomb, partial(Coulomb, width=0.05), LoadCoulomb])
def test_only_dry_friction_holds_a_joint(friction):
    np.testing.assert_allclose(min_fit_speeds(MODEL, LIMITS), 0.03 * LIMITS.velocity)
    bodies, *_ = MODEL.terms
    case = Model((bodies, friction(bodies.joints, on=("bend",))), name="x")
    np.testing.assert_allclose(min_fit_speeds(case, LIMITS), [0.0, 0.03 * LIMITS.velocity[1]])
    np.testing.assert_array_equal(min_fit_speeds(Model((bodies,), name="x"), LIMITS), 0.0)


def test_poses_stand_within_all_limits_and_are_drawn_from_the_generator():
    poses = AROUND.random_poses(100, np.random.default_rng(0))
    assert poses.shape == (100, 2)
    assert AROUND.can_stand(poses).all()
    assert (Post().distances(poses) >= 0.02).all()
    assert (poses == AROUND.random_poses(100, np.random.default_rng(0))).all()
    outside = np.array([[2.9, 0.0], [0.0, 0.0]])
    assert FREE.can_stand(outside).tolist() == [False, True]
    assert AROUND.can_stand(outside).tolist() == [False, False]


def test_where_the_arm_can_stand_nowhere_the_reason_is_said():
    shadow = replace(AROUND, space=Post(radius=2.0))
    # added to an offset of the torque, which acts as gravity does; to dry friction; and a part to both
    for weakest, added, cause in (
        ("lift", {22: -0.8, 24: 50.0}, "gravity"),
        ("lift", {22: 9.0}, r"dry friction alone \(9\.[0-9]*\)"),
        ("lift", {22: -0.65, 24: 0.05}, "gravity with friction"),
        ("bend", {23: 9.0}, r"dry friction alone \(9\.[0-9]*\)"),
    ):
        torque = np.where(np.array(LIMITS.joints) == weakest, 0.2, 99.0)
        weak = replace(FREE, limits=replace(LIMITS, torque=torque))
        theta = THETA + np.array([added.get(k, 0.0) for k in range(len(THETA))])
        if cause.endswith("friction"):
            theta[:20] = 0.0
        words = rf"In \d+ {cause} needs more torque than is allowed, mostly of joint '{weakest}' \(0\.2\)"
        with pytest.raises(ConfigError, match=words):
            replace(weak, theta=theta).random_poses(3, np.random.default_rng(0))
    with pytest.raises(ConfigError, match="nearer than 20 mm, mostly 'upper' and 'post'"):
        shadow.random_poses(3, np.random.default_rng(0))
