"""The last check: torque by another route, and refusal of what leaves a limit, jumps, or is not at rest."""

import re
import sys
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynident.apps.excitation import LimitError, Piece, Purpose, Trajectory, verify
from dynident.apps.excitation.family import ClampedSpline, Fourier, LinearCourse
from dynident.apps.excitation.limits import Feasibility
from dynident.apps.excitation.trajectory import Hold
from dynident.apps.excitation.verify import pinocchio_torque
from dynident.apps.excitation.way import Quintic, from_rest, rest_state
from dynident.models import Model, RigidBodies
from dynident.models.friction import Coulomb, Viscous
from dynident.models.lagrangian import two_link_arm
from dynident.runtime import InputError
from tests.apps.excitation.arms import FREE, LIMITS, MODEL, THETA, Post, scaled
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
