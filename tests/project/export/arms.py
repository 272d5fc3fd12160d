"""An arm with values found, for exports."""

import numpy as np

from dynident.models import CoupledMotor, Model, RigidBodies, RotorInertia, from_physical
from dynident.models.friction import Coulomb, Offset, Viscous
from dynident.project.export import IdentifiedModel, random_states
from tests.robots import ARM

STATES = random_states(3, np.random.default_rng(0), 30)
BODY = from_physical(3.0, [0.01, 0.02, 0.1], np.diag([0.2, 0.3, 0.4]))


def arm(text=ARM, body=BODY, width=0.0, viscous=1.0, **options):
    bodies = RigidBodies(text, **options)
    joints, n = bodies.joints, len(bodies.joints)
    motor = CoupledMotor(joints, {joints[0].name: 1, joints[-1].name: 6}, "motor", viscous=False, coulomb=False)
    terms = (bodies, RotorInertia(joints), Viscous(joints), Coulomb(joints, width=width), Offset(joints), motor)
    friction = [*[0.5] * n, *[viscous] * n, *[2.0] * n, *[-0.3] * n, 0.01]
    return IdentifiedModel(Model(terms, name="arm"), np.concatenate([np.tile(body, n), friction]))
