"""Limits of a motion, and the last check: torque by another route, refusal of what leaves a limit or jumps."""

import re
import sys
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynident.apps.excitation import (
    JointLimits,
    LimitError,
    Piece,
    Purpose,
    Trajectory,
    min_fit_speeds,
    motion_limits,
    verify,
)
from dynident.apps.excitation.family import ClampedSpline, Fourier, LinearCourse
from dynident.apps.excitation.limits import ACCELERATION_TIME, JERK_TIME, Feasibility
from dynident.apps.excitation.trajectory import Hold
from dynident.apps.excitation.verify import pinocchio_torque
from dynident.apps.excitation.way import Quintic, from_rest, rest_state
from dynident.models import Model, RigidBodies
from dynident.models.friction import Coulomb, LoadCoulomb, Viscous
from dynident.models.lagrangian import two_link_arm
from dynident.runtime import ConfigError, InputError, ModelError
from tests.apps.excitation.arms import AROUND, FREE, LIMITS, MODEL, THETA, Post, scaled
from tests.robots import ARM, ARM_MJCF, GRIPPER, joint, link, urdf

RNG = np.random.default_rng(3)


ROUNDED = urdf(
    link("a"), link("b", 1.0, (0.1, 0, 0)), link("c", 2.0, (0, 0.2, 0)),
    joint("one", "revolute", "a", "b", (0, 0, 0.3), (1.5708, 0, -3.1416)),
    joint("two", "revolute", "b", "c", (0.3, 0, 0), (0, 0.785, 1.571)),
)  # fmt: skip
# what Pinocchio's reader of files refuses
BARE = ARM.replace('effort="10" ', "").replace('type="continuous"><parent', 'type="continuous"><dynamics/><parent')
BARE = BARE.replace("</inertial>", '</inertial><visual><geometry><mesh filename=""/></geometry></visual>')


@pytest.mark.parametrize(
    "bodies",
    [
        RigidBodies(ARM, source="arm"),
        RigidBodies(ARM, ("twist", "shoulder"), {"rail": 0.3}, (1.0, 2.0, -9.0), "arm"),
        RigidBodies(GRIPPER, source="gripper"),
        RigidBodies(urdf(link("a"), link("b", 1.0, (0.1, 0, 0)), joint("only", "continuous", "a", "b")), source="one"),
        RigidBodies(ROUNDED, source="rounded angles"),
        RigidBodies(BARE, source="no effort"),
    ],
)
def test_the_two_routes_agree(bodies):
    model = Model((Viscous(bodies.joints), bodies, Coulomb(bodies.joints)))
    theta = RNG.normal(size=len(model.parameters))  # physical or not
    states = RNG.normal(size=(3, 20, len(model.joints)))
    other = pinocchio_torque(model, theta, *states)
    np.testing.assert_allclose(other, model.torque(*states, theta), atol=1e-9 * np.abs(other).max())


def test_without_a_urdf_as_it_stands_or_pinocchio_there_is_none(monkeypatch):
    states = np.zeros((3, 1, 2))
    assert pinocchio_torque(two_link_arm(), two_link_arm().values, *states) is None
    bodies = RigidBodies(ARM_MJCF, source="arm.xml")
    assert pinocchio_torque(Model((bodies,)), np.zeros(30), *np.zeros((3, 1, 3))) is None
    bodies = RigidBodies(ARM, source="arm")
    moved = bodies.with_displacement("rail", (0.01,) + (0.0,) * 8)
    assert pinocchio_torque(Model((moved,)), np.zeros(30), *np.zeros((3, 1, 3))) is None
    monkeypatch.setitem(sys.modules, "pinocchio", None)
    assert pinocchio_torque(replace(Model((bodies,))), np.zeros(30), *np.zeros((3, 1, 3))) is None


LOW, HIGH = np.array([-0.6, 0.0]), np.array([0.6, 0.1])


def trajectory(*courses):
    return Trajectory(LIMITS.joints, tuple(Piece(course, Purpose.MOTION) for course in courses))


def way(duration=2.0, start=LOW, end=HIGH):
    return Quintic(duration, rest_state(start), rest_state(end))


def refused(courses, limits=LIMITS, **kwargs):
    with pytest.raises(LimitError) as caught:
        verify(trajectory(*courses), Feasibility(MODEL, THETA, limits, **kwargs))
    return str(caught.value)


@given(st.integers(0, 2**32 - 1), st.booleans())
@settings(max_examples=10)
def test_what_the_guards_let_pass_the_check_lets_pass(seed, periodic):
    rng = np.random.default_rng(seed)
    family = Fourier(6.0, 4) if periodic else ClampedSpline(8.0, 12)
    strong = replace(FREE, limits=replace(LIMITS, torque=np.full(2, np.inf)))
    pieces = from_rest(strong, LinearCourse(family, scaled(family, rng, share=1.0)), 1, None, rng)
    if pieces is None:  # ramps need some room
        return
    result = verify(Trajectory(LIMITS.joints, pieces), Feasibility(MODEL, THETA, strong.limits))
    assert (result.reached <= 1 + 1e-6).all()
    assert result.reached[:4].max() > 0.9


