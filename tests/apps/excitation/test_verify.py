"""The last check refuses what leaves a limit, jumps, or is not at rest, and says which joint, when, and how much."""

import pickle
import sys
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynident.apps.excitation import LimitError, Piece, Purpose, Trajectory, verify
from dynident.apps.excitation.family import ClampedSpline, Fourier
from dynident.apps.excitation.limits import Feasibility
from dynident.apps.excitation.trajectory import Hold
from dynident.apps.excitation.way import Quintic, from_rest, rest_state
from dynident.runtime import InputError
from tests.apps.excitation.arms import FREE, LIMITS, MODEL, THETA, Post, scaled

LOW, HIGH = np.array([-0.6, 0.0]), np.array([0.6, 0.1])


def trajectory(*courses):
    return Trajectory(LIMITS.joints, tuple(Piece(one, Purpose.MOTION) for one in courses))


def way(duration=2.0, start=LOW, end=HIGH):
    return Quintic(duration, rest_state(start), rest_state(end))


def refused(courses, limits=LIMITS, **kwargs):
    with pytest.raises(LimitError) as caught:
        verify(trajectory(*courses), Feasibility(MODEL, THETA, limits, **kwargs))
    return caught.value


@given(st.integers(0, 2**32 - 1), st.booleans())
@settings(max_examples=10)
def test_what_the_guards_let_pass_the_check_lets_pass(seed, periodic):
    rng = np.random.default_rng(seed)
    family = Fourier(6.0, 4) if periodic else ClampedSpline(8.0, 12)
    strong = replace(FREE, limits=replace(LIMITS, torque=np.full(2, np.inf)))
    pieces = from_rest(strong, family.course(scaled(family, rng, share=1.0)), 1, None, rng)
    if pieces is None:  # ramps need some room
        return
    found = verify(Trajectory(LIMITS.joints, pieces), Feasibility(MODEL, THETA, strong.limits))
    assert (found.reached <= 1 + 1e-6).all()
    assert found.reached[:4].max() > 0.9


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
    error = refused([way()], limits)
    assert (error.quantity, error.joint) == (quantity, "lift")
    assert 0 <= error.time <= 2.0
    assert abs(error.value) > abs(error.limit) * 0.999999
    text = str(error)
    assert f"joint 'lift' at {error.time:.4f} s: {quantity} is {error.value:.6g}, beyond its limit" in text
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), again.limit) == (text, error.limit)


def test_what_is_used_of_the_limits_is_what_fine_samples_say():
    found = verify(trajectory(way()), Feasibility(MODEL, THETA, LIMITS))
    q, dq, ddq, jerk = way().states(np.linspace(0, 2.0, 200_001))
    tau = MODEL.torque(q, dq, ddq, THETA)
    sizes = [LIMITS.half, *LIMITS.sizes[1:], LIMITS.torque]
    used = [np.abs(one).max(axis=0) / size for one, size in zip((q, dq, ddq, jerk, tau), sizes, strict=True)]
    np.testing.assert_allclose(found.reached, used, rtol=1e-6)
    assert found.routes == ("regressor", "Pinocchio")
    assert found.nearest is None
    assert found.samples > 2000


def test_jumps_between_pieces_and_motion_at_the_ends_are_refused():
    error = refused([way(), way(start=HIGH + 0.01, end=LOW)])
    assert (error.quantity, error.time) == ("position", 2.0)
    assert "position jumps by 0.01" in str(error)
    moving = Quintic(2.0, rest_state(LOW), np.array([[0.6, 0.1], [0.5, 0.0], [0.0, 0.0]]))
    error = refused([moving, way(start=HIGH, end=LOW)])
    assert (error.quantity, error.joint, error.time) == ("velocity", "lift", 2.0)
    error = refused([moving])
    assert "velocity is 0.5 where the trajectory should be at rest" in str(error)
    assert refused([Quintic(2.0, moving.end * [[1], [1], [0]], rest_state(HIGH))]).time == 0.0


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
    error = refused([Faulty(order, by)])
    assert error.quantity == quantity
    assert 0.69 < error.time < 1.11
    assert "jumps" in str(error)


def test_numbers_that_are_none_are_refused():
    for order in range(4):
        assert "nan" in str(refused([Faulty(order, np.nan)]))


def test_something_too_near_is_named():
    error = refused([way(start=np.array([-0.6, 0.0]), end=np.array([0.6, 0.0]))], space=Post(), clearance=0.02)
    assert error.quantity == "distance"
    assert error.joint == "lower and post"
    assert "'lower' and 'post' are -50.00 mm apart at 1.0000 s, nearer than the clearance of 20 mm" in str(error)
    stands = trajectory(Hold(1.0, np.array([-0.6, 0.0])))
    found = verify(stands, Feasibility(MODEL, THETA, LIMITS, Post(), 0.02), shapes=Post(radius=0.05))
    assert found.nearest_shapes.distance == pytest.approx(found.nearest.distance + 0.05)
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
