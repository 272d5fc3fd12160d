"""Distances of capsules and obstacles, against searches, with derivatives and bounds of their rates."""

import pickle
from functools import partial

import numpy as np
import pytest

import dynident as dy
from dynident.apps.excitation import CapsuleSpace
from dynident.apps.excitation.clearance import (
    body_distance,
    distance_rate_bounds,
    reach_bounds,
    segment_distance,
    signed_distance,
)
from dynident.apps.excitation.exact_space import build_capsule_space
from dynident.models import Box, Capsule, Cylinder, Floor
from dynident.models.geometry import LipschitzDistances
from tests.robots import ARM, joint, link, urdf

SHARES = np.linspace(0, 1, 201)
BODIES = (
    Floor(0.1),
    Box("box", (0.1, -0.1, 0.2), (0.4, 0.5, 0.3)),
    Box("turned", (0.1, 0.0, 0.2), (0.4, 0.5, 0.3), ((0.6, 0.8, 0.0), (-0.8, 0.6, 0.0), (0.0, 0.0, 1.0))),
    Cylinder("post", (0.1, 0.2), 0.3, -0.2, 0.4),
    Cylinder("endless", (0.1, 0.2), 0.3),
)


def searched(p, u, r, v):
    """The least distance of points on both segments."""
    one, other = p + SHARES[:, None] * u, r + SHARES[:, None] * v
    return float(np.linalg.norm(one[:, None] - other, axis=2).min())


def drawn(seed, count=60):
    return np.random.default_rng(seed).uniform(-0.5, 0.5, (count, 4, 3)).swapaxes(0, 1)


def test_distances_are_at_most_a_millimetre_less_than_those_found_by_searching() -> None:
    p, u, r, v = drawn(0)
    distance, _, _ = segment_distance(p, u, r, v)
    true = np.array([searched(*one) for one in zip(p, u, r, v, strict=True)])
    far = true > 0.05
    assert far.sum() > 30
    # the grid is too coarse by up to (1 / 400)^2 of a length squared over the distance
    assert (distance[far] < true[far] + 1e-6).all()
    assert (distance[far] > true[far] - 1e-3).all()


def test_segments_without_a_length_are_points() -> None:
    p, r = np.array([[0.0, 0.0, 0.3]]), np.zeros((1, 3))
    distance, point, away = segment_distance(p, 0 * p, r, 0 * r)
    assert distance == pytest.approx(0.3, abs=2e-4)
    assert point.tolist() == p.tolist()
    assert np.linalg.norm(away) == pytest.approx(1, abs=1e-3)


def slope(move, q, step=1e-6):
    return (move(q + step) - move(q - step)) / (2 * step)


@pytest.mark.parametrize("lift", [0.2, 0.005, 0.0])
def test_the_derivative_is_continuous_where_segments_become_parallel_or_cross(lift) -> None:
    def turned(angle):
        u = np.array([[np.cos(angle), 0.1 * angle, np.sin(angle)]])
        return segment_distance(-0.5 * u + 0.02, u, np.array([[-0.4, lift, 0.0]]), np.array([[1.0, 0.0, 0.0]]))[0][0]

    slopes = np.array([slope(turned, angle) for angle in np.linspace(-0.05, 0.05, 201)])
    assert np.abs(np.diff(slopes)).max() < 0.05  # it would jump by about 1


def test_the_derivative_by_a_point_is_that_of_moving_the_segment() -> None:
    p, u, r, v = drawn(1)
    _, _, away = segment_distance(p, u, r, v)
    for axis in np.eye(3):
        assert slope(lambda x, a=axis: segment_distance(p + x * a, u, r, v)[0], 0.0) == pytest.approx(
            away @ axis, abs=1e-6
        )
        assert slope(lambda x, a=axis: segment_distance(p, u, r + x * a, v)[0], 0.0) == pytest.approx(
            -away @ axis, abs=1e-6
        )


@pytest.mark.parametrize("body", BODIES, ids=lambda body: getattr(body, "name", "floor"))
def test_distances_to_bodies_are_those_found_by_searching(body) -> None:
    p, u, _, _ = drawn(2)
    distance, _, away = body_distance(p, u, partial(signed_distance, body))
    true = signed_distance(body, p[:, None] + SHARES[:, None] * u[:, None])[0].min(axis=1)
    assert (distance < true + 1e-6).all()
    assert (distance > true - 3e-3).all()  # inside a box there is a kink, which the grid may miss
    assert (distance > 0).any()
    assert (distance < 0).any()
    for axis in np.eye(3):
        moved = slope(lambda x, a=axis: body_distance(p + x * a, u, partial(signed_distance, body))[0], 0.0)
        assert moved == pytest.approx(away @ axis, abs=1e-4)


def test_a_segment_through_a_box_is_pushed_out_the_shorter_way() -> None:
    box = Box("box", (0.0, 0.0, 0.0), (1.0, 0.2, 1.0))
    distance, _, away = body_distance(
        np.array([[-0.1, 0.05, 0.0]]), np.array([[0.2, 0.0, 0.0]]), partial(signed_distance, box)
    )
    assert distance[0] == pytest.approx(-0.05, abs=1e-3)
    assert away[0] == pytest.approx([0, 1, 0], abs=1e-9)


def test_distances_to_a_box_are_those_to_its_faces() -> None:
    box = Box("table", (0.2, 0.1, 0.3), (0.4, 0.6, 0.2))
    grid = np.linspace(-0.5, 0.5, 41)
    faces = np.array([np.insert([a, b], k, side) for k in range(3) for side in (-0.5, 0.5) for a in grid for b in grid])
    surface = np.array(box.centre) + faces * box.size
    points = np.random.default_rng(0).uniform(-0.6, 0.8, (80, 3))
    distance, _ = signed_distance(box, points)
    inside = (np.abs(points - box.centre) < np.array(box.size) / 2).all(axis=1)
    near = np.linalg.norm(points[:, None] - surface, axis=2).min(axis=1)
    assert inside.any()
    assert ((distance < 0) == inside).all()
    assert (np.abs(distance) < near + 1e-12).all()
    assert near**2 == pytest.approx(distance**2, abs=1.1e-4)  # the grid is 15 mm wide


POST, ENDLESS = Cylinder("post", (0.0, 0.0), 0.3, 0.0, 1.0), Cylinder("post", (1.0, 0.0), 0.3)


@pytest.mark.parametrize(
    ("body", "point", "distance", "away"),
    [
        (POST, (1.0, 0.0, 0.5), 0.7, (1, 0, 0)),
        (POST, (0.0, 0.1, 1.2), 0.2, (0, 0, 1)),
        (POST, (0.0, 0.0, -0.5), 0.5, (0, 0, -1)),
        (POST, (0.0, 0.7, 1.3), 0.5, (0, 0.8, 0.6)),
        (POST, (0.0, 0.25, 0.5), -0.05, (0, 1, 0)),
        (ENDLESS, (1.0, 0.1, 9.0), -0.2, (0, 1, 0)),
        (ENDLESS, (0.0, 0.0, -9.0), 0.7, (-1, 0, 0)),
        (Floor(0.2), (3.0, 1.0, 0.5), 0.3, (0, 0, 1)),
    ],
)
def test_distances_to_obstacles_are_signed_and_point_away(body, point, distance, away) -> None:
    found, normal = signed_distance(body, np.array([point]))
    assert found[0] == pytest.approx(distance)
    assert normal[0] == pytest.approx(away)


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