@pytest.mark.parametrize("quantity", ["position", "velocity", "acceleration", "jerk", "torque"])
def test_a_limit_that_is_left_between_samples_is_named_with_joint_time_and_value(quantity):
    free = verify(trajectory(way()), Feasibility(MODEL, THETA, LIMITS))
    place = ["position", "velocity", "acceleration", "jerk", "torque"].index(quantity)
    share = free.reached[place, 0]
    names = ["upper", "velocity", "acceleration", "jerk", "torque"]
    if quantity == "position":
        limits = replace(LIMITS, lower=np.array([-2.5, -2.5]), upper=np.array([0.59999, 2.5]))
    else:
        old = getattr(LIMITS, names[place])
        limits = replace(LIMITS, **{names[place]: old * np.array([share * (1 - 2e-6), 1.0])})
    words = re.fullmatch(
        r"joint 'lift' at (.*) s: (.*) is (.*), beyond its limit (.*); the trajectory is refused\.",
        refused([way()], limits),
    )
    time, value, limit = (float(words[k]) for k in (1, 3, 4))
    assert words[2] == quantity
    assert 0 <= time <= 2.0
    assert abs(value) >= abs(limit)


def test_what_is_used_of_the_limits_is_what_fine_samples_say():
    result = verify(trajectory(way()), Feasibility(MODEL, THETA, LIMITS))
    q, dq, ddq, jerk = way().states(np.linspace(0, 2.0, 200_001))
    tau = MODEL.torque(q, dq, ddq, THETA)
    sizes = [LIMITS.half, *LIMITS.sizes[1:], LIMITS.torque]
    used = [np.abs(x).max(axis=0) / size for x, size in zip((q, dq, ddq, jerk, tau), sizes, strict=True)]
    np.testing.assert_allclose(result.reached, used, rtol=1e-6)
    assert result.routes == ("regressor", "Pinocchio")
    assert result.nearest is None
    assert result.samples > 2000


def test_jumps_between_pieces_and_motion_at_the_ends_are_refused():
    assert "at 2.0000 s: position jumps by 0.01;" in refused([way(), way(start=HIGH + 0.01, end=LOW)])
    moving = Quintic(2.0, rest_state(LOW), np.array([[0.6, 0.1], [0.5, 0.0], [0.0, 0.0]]))
    assert "joint 'lift' at 2.0000 s: velocity jumps" in refused([moving, way(start=HIGH, end=LOW)])
    assert "at 2.0000 s: velocity is 0.5 where the trajectory should be at rest" in refused([moving])
    assert "at 0.0000 s: " in refused([Quintic(2.0, moving.end * [[1], [1], [0]], rest_state(HIGH))])


@dataclass(frozen=True)
class Faulty:
    """A way with a fault in one of its derivatives, or a jump within."""

    order: int
    by: float
    duration: float = 2.0

    def states(self, t):
        out = way().states(t)
        out[self.order, (t > 0.7) & (t < 1.1)] += self.by
        return out


@pytest.mark.parametrize(
    ("order", "by", "quantity"), [(0, 0.01, "position"), (1, 0.01, "position"), (2, 0.3, "velocity")]
)
def test_derivatives_that_do_not_belong_together_are_refused(order, by, quantity):
    time = re.search(rf"at (.*) s: {quantity} jumps", refused([Faulty(order, by)]))[1]
    assert 0.69 < float(time) < 1.11


def test_numbers_that_are_none_are_refused():
    for order in range(4):
        assert "nan" in refused([Faulty(order, np.nan)])


def test_something_too_near_is_named():
    said = refused([way(start=np.array([-0.6, 0.0]), end=np.array([0.6, 0.0]))], space=Post(), clearance=0.02)
    assert "'lower' and 'post' are -50.00 mm apart at 1.0000 s, nearer than the clearance of 20 mm" in said
    stands = trajectory(Hold(1.0, np.array([-0.6, 0.0])))
    result = verify(stands, Feasibility(MODEL, THETA, LIMITS, Post(), 0.02), shapes=Post(radius=0.05))
    assert result.nearest_shapes.distance == pytest.approx(result.nearest.distance + 0.05)
    with pytest.raises(LimitError, match="lower"):
        verify(stands, Feasibility(MODEL, THETA, LIMITS, Post(), 0.02), shapes=Post(radius=0.6))


def test_a_second_opinion_that_differs_is_an_error(monkeypatch):
    module = sys.modules["dynident.apps.excitation.verify"]
    monkeypatch.setattr(module, "pinocchio_torque", lambda model, theta, *states: model.torque(*states, theta) + 0.1)
    with pytest.raises(InputError, match=r"joint 'lift': the torque by Pinocchio differs by 0\.1 N m"):
        verify(trajectory(way()), Feasibility(MODEL, THETA, LIMITS))
    monkeypatch.setattr(module, "pinocchio_torque", lambda *_: None)
    assert verify(trajectory(way()), Feasibility(MODEL, THETA, LIMITS)).routes == ("regressor",)


def test_limits_of_other_joints_are_refused():
    with pytest.raises(InputError, match="is of the joints"):
        verify(trajectory(way()), Feasibility(MODEL, THETA, replace(LIMITS, joints=("bend", "lift"))))


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
