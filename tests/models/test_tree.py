"""What a tree knows of an arm: who carries whom, and what drives it."""

import numpy as np

from dynident.models import RigidBodies
from dynident.models.tree import Layout, Tree
from tests.models.judge import random_bodies
from tests.robots import ARM, joint, link


def test_a_serial_arm_needs_no_copies():
    layout = Layout.of(RigidBodies(ARM).arm)
    assert layout.is_identity
    assert layout.is_complete
    assert layout.hosts == slice(0, 3)
    assert [chain.path for chain in layout.chains] == [slice(0, 1), slice(0, 2), slice(0, 3)]
    np.testing.assert_array_equal(layout.above, np.tri(3))


def test_the_support_of_slides_and_of_own_joints():
    layout = Layout.of(RigidBodies(ARM).arm)
    blocks = layout.support.reshape(3, 3, 10)
    assert not blocks[1, 1, 4:].any()  # of a slide no inertia
    assert blocks[1, 1, 0]  # but its mass
    assert not blocks[0, 0, 0]  # a mass on the axis turns about it
    assert not np.tril(blocks.any(axis=2), -1).any()


def test_the_place_of_the_base_does_not_matter():
    bodies, _ = random_bodies(1, 4)
    mount = link("ground") + joint("mount", "fixed", "ground", "L0", (1e6, 0, 0))
    far = RigidBodies(bodies.xml.replace("</robot>", f"{mount}</robot>"), bodies.joints_used)
    layout = Layout.of(far.arm)
    near = Tree.of(bodies.arm, layout)
    np.testing.assert_allclose(Tree.of(far.arm, layout).origin, near.origin, atol=1e-9)
