"""Distances of an arm as capsules, and their derivatives."""

import pickle

import numpy as np
import pytest

import dynident as dy
from dynident.apps.excitation import CapsuleSpace
from dynident.apps.excitation.exact_space import build_capsule_space
from dynident.models import Box, Capsule, Cylinder, Floor
from tests.robots import ARM, joint, link, urdf

AROUND = (Floor(-0.3), Box("table", (0.6, 0.0, 0.2), (0.4, 0.4, 0.4)), Cylinder("post", (-0.4, 0.3), 0.1))
MIMIC = '<mimic joint="first" multiplier="-0.5" offset="0.2"/>'
BRANCHED = urdf(
    *(link(name, 1.0) for name in ("base", "a", "b", "c", "d")),
    joint("first", "revolute", "base", "a", (0.0, 0.0, 0.3), axis=(0.0, 1.0, 0.0)),
    joint("second", "continuous", "a", "b", (0.3, 0.0, 0.0), (0.3, 0.0, 0.0)),
    joint("third", "prismatic", "a", "c", (0.0, 0.3, 0.0), axis=(0.0, 0.6, 0.8)),
    joint("follower", "revolute", "c", "d", (0.0, 0.2, 0.0), inside=MIMIC),
)


def arm(xml, seed=0):
    """Bodies with a capsule of random place around each link, the root link too."""
    bodies, rng = dy.RigidBodies(xml), np.random.default_rng(seed)
    count = len(bodies.arm.bodies)
    names = [bodies.file.root, *(body.name for body in bodies.arm.bodies)]
    places = rng.uniform(-0.2, 0.2, (count + 1, 2, 3))
    return bodies, [Capsule(names[k + 1], k, *places[k + 1], 0.03 + 0.01 * k) for k in range(-1, count)]


def every(xml):
    bodies, capsules = arm(xml)
    return build_capsule_space(bodies, capsules, AROUND)


@pytest.mark.parametrize("xml", [ARM, BRANCHED], ids=["slide", "branched and mimic"])
def test_the_derivatives_are_those_of_the_distances(xml) -> None:
    space = every(xml)
    n = len(space.bodies.joints)
    q = np.random.default_rng(1).uniform(-1.5, 1.5, (80, n))
    distances, slopes = space.gradients(q)
    assert slopes.shape == (80, len(space.pairs), n)
    assert distances == pytest.approx(space.distances(q))
    step = 1e-6
    for k, unit in enumerate(np.eye(n)):
        found = (space.distances(q + step * unit) - space.distances(q - step * unit)) / (2 * step)
        wrong = np.abs(found - slopes[..., k])
        assert wrong.max() < 2e-5
    assert np.abs(slopes).max() > 0.1


def test_distances_are_those_of_the_placed_capsules() -> None:
    bodies, capsules = arm(ARM)
    space = build_capsule_space(bodies, capsules)
    q = np.random.default_rng(2).uniform(-1, 1, (5, len(bodies.joints)))
    placed = bodies.placements(q)
    shares = np.linspace(0, 1, 201)[:, None]
    for k, (one, other) in enumerate(space.meetings):
        first, second = (
            placed.points(
                np.full(201, capsules[place].body),
                capsules[place].start + shares * (capsules[place].end - capsules[place].start),
            )
            for place in (one, other)
        )
        least = np.linalg.norm(first[:, :, None] - second[:, None], axis=3).min(axis=(1, 2))
        apart = least - capsules[one].radius - capsules[other].radius
        far = least > 0.05
        assert space.distances(q)[far, k] == pytest.approx(apart[far], abs=1.1e-3)


def test_pairs_are_named_in_the_order_of_the_distances() -> None:
    bodies, capsules = arm(ARM)
    space = build_capsule_space(bodies, capsules, AROUND)
    obstacles = [pair for pair in space.pairs if pair[1] in ("floor", "table", "post")]
    assert space.pairs[-len(obstacles) :] == tuple(obstacles)
    place = space.pairs.index(("wrist", "floor"))
    wrist = capsules[-1]
    q = np.zeros((1, len(bodies.joints)))
    ends = bodies.placements(q).points([wrist.body] * 2, np.array([wrist.start, wrist.end]))
    lowest = ends[0, :, 2].min() - wrist.radius + 0.3
    assert space.distances(q)[0, place] == pytest.approx(lowest, abs=1e-3)


def test_many_samples_are_computed_in_blocks(monkeypatch) -> None:
    space = every(ARM)
    q = np.random.default_rng(3).uniform(-1, 1, (30, len(space.bodies.joints)))
    whole = space.distances(q)
    monkeypatch.setattr("dynident.apps.excitation.clearance.BLOCK", 7)
    assert space.distances(q).tolist() == whole.tolist()
    assert space.distances(q[:0]).shape == (0, len(space.pairs))


def test_a_space_without_pairs_has_no_distances() -> None:
    bodies, _ = arm(ARM)
    none = np.empty((0, 2), dtype=np.intp)
    space = CapsuleSpace(bodies, (), (), none, none)
    q = np.zeros((4, len(bodies.joints)))
    assert space.pairs == ()
    assert [one.shape for one in space.gradients(q)] == [(4, 0), (4, 0, len(bodies.joints))]


def test_a_space_goes_to_another_process() -> None:
    space = every(ARM)
    q = np.zeros((2, len(space.bodies.joints)))
    assert pickle.loads(pickle.dumps(space)).distances(q).tolist() == space.distances(q).tolist()
