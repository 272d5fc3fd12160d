"""Bounds of how fast distances change: never exceeded, and not much too large."""

import numpy as np
import pytest

import dynident as dy
from dynident.excitation.spaces.pairing import capsule_space
from dynident.excitation.spaces.reach import reaches, steepest
from dynident.excitation.spaces.space import Steep
from tests.excitation.spaces.test_clearance import AROUND, BRANCHED, arm
from tests.robots import ARM, joint, link, urdf


@pytest.mark.parametrize("xml", [ARM, BRANCHED], ids=["slide", "branched and mimic"])
def test_no_distance_changes_faster(xml) -> None:
    bodies, capsules = arm(xml)
    space = capsule_space(bodies, capsules, AROUND)
    assert isinstance(space, Steep)
    ends = [(one.lower or -3.0, one.upper or 3.0) for one in bodies.limits.values()]
    q = np.random.default_rng(0).uniform(*np.transpose(ends), (3000, len(ends)))
    distances, slopes = space.gradients(q)
    shallow = np.abs(slopes) * (distances > 0)[..., None]
    assert (shallow.max(axis=0) <= space.steepest).all()
    assert (shallow.max(axis=0) > 0.3 * space.steepest).mean() > 0.5
    still = space.steepest == 0
    assert (slopes[:, still] == 0).all()


def test_the_reach_is_the_way_over_the_links() -> None:
    limit = '<limit effort="1" velocity="1" lower="-0.4" upper="0.2"/>'
    bodies = dy.RigidBodies(
        urdf(
            *(link(name, 1.0) for name in ("base", "a", "b", "c")),
            joint("one", "revolute", "base", "a", (0.0, 0.0, 9.0)),
            joint("two", "prismatic", "a", "b", (0.3, 0.0, 0.4), inside=limit),
            joint("three", "revolute", "b", "c", (0.0, 0.2, 0.0)),
        )
    )
    assert reaches(bodies, 2, 0.1) == pytest.approx([0.1 + 0.2 + 0.5 + 0.4, 1.0, 0.1])
    assert reaches(bodies, 0, 0.1) == pytest.approx([0.1, 0, 0])
    assert reaches(bodies, -1, 0.1) == pytest.approx([0, 0, 0])
    moved = np.array([reaches(bodies, body, 0.1) for body in (-1, 0, 2)])
    assert steepest(bodies, moved, [(0, 1), (1, 2)]) == pytest.approx(np.array([[0.1, 0, 0], [0, 1.0, 0.1]]))
    assert steepest(bodies, moved, []).shape == (0, 3)
