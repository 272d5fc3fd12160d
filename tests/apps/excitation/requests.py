"""The planar arm as capsules with a post in its way, and what is asked of it."""

from dataclasses import replace

import numpy as np

from dynident.apps.excitation import MotionRequest
from dynident.apps.excitation.exact_space import build_capsule_space
from dynident.apps.excitation.limits import Feasibility
from dynident.apps.excitation.motion import build_interior
from dynident.models import Capsule, Cylinder
from dynident.regression import structural_base_parameters
from tests.apps.excitation.arms import LIMITS, MODEL, THETA

LINKS = (
    Capsule("upper", 0, np.zeros(3), np.array([0.4, 0.0, 0.0]), 0.05),
    Capsule("lower", 1, np.zeros(3), np.array([0.35, 0.0, 0.0]), 0.04),
)
SPACE = build_capsule_space(MODEL.terms[0], LINKS, (Cylinder("post", (0.62, 0.0), 0.08, -0.5, 0.5),))
OPEN = build_capsule_space(MODEL.terms[0], LINKS)
REQUEST = MotionRequest(
    0.01 * LIMITS.torque, duration=9.0, period=4.0, harmonics=3, rate=100.0, file_rate=100.0, starts=2, clearance=0.01
)
BASIS = structural_base_parameters(MODEL)


def interior(space=SPACE, model=MODEL, limits=LIMITS, **changes):
    """The motions that a request with changes asks for."""
    request = replace(REQUEST, **changes)
    return build_interior(Feasibility(model, THETA, limits, space, request.clearance), request, BASIS)
