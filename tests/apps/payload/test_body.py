"""Ten parameters as a body, where it is mounted, and which turning of a joint would show what of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from dynident.apps.payload import PhysicalBody, mount_of
from dynident.apps.payload.body import (
    Turning,
    _centre_pose,
    best_turning,
    make_consistent,
    physical_components,
    physical_jacobian,
    turnings,
)
from dynident.models import Model, RigidBodies, smallest_eigenvalue
from dynident.models.friction import Viscous
from dynident.project.export import with_payload_link
from dynident.runtime import ModelError
from tests.apps.payload.arms import CARRIED, SIX, arm
from tests.robots import joint, link, urdf


def test_a_consistent_payload_stays_as_it_is() -> None:
    assert make_consistent(CARRIED, np.eye(10)) is CARRIED


@pytest.mark.parametrize("k", [4, 6, 9])
def test_another_becomes_consistent_where_it_is_least_known_and_no_further_than_needed(k: int) -> None:
    phi, information = CARRIED.copy(), np.diag(np.full(10, 1e8))
    phi[k], information[k, k] = -0.01, 1.0
    body = make_consistent(phi, information)
    assert smallest_eigenvalue(body) > 0
    kept = np.arange(10) != k
    np.testing.assert_allclose(body[kept], phi[kept], atol=1e-4)
    body, rng = make_consistent(phi, np.eye(10)), np.random.default_rng(0)
    others = body + 1e-3 * rng.standard_normal((200, 10))
    others = others[smallest_eigenvalue(others) > 1e-7]
    assert len(others) > 5
    assert (np.linalg.norm(others - phi, axis=1) > np.linalg.norm(body - phi) - 1e-6).all()


def test_mass_centre_and_inertia_and_their_derivatives() -> None:
    values = physical_components(CARRIED)
    np.testing.assert_allclose(values, [3.0, 0.02, -0.03, 0.08, 0.012, 0, 0.015, 0, 0, 0.006], atol=1e-15)
    body, J = PhysicalBody(values, np.ones(10)), physical_jacobian(CARRIED)
    assert body.mass == pytest.approx(3.0)
    np.testing.assert_allclose(body.tensor, np.diag([0.012, 0.015, 0.006]), atol=1e-15)
    step = 1e-4 * np.random.default_rng(0).standard_normal(10)
    np.testing.assert_allclose(physical_components(CARRIED + step) - values, J @ step, atol=1e-7)


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
    added = np.array([parameter.value for parameter in after.parameters]) - [
        parameter.value for parameter in before.parameters
    ]
    np.testing.assert_allclose((mount_of(model, frame).transform @ CARRIED)[: len(added)], added, atol=1e-12)


def test_frames_that_do_not_exist_or_do_not_move_are_refused() -> None:
    model, _ = arm()
    bare = replace(model, terms=model.terms[1:])
    for robot, frame, words in (
        (model, "arm_tool", r"'arm_tool' is no link.*did you mean 'arm_tool0'"),
        (model, "base", "'base' does not move"),
        (bare, None, "has no links to carry a payload"),
    ):
        with pytest.raises(ModelError, match=words):
            mount_of(robot, frame)


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


def test_turning_the_last_joint_shows_the_inertia_about_its_axis() -> None:
    model, _ = arm()
    reference = np.diag([1e6, *[1e6] * 3, *[1e2] * 6])
    ways = turnings(model, mount_of(model), CARRIED, reference, np.full(6, 1e-3), np.zeros((4, 6)))
    assert [way.joint for way in ways] == ["j1", "j2", "j3", "j4", "j5", "j6"]
    assert best_turning(ways, 9, np.inf).joint in ("j4", "j6")
    assert best_turning(ways, 6, np.inf).joint not in ("j6",)
    before = np.sqrt(np.diag(np.linalg.inv(reference)))
    assert (best_turning(ways, 9, np.inf).std[9], best_turning(ways, 6, np.inf).std[6]) < (before[9], before[6])
    assert {way.speed for way in ways} == {1.5}


def test_a_joint_turns_within_its_limits() -> None:
    model, _ = arm()
    limited = SIX.replace('type="continuous"', 'type="revolute"').replace(
        "<axis", '<limit effort="9" velocity="1" lower="0.1" upper="0.5"/><axis'
    )
    bodies = RigidBodies(limited)
    slow = replace(model, terms=(bodies, *model.terms[1:]))
    ways = turnings(slow, mount_of(slow), CARRIED, np.eye(10), np.ones(6), np.zeros((4, 6)))
    assert [way.speed for way in ways] == pytest.approx([0.7] * 6)
    assert _centre_pose(slow, 0, np.zeros(6), 0.8)[0] == pytest.approx(0.3)


def test_of_joints_that_do_as_well_the_last_is_named() -> None:
    ways = [Turning(name, 1.0, np.array([std])) for name, std in (("a", 1.0), ("b", 1.1), ("c", 2.0))]
    assert best_turning(ways, 0, 9.0).joint == "b"
    assert best_turning(ways, 0, 1.0) is None
