"""The dynamics of the bodies of a robot by Pinocchio, one sample after the other; and random robots for it."""

import numpy as np
import pinocchio as pin

from dynident.models import RigidBodies
from dynident.models.recursion import Recursion
from dynident.models.tree import Layout, Tree
from tests.robots import joint, link, urdf


def random_bodies(seed, count, kinds=("revolute", "continuous", "prismatic"), mimics=0.3):
    """A tree of ``count`` joints with tilted axes and displaced frames, some of them mimics, under any gravity."""
    rng = np.random.default_rng(seed)
    parts = [link("L0")]
    chosen = []
    for k in range(1, count + 1):
        parent = f"L{k - 1 - int(rng.integers(min(k, 3)))}"
        parts.append(link(f"L{k}", 1.0))
        inside = ""
        if chosen and rng.random() < mimics:
            inside = f'<mimic joint="{rng.choice(chosen)}" multiplier="{rng.normal()}" offset="{rng.normal()}"/>'
        else:
            chosen.append(f"J{k}")
        place = rng.normal(scale=0.3, size=3), rng.uniform(-3, 3, 3), rng.normal(size=3)
        parts.append(joint(f"J{k}", rng.choice(kinds), parent, f"L{k}", *place, inside=inside))
    order = tuple(rng.permutation(chosen).tolist()) if rng.random() < 0.5 else tuple(chosen)
    bodies = RigidBodies(urdf(*parts), joints_used=order, gravity=tuple(rng.normal(scale=9.81, size=3)))
    theta = rng.normal(size=len(bodies.parameters))
    theta[::10] = rng.uniform(0.1, 3.0, len(theta[::10]))
    return bodies, theta


def random_states(bodies, seed, samples):
    rng, n = np.random.default_rng(seed), len(bodies.joints)
    return rng.uniform(-3, 3, (samples, n)), rng.normal(size=(samples, n)), rng.normal(size=(samples, n))


def recursion_of(bodies, kind=Recursion):
    return kind(Tree.of(bodies.arm, Layout.of(bodies.arm)), np.array(bodies.gravity))


class Judge:
    """Pinocchio's model of the moving bodies, as they were assembled."""

    def __init__(self, bodies, theta):
        self.arm, self.model = bodies.arm, pin.Model()
        values = np.zeros((len(self.arm.bodies), 10))
        values[self.arm.parameter_bodies] = np.reshape(theta, (-1, 10))
        for k, body in enumerate(self.arm.bodies):
            slides = body.joint.kind == "prismatic"
            kind = pin.JointModelPrismaticUnaligned if slides else pin.JointModelRevoluteUnaligned
            parent = 0 if body.parent is None else body.parent + 1
            self.model.addJoint(parent, kind(body.joint.axis), pin.SE3(body.placement), f"joint {k}")
            self.model.inertias[k + 1] = pin.Inertia.FromDynamicParameters(values[k])
        self.model.gravity = pin.Motion(np.array(bodies.gravity), np.zeros(3))
        self.data = self.model.createData()

    def _each(self, compute, *states):
        """Return copies of what Pinocchio returns, which it may use again."""
        return np.array([np.array(compute(self.model, self.data, *state)) for state in zip(*states, strict=True)])

    def regressor(self, *states):
        bodies = self.model.nv
        full = self._each(pin.computeJointTorqueRegressor, *self.arm.body_states(*states)).reshape(
            -1, bodies, 10 * bodies
        )
        full = (self.arm.drive.T @ full).reshape(len(full), len(self.arm.driven), -1, 10)
        return full[:, :, self.arm.parameter_bodies].reshape(len(full), len(self.arm.driven), -1)

    def torque(self, *states):
        return self._each(pin.rnea, *self.arm.body_states(*states)).reshape(-1, self.model.nv) @ self.arm.drive

    def partials(self, *states):
        result = self._each(lambda *state: np.array(pin.computeRNEADerivatives(*state)), *self.arm.body_states(*states))
        result = result.reshape(-1, 3, self.model.nv, self.model.nv)
        return self.arm.drive.T @ result.swapaxes(0, 1) @ self.arm.drive

    def mass(self, q):
        upper = self._each(lambda *state: np.triu(pin.crba(*state)), self.arm.body_states(q, q, q)[0])
        upper = upper.reshape(-1, self.model.nv, self.model.nv)
        return self.arm.drive.T @ (upper + np.triu(upper, 1).swapaxes(1, 2)) @ self.arm.drive


def assert_same(result, expected, tolerance=1e-13):
    assert result.shape == expected.shape
    assert np.abs(result - expected).max(initial=0.0) <= tolerance * max(np.abs(expected).max(initial=0.0), 1.0)
