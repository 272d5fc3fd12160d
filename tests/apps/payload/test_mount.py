"""Where a payload is mounted, and what its parameters in that frame add to the model."""

from __future__ import annotations

import numpy as np
import pytest

from dynident.apps.payload import mount_of
from dynident.apps.payload.body import physical_components
from dynident.models import Model, RigidBodies
from dynident.models.friction import Viscous
from dynident.models.lagrangian import pendulum
from dynident.project.export import with_payload_link
from dynident.runtime import ModelError
from tests.apps.payload.arms import CARRIED, SIX, arm
from tests.robots import joint, link, urdf


def test_the_flange_is_the_link_that_is_called_so() -> None:
    mount = mount_of(arm()[0])
    assert (mount.frame, mount.body, mount.joint) == ("arm_tool0", "turn", "j6")
    assert mount_of(Model((RigidBodies(SIX.replace("arm_tool0", "spindle")),))).frame == "turn"


@pytest.mark.parametrize("frame", ["arm_tool0", "turn", "fore"])
def test_parameters_in_a_frame_are_those_of_a_link_fixed_to_it(frame: str) -> None:
    model, _ = arm()
    values = physical_components(CARRIED)
    xx, xy, yy, xz, yz, zz = values[4:]
    text = with_payload_link(SIX, frame, values[0], values[1:4], np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))
    before, after = RigidBodies(SIX), RigidBodies(text)
    added = np.array([one.value for one in after.parameters]) - [one.value for one in before.parameters]
    np.testing.assert_allclose((mount_of(model, frame).transform @ CARRIED)[: len(added)], added, atol=1e-12)


def test_frames_that_do_not_exist_or_do_not_move_are_refused() -> None:
    model, _ = arm()
    with pytest.raises(ModelError, match=r"'arm_tool' is no link.*did you mean 'arm_tool0'"):
        mount_of(model, "arm_tool")
    with pytest.raises(ModelError, match="'base' does not move"):
        mount_of(model, "base")
    with pytest.raises(ModelError, match="has no links to carry a payload"):
        mount_of(pendulum())


def test_an_arm_with_two_ends_needs_a_frame() -> None:
    text = urdf(
        link("base"), link("left", 1.0), link("right", 1.0),
        joint("l", "continuous", "base", "left"), joint("r", "continuous", "base", "right"),
    )  # fmt: skip
    bodies = RigidBodies(text)
    model = Model((bodies, Viscous(bodies.joints)))
    with pytest.raises(ModelError, match=r"several ends .'left', 'right'.; name the payload's frame"):
        mount_of(model)
    assert mount_of(model, "right").joint == "r"
