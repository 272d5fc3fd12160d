"""Whatever the robot, motions and programs for it begin and end at rest, are continuous, and keep all its limits."""

from dataclasses import replace

import numpy as np
import pytest

from dynident.apps.excitation import (
    JointLimits,
    MotionRequest,
    Purpose,
    Trajectory,
    min_fit_speeds,
    motion_limits,
    verify,
)
from dynident.apps.excitation.family import ClampedSpline, Fourier, LinearCourse
from dynident.apps.excitation.files import check_interpolant, sample_trajectory
from dynident.apps.excitation.limits import Feasibility
from dynident.apps.excitation.programs import friction_program, gravity_program
from dynident.apps.excitation.trajectory import slow_down
from dynident.apps.excitation.way import from_rest
from dynident.models import Model, RigidBodies
from dynident.models.friction import Coulomb, Viscous
from tests.apps.excitation.arms import scaled, smooth_and_at_rest
from tests.laws.test_rigid_bodies import random_robot


def random_arm(rng):
    """A tree of joints that turn and slide, with friction, and limits of its torque that leave little to spare."""
    text, moving = random_robot(rng, int(rng.integers(1, 6)))
    bodies = RigidBodies(text, source="random.urdf", joints_used=moving)
    model = Model((bodies, Viscous(bodies.joints), Coulomb(bodies.joints)), name="random.urdf")
    limits = motion_limits(
        model, {joint.name: JointLimits(velocity=float(rng.uniform(0.2, 5))) for joint in bodies.joints}
    )
    values = [parameter.value for parameter in bodies.parameters]
    theta = np.concatenate([values, 0.5 / limits.velocity, np.full(len(limits.joints), 0.5)])
    q = rng.uniform(limits.lower, limits.upper, (200, len(limits.joints)))
    dq, ddq = (size * rng.uniform(-1, 1, q.shape) for size in limits.sizes[1:3])
    torque = 1.3 * np.abs(model.torque(q, dq, ddq, theta)).max(axis=0) + 1.0
    return Feasibility(model, theta, replace(limits, torque=torque))


STEP = 0.0125  # s between the points that are written


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", ["series", "spline", "friction", "gravity"])
def test_what_is_made_passes_the_last_check(kind, seed):
    rng = np.random.default_rng(seed)
    feasible = replace(random_arm(rng), step=STEP)
    limits, n = feasible.limits, len(feasible.limits.joints)
    match kind:
        case "series":
            family = Fourier(8.0, 3)
            pieces = from_rest(feasible, LinearCourse(family, scaled(family, rng, limits, 0.7)), 1, None, rng)
        case "spline":
            family = ClampedSpline(8.0, 10)
            pieces = from_rest(feasible, LinearCourse(family, scaled(family, rng, limits, 0.7)), 1, limits.middle, rng)
        case "friction":
            pieces = friction_program(feasible, 15.0 * n, None, rng, speeds=3)
        case _:
            pieces = gravity_program(feasible, MotionRequest(np.ones(n), duration=30.0, start=limits.middle), rng)
    trajectory = Trajectory(limits.joints, pieces)
    smooth_and_at_rest(trajectory, limits)
    assert verify(trajectory, feasible).reached.max() <= 1 + 1e-6
    # also as a controller plays it from its points, and once more slowly
    for times, rate in ((1.0, 1 / STEP), (1.0, 3 / STEP), (4.0, 0.25 / STEP)):
        check_interpolant(*sample_trajectory(slow_down(trajectory, times), rate), limits)
    slow = min_fit_speeds(feasible.model, limits)
    for piece in pieces:
        if piece.purpose in (Purpose.FRICTION, Purpose.POSE):
            t = np.linspace(0.0, piece.course.duration, 999)
            moving = np.abs(piece.course.states(t)[1]).max(axis=0)
            assert (moving[moving > 0] > slow[moving > 0]).all()  # a fit takes what is shown
