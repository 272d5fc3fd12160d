"""Bounds of how fast distances change: never exceeded, and not much too large."""

import numpy as np
import pytest

import dynident as dy
from dynident.apps.excitation.clearance import distance_rate_bounds, reach_bounds
from dynident.apps.excitation.exact_space import build_capsule_space
from dynident.models.geometry import LipschitzDistances
from tests.apps.excitation.test_clearance import AROUND, BRANCHED, arm
from tests.robots import ARM, joint, link, urdf


@pytest.mark.parametrize("xml", [ARM, BRANCHED], ids=["slide", "branched and mimic"])
def test_no_distance_changes_faster(xml) -> None:
    bodies, capsules = arm(xml)
    space = build_capsule_space(bodies, capsules, AROUND)
    assert isinstance(space, LipschitzDistances)
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
    assert reach_bounds(bodies, 2, 0.1) == pytest.approx([0.1 + 0.2 + 0.5 + 0.4, 1.0, 0.1])
    assert reach_bounds(bodies, 0, 0.1) == pytest.approx([0.1, 0, 0])
    assert reach_bounds(bodies, -1, 0.1) == pytest.approx([0, 0, 0])
    moved = np.array([reach_bounds(bodies, body, 0.1) for body in (-1, 0, 2)])
    assert distance_rate_bounds(bodies, moved, [(0, 1), (1, 2)]) == pytest.approx(
        np.array([[0.1, 0, 0], [0, 1.0, 0.1]])
    )
    assert distance_rate_bounds(bodies, moved, []).shape == (0, 3)
